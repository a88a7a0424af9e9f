"""The global filter: where on the prior map the vehicle is, and how sure."""

from __future__ import annotations

from math import exp
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from fbn_common.estimator import Health, Level, Output
from fbn_common.geodesy import GeodeticPoint
from fbn_common.graph import GRAPH
from fbn_common.prior_map import PriorMap, read_prior_map
from fbn_common.records import (
    CompositeMeasurement,
    Datum,
    Innovation,
    Localization,
    Odometry,
    Pose,
    Record,
    ReferenceFix,
)
from fbn_common.records import (
    Verdict as Answer,
)
from fbn_common.types import Array, nanoseconds, seconds
from fbn_global import publish
from fbn_global import state as states
from fbn_global.bank import Bank
from fbn_global.checks import refusal
from fbn_global.composite_update import CompositeError, Snippet, inform_base, take_apart
from fbn_global.field import Field, build_field
from fbn_global.hypotheses import Hypothesis
from fbn_global.odometry import History, Link, Reckoned, carry, link, pose_vector, positive_part
from fbn_global.parameters import GlobalParameters
from fbn_global.reference_update import apply_fix
from fbn_global.target import Target, blend, locate, target_row
from fbn_global.verdict import Mode, Verdict, judge, modes
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
        self._counts: dict[str, int] = {}
        self._reset()
        warm_up()

    def _reset(self) -> None:
        p = self.p.motion
        self._history = History(p.history_s)
        self._bank: Bank | None = None
        self._start: Reckoned | None = None  # dead reckoning at the time of the state's pose
        self._located = False  # a reference fix has said where
        self._waiting: list[ReferenceFix] = []
        self._field: Field | None = None
        self._datum: GeodeticPoint | None = None
        self._stationary = p.drift_sigma**2 * np.eye(3)
        self._time_constant = p.drift_time_constant
        self._last: CompositeMeasurement | None = None
        self._verdict = Verdict()
        self._modes: list[Mode] = []
        self._status_ns: int | None = None
        self._outputs: list[Output] = []
        if self.p.datum:
            self._set_datum(GeodeticPoint(*self.p.datum))

    # --- the estimator's doors -----------------------------------------------------------------------------

    def put(self, topic: str, record: Record) -> None:
        self._queue.append((topic, record))

    def advance(self, now_ns: int) -> list[Output]:
        self._outputs = []
        if self._now_ns is not None and now_ns < self._now_ns:
            self._reset()
            self._answer(
                now_ns,
                "clock",
                Answer.REFUSED,
                f"clock went back by {seconds(self._now_ns - now_ns):.1f} s: start anew",
            )
        self._now_ns = now_ns
        due = [item for item in self._queue if item[1].stamp_ns <= now_ns]
        self._queue = [item for item in self._queue if item[1].stamp_ns > now_ns]
        for topic, record in sorted(due, key=lambda item: (item[1].stamp_ns, _ORDER.get(item[0], 99))):
            self._take(topic, record)
        self._apply_waiting(now_ns)
        self._keep_status(now_ns)
        return self._outputs

    def health(self) -> Health:
        level = Level.WARN if self._verdict.state is Localization.LOST or not self._located else Level.OK
        values: dict[str, int | float | str] = {f"count {k}": v for k, v in sorted(self._counts.items())}
        if self._bank is not None:
            values |= {"hypotheses": len(self._bank.all), "state size": len(self._bank.best.state.mean)}
        message = f"{self._verdict.state.name}: {self._verdict.reason}"
        return Health(level, message, values | {"posterior": self._verdict.posterior})

    # --- inputs --------------------------------------------------------------------------------------------

    def _take(self, topic: str, record: Record) -> None:
        reason = refusal(record)
        if reason:
            self._answer(record.stamp_ns, topic, Answer.REFUSED, reason)
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
            self._publish_map(record.stamp_ns)
        elif datum != self._datum:
            self._answer(record.stamp_ns, "datum", Answer.REFUSED, f"map has its origin already, at {self._datum}")

    def _set_datum(self, datum: GeodeticPoint) -> None:
        self._datum = datum
        self._field = build_field(self._prior, datum, self.p.prior)

    def _take_odometry(self, odometry: Odometry) -> None:
        latest = self._history.latest
        if latest is not None and odometry.stamp_ns <= latest.stamp_ns:
            self._answer(odometry.stamp_ns, "odometry", Answer.LATE, "not newer than the last one")
            return
        if latest is not None and self._jumped(latest, odometry):
            self._odometry_restarts(latest, odometry)
        reckoned = self._history.add(odometry)
        if self._bank is None or self._start is None:
            self._begin(reckoned, odometry.pose_covariance)
        self._carry_if_idle(reckoned)
        if self._located:
            pose, covariance = self._carried(self._leading(), reckoned)
            self._publish("global/odometry", publish.odometry_message(odometry, pose, covariance))

    def _jumped(self, latest: Reckoned, odometry: Odometry) -> bool:
        moved = float(np.hypot(*(odometry.pose.position[:2] - latest.pose[:2])))
        return moved > 1.0 + self.p.motion.speed_limit * seconds(odometry.stamp_ns - latest.stamp_ns)

    def _odometry_restarts(self, latest: Reckoned, odometry: Odometry) -> None:
        """Dead reckoning has a new origin: the pose is carried to the last of the old, and stands there in the new."""
        self._answer(
            odometry.stamp_ns, "odometry", Answer.REFUSED, "jumped: dead reckoning started anew; pose carried over"
        )
        self._carry_to(latest)
        self._history.clear()
        self._start = self._history.add(odometry)

    def _begin(self, reckoned: Reckoned, covariance: Array) -> None:
        """A first state: depth and attitude as dead reckoning has them, anywhere in xy."""
        p = self.p.motion
        spread = np.zeros((6, 6))
        spread[:2, :2] = p.start_sigma**2 * np.eye(2)
        spread[2:, 2:] = np.diag(np.maximum(np.diag(covariance)[2:], 1e-8))
        self._bank = Bank(states.start(reckoned.pose, spread, p.drift_sigma**2 * np.eye(3)), self.p)
        self._start = reckoned

    # --- reference fixes -----------------------------------------------------------------------------------

    def _apply_waiting(self, now_ns: int) -> None:
        """Apply the fixes whose odometry is there; those that waited too long are answered."""
        waiting, self._waiting = self._waiting, []
        for fix in waiting:
            reckoned = self._history.at(fix.stamp_ns)
            if reckoned is not None and self._bank is not None:
                self._apply_fix(fix, reckoned, self._bank)
            elif self._history.latest is not None and fix.stamp_ns < self._history.latest.stamp_ns:
                self._answer(fix.stamp_ns, "reference_fix", Answer.LATE, "older than the odometry remembered")
            elif seconds(now_ns - fix.stamp_ns) > self.p.motion.wait_s:
                self._answer(fix.stamp_ns, "reference_fix", Answer.REFUSED, "no odometry of its time")
            else:
                self._waiting.append(fix)

    def _apply_fix(self, fix: ReferenceFix, reckoned: Reckoned, bank: Bank) -> None:
        start, tie = self._tie(reckoned)
        done = bank.take_fix(lambda s: apply_fix(s, start, tie, fix.xy, fix.covariance))
        leading = done[bank.all.index(self._leading())] if len(done) == len(bank.all) else done[0]
        answer = Answer.USED if leading.used else Answer.REFUSED
        reason = "" if leading.used else "no better than what is known: fixes share their errors"
        self._answer(fix.stamp_ns, "reference_fix", answer, reason, leading.innovation, leading.sigma, leading.nis)
        if leading.used or not self._located:
            self._located = True
            self._publish_pose()

    # --- composites ----------------------------------------------------------------------------------------

    def _take_composite(self, composite: CompositeMeasurement) -> None:
        try:
            snippet = self._bring_to_base(take_apart(composite))
        except CompositeError as error:
            self._answer(composite.stamp_ns, "composite", Answer.REFUSED, str(error))
            return
        bank = self._bank
        assert bank is not None
        self._drift_elapses(composite)
        if self._contradicts(snippet):
            return
        nis, dof = bank.take_composite(snippet, self._field if self._located else None)
        self._start = self._reckoned(composite.stamp_ns, composite.p2_odom)
        self._answer(composite.stamp_ns, "composite", Answer.USED, "", nis=nis, dof=dof)
        self._judge(composite.stamp_ns)
        self._publish("global/hypotheses", publish.hypotheses_message(composite.stamp_ns, bank, self._field))
        self._publish_map(composite.stamp_ns)
        self._publish_pose()

    def _contradicts(self, snippet: Snippet) -> bool:
        """Whether a composite contradicts all that is known of its base; it is then bridged by dead reckoning."""
        assert self._bank is not None
        c, dof = snippet.composite, len(snippet.values)
        nis = inform_base(self._bank.null.state, snippet).nis
        if nis <= chi2.isf(self.p.motion.composite_gate, max(dof, 1)):
            return False
        reason = "contradicts what is known of its base and of the drift; bridged by dead reckoning"
        self._answer(c.stamp_ns, "composite", Answer.GATED, reason, nis=nis, dof=dof)
        self._carry_to(self._reckoned(c.stamp_ns, c.p2_odom))
        return True

    def _bring_to_base(self, snippet: Snippet) -> Snippet:
        """Brings the state's pose to the composite's base, bridging what was lost; gives what is to be used."""
        c = snippet.composite
        base = self._reckoned(c.start_ns, c.base_odom)
        if self._bank is None or self._start is None:
            self._begin(base, 1e-8 * np.eye(6))
        assert self._bank is not None and self._start is not None
        gap_ns = c.start_ns - self._start.stamp_ns
        if gap_ns < -_SAME_NS or c.sequence in self._bank.memory.sequences():
            raise CompositeError(
                f"starts {-seconds(gap_ns):.2f} s before the state's pose: its time is covered already"
            )
        if gap_ns <= _SAME_NS and not c.first:
            return snippet
        self._bridge(base, c)
        u, covariance = snippet.u, snippet.u_covariance
        self._bank.each(lambda h: h.with_state(states.restart(h.state, states.LOCAL, u, covariance)))
        return snippet.without_information()

    def _bridge(self, base: Reckoned, composite: CompositeMeasurement) -> None:
        assert self._start is not None
        duration = seconds(base.stamp_ns - self._start.stamp_ns)
        moved = float(np.hypot(*(base.pose[:2] - self._start.pose[:2])))
        if moved > 1.0 + self.p.motion.speed_limit * duration:
            raise CompositeError(f"base is {moved:.0f} m of dead reckoning away after {duration:.1f} s")
        if not composite.first:
            self._answer(
                composite.stamp_ns, "composite", Answer.LATE, f"one before it was lost: {duration:.1f} s bridged"
            )
        self._carry_to(base)

    def _drift_elapses(self, composite: CompositeMeasurement) -> None:
        """The drift a window later, as the tracker let it relax; a prior tighter than that was renewed."""
        prior = 0.5 * (composite.prior_covariance[4:, 4:] + composite.prior_covariance[4:, 4:].T)
        before, self._last = self._last, composite
        self._time_constant = composite.drift_time_constant
        if composite.first or before is None or before.stamp_ns != composite.start_ns or self._bank is None:
            self._stationary = prior
            return
        decay = exp(-seconds(before.stamp_ns - before.start_ns) / composite.drift_time_constant)
        wandered = prior - decay**2 * before.covariance[-3:, -3:]
        if np.linalg.eigvalsh(wandered)[0] < -1e-3 * np.trace(prior):
            mean = composite.prior_mean[4:]
            self._bank.each(lambda h: h.with_state(states.restart(h.state, states.DRIFT, mean, prior)))
            return
        self._stationary = positive_part(wandered) / max(1.0 - decay**2, 1e-6)
        self._bank.each(lambda h: h.with_state(states.decay_drift(h.state, decay, self._stationary)))

    # --- dead reckoning ------------------------------------------------------------------------------------

    def _reckoned(self, stamp_ns: int, pose: Pose) -> Reckoned:
        """Dead reckoning at a composite's end, as the composite has it; surge's heading from the odometry."""
        known, vector = self._history.at(stamp_ns), pose_vector(pose)
        if known is not None:
            return Reckoned(stamp_ns, vector, known.heading, known.variance)
        last = self._start or Reckoned(stamp_ns, vector, np.zeros(2), np.zeros(4))
        bow = np.array([np.cos(vector[5]), np.sin(vector[5])])
        heading = last.heading + seconds(stamp_ns - last.stamp_ns) * bow
        return Reckoned(stamp_ns, vector, heading, last.variance)

    def _tie(self, end: Reckoned) -> tuple[Reckoned, Link]:
        assert self._start is not None
        return self._start, link(self._start, end, self._stationary, self._time_constant, self.p.motion.noise)

    def _carry_to(self, end: Reckoned) -> None:
        """Move every hypothesis's pose to another time by dead reckoning."""
        start, tie = self._tie(end)
        if tie.duration_s == 0.0 or self._bank is None:
            return
        decay = exp(-abs(tie.duration_s) / self._time_constant)

        def move(h: Hypothesis) -> Hypothesis:
            pose, jacobian, noise = carry(h.state, start, end, tie)
            moved = states.advance_head(h.state, jacobian, pose - jacobian @ h.state.mean[: states.HEAD], noise, ())
            return h.with_state(states.decay_drift(moved, decay, self._stationary))

        self._bank.each(move)
        self._start = end

    def _carry_if_idle(self, now: Reckoned) -> None:
        last = self._start.stamp_ns if self._start else now.stamp_ns
        if now.stamp_ns - last > nanoseconds(_IDLE_S):
            self._carry_to(now)

    def _carried(self, h: Hypothesis, end: Reckoned) -> tuple[Array, Array]:
        """Pose (6,) and covariance (6, 6) of a hypothesis at another time."""
        start, tie = self._tie(end)
        pose, jacobian, noise = carry(h.state, start, end, tie)
        return pose, jacobian @ h.state.covariance[: states.HEAD, : states.HEAD] @ jacobian.T + noise

    # --- results -------------------------------------------------------------------------------------------

    def _leading(self) -> Hypothesis:
        """Whose pose is published: the best of the declared match, else the null's."""
        assert self._bank is not None
        if self._verdict.matched and self._modes:
            wanted = self._modes[0].best.id
            return next((h for h in self._bank.rivals if h.id == wanted), self._bank.null)
        return self._bank.null

    def _judge(self, stamp_ns: int) -> None:
        bank = self._bank
        if bank is None or not self._located:
            return
        if self._field is None or not len(self._field.features):
            self._verdict = Verdict(reason="no prior map")
            return
        before = self._verdict.state
        self._modes = modes(bank, self._field, self.p.verdict.mode_radius)
        self._verdict = judge(self._verdict, self._modes, bank.null.score.posterior, stamp_ns, self.p.verdict)
        if self._verdict.state is not before:
            self._status_ns = None

    def _publish_pose(self) -> None:
        end = self._history.latest or self._start
        if self._located and end is not None:
            pose, covariance = self._carried(self._leading(), end)
            self._publish("global/pose", publish.pose_message(end.stamp_ns, pose, covariance))

    def _publish_map(self, stamp_ns: int) -> None:
        if self._datum is None or self._bank is None:
            return
        message = publish.map_message(
            stamp_ns, self._leading(), self._field, self._bank.memory, self._datum, self.p.scoring
        )
        self._publish("global/map", message)

    def _keep_status(self, now_ns: int) -> None:
        """Publish the status at least once a period, and when it changes."""
        due = self._status_ns is None or now_ns - self._status_ns >= nanoseconds(self.p.status_period_s)
        if due and self._bank is not None:
            self._status_ns = now_ns
            status = publish.status_message(now_ns, self._verdict, self._leading(), self._target())
            self._publish("global/status", status)

    def _target(self) -> Target | None:
        row = target_row(self._field) if self._field is not None else None
        end = self._history.latest or self._start
        if row is None or end is None or not self._located or self._field is None or self._bank is None:
            return None
        leading = self._leading()
        others = [h for h in self._bank.all if h is not leading and h.score.posterior > 0.01]
        start, tie = self._tie(end)
        all_of_them = [leading, *others]
        targets = [locate(h, self._field, row, start, end, tie) for h in all_of_them]
        return blend(targets, [max(h.score.posterior, 1e-6) for h in all_of_them])

    def _publish(self, topic: str, record: Record) -> None:
        self._outputs.append(Output(topic, record))

    def _answer(
        self, stamp_ns: int, sensor: str, answer: Answer, reason: str,
        innovation: Array | None = None, sigma: Array | None = None, nis: float = 0.0, dof: int | None = None,
    ) -> None:  # fmt: skip
        """One measurement's answer, published and counted."""
        self._counts[f"{sensor} {answer.name.lower()}"] = self._counts.get(f"{sensor} {answer.name.lower()}", 0) + 1
        values = np.zeros(0) if innovation is None else innovation
        record = Innovation(
            stamp_ns, "map", sensor, nis, len(values) if dof is None else dof, answer, reason, values,
            np.zeros(0) if sigma is None else sigma,
        )  # fmt: skip
        self._publish("global/innovations", record)
