"""The global filter: where on the prior map the vehicle is, and how sure."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fbn_common import chi_square
from fbn_common.estimator import Health, Level, Output
from fbn_common.geodesy import GeodeticPoint
from fbn_common.graph import GRAPH
from fbn_common.prior_map import PriorMap, read_prior_map
from fbn_common.records import CompositeMeasurement, Datum, Localization, Odometry, Record, ReferenceFix
from fbn_common.records import Verdict as Answer
from fbn_common.types import Array, nanoseconds, seconds
from fbn_global import publish
from fbn_global.bank import Bank
from fbn_global.checks import refusal
from fbn_global.composite_update import CompositeError, Snippet, inform_base, take_apart
from fbn_global.field import Field, build_field
from fbn_global.odometry import Reckoned
from fbn_global.outbox import Outbox
from fbn_global.parameters import GlobalParameters
from fbn_global.reckoning import Reckoning, Step
from fbn_global.reference_update import apply_fix
from fbn_global.results import Results
from fbn_global.state import LOCAL, restart, start
from fbn_global.state_file import StateFile
from fbn_global.verdict import Mode, Verdict
from fbn_global.warm import warm_up

_ORDER = {topic: k for k, topic in enumerate(GRAPH.node("fbn_global").inputs)}
_SAME_NS = 1_000_000  # two stamps this near are one
_IDLE_S = 120.0  # without composites for so long, the pose is carried along by dead reckoning alone


class Global:
    """The fifth estimator; see ``docs/equations/global.md``."""

    def __init__(self, parameters: GlobalParameters, prior: PriorMap | None = None) -> None:
        """Read the prior map (PriorMapError if it is broken) unless one is given; compile the kernels."""
        self.p = parameters
        self._prior = prior or (read_prior_map(Path(parameters.map_file)) if parameters.map_file else PriorMap(()))
        self._now_ns: int | None = None
        self._queue: list[tuple[str, Record]] = []
        self._out = Outbox()
        self._reset()
        warm_up()

    def _reset(self) -> None:
        self._reckoning = Reckoning(self.p.motion)
        self._bank: Bank | None = None
        self._located = False  # a reference fix has said where
        self._waiting: list[ReferenceFix] = []
        self._field: Field | None = None
        self._datum: GeodeticPoint | None = None
        self._results = Results(self.p, self._out)
        self._state_file = StateFile(self.p, self._out)
        if self.p.datum:
            self._set_datum(GeodeticPoint(*self.p.datum))

    # --- the estimator's doors -----------------------------------------------------------------------------

    def put(self, topic: str, record: Record) -> None:
        self._queue.append((topic, record))

    def advance(self, now_ns: int) -> list[Output]:
        if self._now_ns is not None and now_ns < self._now_ns:
            self._reset()
            reason = f"clock went back by {seconds(self._now_ns - now_ns):.1f} s: started anew"
            self._out.answer(now_ns, "clock", Answer.REFUSED, reason)
        self._now_ns = now_ns
        due = [item for item in self._queue if item[1].stamp_ns <= now_ns]
        self._queue = [item for item in self._queue if item[1].stamp_ns > now_ns]
        for topic, record in sorted(due, key=lambda item: (item[1].stamp_ns, _ORDER.get(item[0], len(_ORDER)))):
            self._take(topic, record)
        self._apply_waiting(now_ns)
        self._keep_status(now_ns)
        return self._out.empty()

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The places on the map that the bank now names, the likeliest first."""
        return self._results.modes

    def health(self) -> Health:
        verdict = self._results.verdict
        level = Level.WARN if verdict.state is Localization.LOST or not self._located else Level.OK
        values: dict[str, int | float | str] = {f"count {k}": v for k, v in sorted(self._out.counts.items())}
        if self._bank is not None:
            values |= {"hypotheses": len(self._bank.all), "state size": len(self._bank.best.state.mean)}
        return Health(level, f"{verdict.state.name}: {verdict.reason}", values | {"posterior": verdict.posterior})

    def _publish_map(self, stamp_ns: int) -> None:
        if self._datum is not None and self._bank is not None:
            self._results.publish_map(self._bank, self._field, self._datum, stamp_ns)

    def _keep_status(self, now_ns: int) -> None:
        """Publish the status at least once a period, and when it changes."""
        if self._bank is not None and self._results.status_due(now_ns):
            target = self._results.target(self._bank, self._field, self._reckoning) if self._located else None
            self._results.keep_status(self._bank, target, now_ns)

    # --- inputs --------------------------------------------------------------------------------------------

    def _take(self, topic: str, record: Record) -> None:
        reason = refusal(record)
        if reason:
            self._out.answer(record.stamp_ns, topic, Answer.REFUSED, reason)
        elif isinstance(record, Datum):
            self._take_datum(record)
        elif isinstance(record, Odometry):
            self._take_odometry(record)
        elif isinstance(record, ReferenceFix):
            self._waiting.append(record)
        elif isinstance(record, CompositeMeasurement):
            self._take_composite(record)

    def _take_datum(self, record: Datum) -> None:
        datum = GeodeticPoint(record.latitude, record.longitude, record.height)
        if self._datum is None:
            self._set_datum(datum)
            self._restore()
            self._publish_map(record.stamp_ns)
        elif datum != self._datum:
            reason = f"map has its origin already, at {self._datum}"
            self._out.answer(record.stamp_ns, "datum", Answer.REFUSED, reason)

    def _set_datum(self, datum: GeodeticPoint) -> None:
        self._datum = datum
        self._field = build_field(self._prior, datum, self.p.prior)

    def _take_odometry(self, odometry: Odometry) -> None:
        reckoning, latest = self._reckoning, self._reckoning.history.latest
        if latest is not None and odometry.stamp_ns <= latest.stamp_ns:
            self._out.answer(odometry.stamp_ns, "odometry", Answer.LATE, "not newer than the last one")
            return
        if latest is not None and reckoning.jumped(odometry):
            self._odometry_restarts(latest, odometry)
        reckoned = reckoning.history.add(odometry)
        if self._bank is None:
            self._begin(reckoned, odometry.pose_covariance)
        elif reckoning.start and odometry.stamp_ns - reckoning.start.stamp_ns > nanoseconds(_IDLE_S):
            self._move(reckoning.move_to(reckoned))
        if self._located and self._bank is not None:
            pose, covariance = reckoning.carried(self._results.leading(self._bank).state, reckoned)
            self._out.publish("global/odometry", publish.odometry_message(odometry, pose, covariance))

    def _odometry_restarts(self, latest: Reckoned, odometry: Odometry) -> None:
        """Dead reckoning has a new origin: the pose is carried to the last of the old, and stands there in the new."""
        reason = "jumped: dead reckoning started anew; pose carried over"
        self._out.answer(odometry.stamp_ns, "odometry", Answer.REFUSED, reason)
        self._move(self._reckoning.move_to(latest))
        self._reckoning.history.clear()
        self._reckoning.start = self._reckoning.history.add(odometry)

    def _begin(self, reckoned: Reckoned, covariance: Array) -> Bank:
        """A first state: depth and attitude as dead reckoning has them, anywhere in xy."""
        p = self.p.motion
        spread = np.zeros((6, 6))
        spread[:2, :2] = p.start_sigma**2 * np.eye(2)
        spread[2:, 2:] = np.diag(np.maximum(np.diag(covariance)[2:], 1e-8))
        self._bank = Bank(start(reckoned.pose, spread, p.drift_sigma**2 * np.eye(3)), self.p)
        self._reckoning.start = reckoned
        self._restore()
        return self._bank

    def _restore(self) -> None:
        """Take up the state of before a restart, once dead reckoning and map's origin are known, if it fits."""
        start = self._reckoning.start
        if not self._state_file.awaited or self._bank is None or self._field is None or start is None:
            return
        age_s = self._state_file.restore(self._bank, self._field, start.stamp_ns)
        if age_s is not None:
            self._located = True
            self._results.verdict = Verdict(reason=f"restored from {age_s:.0f} s ago")

    def _move(self, step: Step) -> None:
        """One step of every hypothesis's state."""
        assert self._bank is not None
        self._bank.each(lambda h: h.with_state(step(h.state)))

    # --- reference fixes -----------------------------------------------------------------------------------

    def _apply_waiting(self, now_ns: int) -> None:
        """Apply the fixes whose odometry is there; those that waited too long are answered."""
        waiting, self._waiting = self._waiting, []
        history = self._reckoning.history
        for fix in waiting:
            reckoned = history.at(fix.stamp_ns)
            if reckoned is not None and self._bank is not None:
                self._apply_fix(fix, reckoned, self._bank)
            elif history.latest is not None and fix.stamp_ns < history.latest.stamp_ns:
                self._out.answer(fix.stamp_ns, "reference_fix", Answer.LATE, "older than the odometry remembered")
            elif seconds(now_ns - fix.stamp_ns) > self.p.motion.wait_s:
                self._out.answer(fix.stamp_ns, "reference_fix", Answer.REFUSED, "no odometry of its time")
            else:
                self._waiting.append(fix)

    def _apply_fix(self, fix: ReferenceFix, reckoned: Reckoned, bank: Bank) -> None:
        begin, tie = self._reckoning.tie(reckoned)
        leading = self._results.leading(bank).id
        done = bank.take_fix(lambda state: apply_fix(state, begin, tie, fix.xy, fix.covariance, fix.marginal))[leading]
        answer = Answer.USED if done.used else Answer.REFUSED
        reason = "" if done.used else "no better than what is known: fixes share their errors"
        self._out.innovation(fix.stamp_ns, "reference_fix", answer, reason, done.innovation, done.sigma, done.nis, 2)
        if done.used:
            self._located = True
            self._results.publish_pose(bank, self._reckoning)

    # --- composites ----------------------------------------------------------------------------------------

    def _take_composite(self, composite: CompositeMeasurement) -> None:
        stamp_ns = composite.stamp_ns
        try:
            snippet = take_apart(composite)
            bank, snippet = self._bring_to_base(snippet)
        except CompositeError as error:
            self._out.answer(stamp_ns, "composite", Answer.REFUSED, str(error))
            return
        self._move(self._reckoning.drift_elapses(composite))
        if self._contradicts(bank, snippet):
            return
        nis, dof = bank.take_composite(snippet, self._field if self._located else None)
        self._reckoning.start = self._reckoning.at_end(stamp_ns, composite.p2_odom)
        self._out.innovation(stamp_ns, "composite", Answer.USED, "", np.zeros(0), np.zeros(0), nis, dof)
        if self._located:
            self._results.judge(bank, self._field, stamp_ns)
            self._state_file.save(bank, self._field, stamp_ns)
        self._out.publish("global/hypotheses", publish.hypotheses_message(stamp_ns, bank, self._field))
        self._publish_map(stamp_ns)
        if self._located:
            self._results.publish_pose(bank, self._reckoning)

    def _bring_to_base(self, snippet: Snippet) -> tuple[Bank, Snippet]:
        """Brings the states' pose to the composite's base, bridging what was lost; gives what is to be used."""
        c, reckoning = snippet.composite, self._reckoning
        base = reckoning.at_end(c.start_ns, c.base_odom)
        bank = self._bank or self._begin(base, 1e-8 * np.eye(6))
        before = reckoning.start or base
        gap_s = seconds(c.start_ns - before.stamp_ns)
        if gap_s < -seconds(_SAME_NS):
            raise CompositeError(f"starts {-gap_s:.2f} s before the state's pose: its time is covered already")
        if gap_s <= seconds(_SAME_NS) and not c.first:
            return bank, snippet
        if reckoning.too_far(before, base.pose, base.stamp_ns):
            raise CompositeError(f"its base is farther away by dead reckoning than {gap_s:.1f} s allow")
        if not c.first:
            self._out.answer(c.stamp_ns, "composite", Answer.LATE, f"one before it was lost: {gap_s:.1f} s bridged")
        elif c.sequence <= bank.memory.last_sequence:
            bank.forget_keys()
        self._move(reckoning.move_to(base))
        self._move(lambda state: restart(state, LOCAL, snippet.u, snippet.u_covariance))
        return bank, snippet.without_information()

    def _contradicts(self, bank: Bank, snippet: Snippet) -> bool:
        """Whether a composite contradicts all that is known of its base; it is then bridged by dead reckoning."""
        c, dof = snippet.composite, len(snippet.values)
        nis = inform_base(bank.null.state, snippet).nis
        if nis <= chi_square.bound_of_tail(self.p.motion.composite_gate, max(dof, 1)):
            return False
        reason = "contradicts what is known of its base and of the drift; bridged by dead reckoning"
        self._out.innovation(c.stamp_ns, "composite", Answer.GATED, reason, np.zeros(0), np.zeros(0), nis, dof)
        self._move(self._reckoning.move_to(self._reckoning.at_end(c.stamp_ns, c.p2_odom)))
        return True
