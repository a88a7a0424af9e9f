"""What the dead-reckoning and the reference filter have in common: intake, start, odometry, answers, health."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fbn_common.estimator import Health, Level, Output
from fbn_common.motion_ekf import gaps
from fbn_common.motion_ekf.adopt import Adoptions, usable_parameters
from fbn_common.motion_ekf.answers import Answers
from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.intake import Intake, common_intakes
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    CLIMB_ROW,
    GRID_NS,
    OWN,
    POSITION,
    SIZE_DEADRECK,
    Config,
    IntArray,
    Kind,
)
from fbn_common.motion_ekf.monitor import health_of
from fbn_common.motion_ekf.parameters import FilterParameters, config_of
from fbn_common.motion_ekf.sensors import Unusable
from fbn_common.motion_ekf.start import FirstData
from fbn_common.motion_ekf.stream import OdometryStream
from fbn_common.motion_ekf.warm_up import warm_up
from fbn_common.records import PredictedMotion, Record, VehicleParameters, Verdict
from fbn_common.types import Array, nanoseconds, seconds


class MotionFilter:
    """Base of both filters; a subclass adds its own topics, its start in x and y, and its services."""

    name = ""
    frame_id = ""
    size = SIZE_DEADRECK
    estimated = ACTUATION + 3

    def __init__(self, parameters: FilterParameters, ranks: dict[str, int], rows: int) -> None:
        self.parameters = parameters
        self._ahead_ns = nanoseconds(parameters.history.ahead)
        self.ranks = ranks
        self.intakes = self.sensors()
        self.rows = rows
        self.resets = self._bridged = 0
        self.answers = Answers(self.name, self.frame_id)
        self._stream = OdometryStream(self.name, self.frame_id)
        self._inbox: list[tuple[str, Record]] = []
        self._first = FirstData(parameters)
        self._restart()
        warm_up(self.ekf.config, self.size, self.rows)

    # --- what a subclass says ---------------------------------------------------------------------------

    def sensors(self) -> dict[str, Intake]:
        """The intakes by topic."""
        return common_intakes(self.parameters)

    def config(self) -> Config:
        """The kernels' numbers."""
        sensors = {intake.kind: intake.parameters for intake in self.intakes.values()}
        return config_of(self.parameters, sensors, self.estimated, self.corrects())

    def corrects(self) -> IntArray:
        """Error states (kinds, 2) that each kind of measurement corrects, first and last + 1.

        Compass, depth and altimeter do not see x, y, thrust, damping and water, and what the model makes of them by
        way of its lateral forces is its own error: they correct z, attitude, velocity and angular actuation.
        """
        return np.tile(np.array([POSITION + 2, ACTUATION + 3], np.int64), (len(Kind), 1))

    def start_xy(self) -> tuple[float, float, float]:
        """x and y [m] at the start, and the variance of each [m^2]."""
        return 0.0, 0.0, 1e-4

    def take(self, topic: str, record: Record, now_ns: int) -> list[Output]:
        """Take in a record of a topic of the subclass's own."""
        return []

    def settle(self, now_ns: int) -> list[Output]:
        """Decide on what the subclass kept back, with the head where it is."""
        return []

    def services(self, now_ns: int) -> list[Output]:
        """What else there is to publish after an advance."""
        return []

    def publishes(self) -> bool:
        """Whether there is odometry to publish at all."""
        return True

    def notes(self) -> list[str]:
        """What else there is to complain of."""
        return []

    # --- the two doors ----------------------------------------------------------------------------------

    def put(self, topic: str, record: Record) -> None:
        """Keep a record for the next advance."""
        self._inbox.append((topic, record))

    def advance(self, now_ns: int) -> list[Output]:
        """Process all that is stamped up to now, as far as the predicted motions reach."""
        inbox, self._inbox = self._inbox, []
        out = self._follow_clock(now_ns)
        out += self._take_motions([record for _, record in inbox if isinstance(record, PredictedMotion)])
        for topic, record in inbox:
            if not isinstance(record, PredictedMotion):
                out += self._admit(topic, record, now_ns)
        if self.ekf.head_ns < 0:
            out += self._try_start(now_ns)
        if self.ekf.head_ns >= 0:
            self.ekf.advance(now_ns)
            out += self._step_over_gap(now_ns)
            out += self.settle(now_ns)
            out += self.answers.processed(self.ekf)
            out += self._stream.publish(self.ekf, wanted=self.publishes())
            out += self.services(now_ns)
        return out

    def health(self) -> Health:
        """One line, and the counters of all sensors."""
        notes, watches = self.notes(), {i.sensor: i.watch for i in self.intakes.values()}
        values: dict[str, int | float | str]
        values = {"reruns": self.ekf.reruns, "bridged": self._bridged, "resets": self.resets}
        if self.ekf.head_ns < 0:
            notes = ["waiting for first compass, depth, motion and parameters", *notes]
            return replace(health_of(watches, self._now_ns, notes, values), level=Level.WARN)
        behind = seconds(self._now_ns - self.ekf.head_ns)
        values["behind_s"] = round(behind, 3)
        if behind > 1.0:
            notes.append(f"no predicted motion for {behind:.1f} s")
        return health_of(watches, self._now_ns, notes, values)

    # --- intake -----------------------------------------------------------------------------------------

    def _admit(self, topic: str, record: Record, now_ns: int) -> list[Output]:
        if isinstance(record, VehicleParameters):
            return self._take_parameters(record)
        intake = self.intakes.get(topic)
        if intake is None:
            return self.take(topic, record, now_ns)
        return self.measure(intake, topic, record, now_ns)

    def measure(self, intake: Intake, topic: str, record: Record, now_ns: int) -> list[Output]:
        """Put a measurement into the timeline, or say why not."""
        data, said = self.examine(intake, record, now_ns)
        return said if data is None else self.enter(intake, topic, record, data)

    def examine(self, intake: Intake, record: Any, now_ns: int) -> tuple[Array | None, list[Output]]:
        """The measurement's data, or None and what is said of it."""
        head = self.ekf.head_ns
        oldest = max(self.ekf.base.stamp_ns + 1, head - self.ekf.history_ns) if head >= 0 else 0
        objection = intake.objection(record, (oldest, now_ns + self._ahead_ns))
        if objection is not None:
            return None, [self.answers.refuse(intake, record.stamp_ns, *objection)]
        try:
            data = intake.data(record)
        except Unusable as error:
            return None, [self.answers.refuse(intake, record.stamp_ns, Verdict.REFUSED, str(error))]
        if data is None:
            intake.watch.verdicts["NO_BOTTOM"] += 1
        return data, []

    def enter(self, intake: Intake, topic: str, record: Any, data: Array) -> list[Output]:
        """Put a measurement that nothing speaks against into the timeline."""
        slot = self.ekf.put_event(record.stamp_ns, self.ranks[topic], intake.kind, intake.row, data)
        if slot < 0:
            full = "more measurements than the history holds"
            return [self.answers.refuse(intake, record.stamp_ns, Verdict.REFUSED, full)]
        self.answers.owe(slot, intake)
        if self.ekf.head_ns < 0:
            self._first.keep(record)
        return []

    def _take_motions(self, motions: list[PredictedMotion]) -> list[Output]:
        if not motions:
            return []
        oldest = self.ekf.head_ns - self.ekf.history_ns
        errors = self.ekf.put_motions(*motions)
        whys = ["older than the history" if m.stamp_ns < oldest else e for m, e in zip(motions, errors, strict=True)]
        return [
            self.answers.say(motion.stamp_ns, "predict", Verdict.REFUSED, why)
            for motion, why in zip(motions, whys, strict=True)
            if why
        ]

    def _take_parameters(self, record: VehicleParameters) -> list[Output]:
        """The first are the prior; later ones are adopted, but not by the filter that they come from."""
        if not usable_parameters(record):
            why = "not finite, or not a covariance"
            return [self.answers.say(record.stamp_ns, "parameters", Verdict.REFUSED, why)]
        if self._first.prior is None:
            self._first.prior = record
        elif self.estimated == ACTUATION + 3:  # who estimates them all is the one they come from
            rank = self.ranks["predict/parameters"]
            slot = self.ekf.put_event(record.stamp_ns, rank, Kind.PARAMETERS, CLIMB_ROW, np.zeros(1))
            self._adoptions.put(slot, record)
        return []

    # --- start, gaps, clock -------------------------------------------------------------------------------

    def _restart(self) -> None:
        """Forget all but the parameters: at construction, and when the clock went back."""
        for intake in self.intakes.values():
            intake.reset()
        self._adoptions = Adoptions()
        history_s = self.parameters.history.length
        self.ekf = MotionEkf(self.size, self.rows, self.config(), history_s, self._adoptions.adopt)
        self.answers.clear()
        self._first.forget()
        self._stream.restart()
        self._now_ns = -1

    def _follow_clock(self, now_ns: int) -> list[Output]:
        """Go on to this time, or start anew where it went back."""
        out = []
        if now_ns < self._now_ns:
            why = f"went back by {seconds(self._now_ns - now_ns):.3g} s: reset"
            out.append(self.answers.say(now_ns, "clock", Verdict.REFUSED, why))
            self._restart()
            self.resets += 1
        self._now_ns = now_ns
        return out

    def _try_start(self, now_ns: int) -> list[Output]:
        """Start as soon as there is what a first state needs; what was measured earlier is refused."""
        motions = self.ekf.motions
        t0 = self._first.stamp(motions, now_ns)
        if t0 < 0:
            return []
        own_variance = self.ekf.config.variance[: self.size - OWN]
        self.ekf.start(self._first.state(t0, motions, self.start_xy(), own_variance, self.rows))
        self._first.forget()
        return self.answers.skipped(self.ekf, t0, "before the filter's start")

    def _step_over_gap(self, now_ns: int) -> list[Output]:
        """Go on over motions that never came: velocity held; after a long gap started anew, position kept."""
        ekf, history, head = self.ekf, self.parameters.history, self.ekf.head_ns
        if not gaps.overdue(ekf, history, now_ns):
            return []
        if gaps.too_long(ekf, history):
            gaps.leap(ekf, history)
            self._stream.restart()
            self.resets += 1
            why = f"gap of {seconds(ekf.head_ns - head):.1f} s in the motions: started anew, position kept"
            skipped = self.answers.skipped(ekf, ekf.head_ns, "in a gap of the motions")
            return [self.answers.say(ekf.head_ns, "predict", Verdict.REFUSED, why), *skipped]
        steps = gaps.hold_velocity(ekf)
        self._bridged += steps
        ekf.advance(now_ns)
        why = f"motions of {seconds(steps * GRID_NS):.2f} s missing: velocity held"
        return [self.answers.say(head, "predict", Verdict.REFUSED, why)]
