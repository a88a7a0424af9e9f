"""Predict: forces and torques on the vehicle, integrated into motion between measurements (100 Hz)."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from fbn_common.estimator import Health, Level, Output
from fbn_common.motion_ekf.adopt import usable_parameters
from fbn_common.motion_ekf.layout import GRID_NS, M_ATTITUDE, M_NOISE, M_PARAMETERS, MOTION_SIZE, ODOMETRY_SIZE
from fbn_common.motion_ekf.monitor import refusal
from fbn_common.records import JointState, Odometry, PredictedMotion, Record, VehicleParameters, Verdict, stacked
from fbn_common.types import NS, Array, nanoseconds, seconds
from fbn_predict.commands import Commands, Malformed, actuator_values
from fbn_predict.dynamics import model_of
from fbn_predict.habit import Habit
from fbn_predict.parameters import PredictParameters, prior
from fbn_predict.roll import BROKEN, FED, UNUSED, Levels, feed, new_ring, noise_of_step, roll

_DT = GRID_NS * 1e-9
_FRAME = "base_link"
_FEEDBACK = {FED: "feedback.used", UNUSED: "feedback.unused"}
MOTION, PARAMETERS, INNOVATIONS = "predict/motion", "predict/parameters", "predict/innovations"


class Predict:
    """The vehicle's model run on a grid of 10 ms, with a history in which late commands and feedback are worked in."""

    def __init__(self, parameters: PredictParameters) -> None:
        self.parameters = parameters
        self.model = model_of(parameters.dynamics)
        self._history_ns = nanoseconds(parameters.history)
        self.slots = nanoseconds(parameters.history + parameters.max_gap) // GRID_NS + 200
        n = parameters.noise
        self._levels = Levels(
            np.array(n.velocity), np.array(n.turn_rate), np.array(n.wave_turn), n.surge, n.surge_time, n.surge_depth
        )
        self._counts: Counter[str] = Counter()
        self._inbox: list[tuple[str, Record]] = []
        self._reset()
        self._warm_up()

    def _reset(self) -> None:
        n = self.slots
        self._commands, self._habit = Commands(), Habit(self.parameters.frozen_after)
        self._ring = new_ring(n)
        self._known = VehicleParameters(-1, "map", *prior(self.parameters.dynamics, self.parameters.doubt))
        self._head_ns = self._now_ns = self._first_ns = -1

    # --- the two doors ----------------------------------------------------------------------------------

    def put(self, topic: str, record: Record) -> None:
        """Keep a record for the next advance."""
        self._inbox.append((topic, record))

    def advance(self, now_ns: int) -> list[Output]:
        """Motions up to now; those of steps into which a late command falls are published again, corrected."""
        inbox, self._inbox = self._inbox, []
        out: list[Output] = []
        if now_ns < self._now_ns or (self._head_ns >= 0 and seconds(now_ns - self._head_ns) > self.parameters.max_gap):
            out.append(self._say(now_ns, "clock", f"jumped by {seconds(now_ns - self._now_ns):.3g} s: reset"))
            self._reset()
            self._counts["resets"] += 1
        self._now_ns = now_ns
        restated, fed = self._head_ns, []
        for _, record in inbox:
            if isinstance(record, JointState):
                stamp, said = self._take_command(record)
                restated = min(restated, stamp)
                out += said
            elif isinstance(record, Odometry):
                fed.append(record)
            else:
                assert isinstance(record, VehicleParameters)
                out += self._take_parameters(record)
        changed, said = self._take_feedback(fed)
        out += said
        if self._head_ns < 0:
            self._start(now_ns)
            out.append(self._parameters_now())
        out += self._revise(min(changed, restated), restated)
        return out + self._integrate(now_ns)

    def health(self) -> Health:
        """Whether there are commands, and how many of each kind of record were taken or refused."""
        values: dict[str, int | float | str] = dict(sorted(self._counts.items()))
        if self._head_ns < 0:
            return Health(Level.WARN, "not started", values)
        silence = seconds(self._now_ns - self._commands.newest_ns)
        if self._commands.newest_ns < 0:
            return Health(Level.WARN, "no actuators yet: propeller taken as still, motion uncertain", values)
        if self._habit.frozen:
            same = f"actuators frozen? {self._habit.repeats + 1} equal commands"
            return Health(Level.WARN, f"{same}: last command held, uncertainty grows", values)
        if silence > self.parameters.actuator_timeout:
            return Health(
                Level.WARN, f"actuators silent for {silence:.1f} s: last command held, uncertainty grows", values
            )
        return Health(Level.OK, "running", values)

    # --- taking in --------------------------------------------------------------------------------------

    def _take_command(self, record: JointState) -> tuple[int, list[Output]]:
        """The earliest stamp whose motion it changes, and what is said of it."""
        untouched = self._head_ns
        try:
            values = actuator_values(record)
        except Malformed as error:
            return untouched, [self._say(record.stamp_ns, "actuators", str(error))]
        late = self._head_ns - record.stamp_ns
        if self._head_ns >= 0 and late > self._history_ns:
            self._counts["actuators.late"] += 1
            why = f"older than the history: {seconds(late):.3g} s"
            return untouched, [Output(INNOVATIONS, refusal(record.stamp_ns, _FRAME, "actuators", Verdict.LATE, why))]
        if record.stamp_ns > self._now_ns + nanoseconds(self.parameters.ahead):
            return untouched, [self._say(record.stamp_ns, "actuators", "stamp too far ahead of the clock")]
        frozen = self._habit.hear(record.stamp_ns, values)
        if frozen:  # the last command is held, as in silence
            return untouched, [self._say(record.stamp_ns, "actuators", frozen)]
        self._counts["actuators.used"] += 1
        return (record.stamp_ns if self._commands.put(record.stamp_ns, values) else untouched), []

    def _take_feedback(self, records: list[Odometry]) -> tuple[int, list[Output]]:
        """Dead reckoning's velocity and attitude at stamps of the grid; from when on to re-run our own history."""
        if not records:
            return self._head_ns, []
        stamps = [record.stamp_ns for record in records]
        oldest = max(self._head_ns - self._history_ns, self._first_ns)
        lines = stacked(records, ODOMETRY_SIZE)
        verdicts = feed(self._ring, np.array(stamps, np.int64), lines, oldest, self._head_ns).tolist()
        self._counts.update(_FEEDBACK[verdict] for verdict in verdicts if verdict in _FEEDBACK)
        said = [self._say(t, "deadreck", "not finite") for t, v in zip(stamps, verdicts, strict=True) if v == BROKEN]
        return min([self._head_ns, *(t for t, v in zip(stamps, verdicts, strict=True) if v == FED)]), said

    def _take_parameters(self, record: VehicleParameters) -> list[Output]:
        """Adopt the reference filter's parameters from the next step on; the velocity is not touched."""
        if not usable_parameters(record) or min(record.mean[3:9]) <= 0.0:
            return [self._say(record.stamp_ns, "parameters", "not finite, damping not positive, or not a covariance")]
        self._known = record
        self._counts["parameters.used"] += 1
        return [self._parameters_now()] if self._head_ns >= 0 else []

    def _parameters_now(self) -> Output:
        return Output(PARAMETERS, replace(self._known, stamp_ns=self._head_ns))

    # --- the grid ---------------------------------------------------------------------------------------

    def _slot(self, stamp_ns: int) -> int:
        return (stamp_ns // GRID_NS) % self.slots

    def _start(self, now_ns: int) -> None:
        """At the first command's stamp, or now."""
        first = self._commands.oldest_ns
        recent = 0 <= now_ns - first < nanoseconds(self.parameters.max_gap)
        self._head_ns = (first if first >= 0 and recent else now_ns) // GRID_NS * GRID_NS
        self._first_ns = self._head_ns

    def _revise(self, from_ns: int, restated_ns: int) -> list[Output]:
        """Re-run the states from a stamp on; motions of steps that end after ``restated_ns`` are published again."""
        begin = max(from_ns // GRID_NS * GRID_NS, self._first_ns)
        again = min(max(restated_ns // GRID_NS * GRID_NS, begin), self._head_ns)
        if begin < again:
            self._roll(begin, again, wanted=False)
        motions = self._roll(again, self._head_ns, wanted=True) if again < self._head_ns else []
        self._counts["motions.restated"] += len(motions)
        return motions

    def _integrate(self, now_ns: int) -> list[Output]:
        """The steps from the head up to now."""
        start, end = self._head_ns, now_ns // GRID_NS * GRID_NS
        if end <= start:
            return []
        slots = (start // GRID_NS + np.arange((end - start) // GRID_NS + 1)) % self.slots
        self._ring.parameters[slots[:-1]] = self._known.mean
        self._ring.feedback[slots[1:]] = False  # the ring's last round
        self._head_ns = end
        motions = self._roll(start, end, wanted=True)
        self._commands.forget(end - self._history_ns - GRID_NS)
        return motions

    def _roll(self, start_ns: int, end_ns: int, wanted: bool) -> list[Output]:
        """From one stamp of the grid to another; the motions, where they are wanted."""
        n = (end_ns - start_ns) // GRID_NS
        actuators = self._commands.means(start_ns, GRID_NS, n)
        made = roll(self._ring, self._slot(start_ns), actuators, _DT, self.model, self._levels, wanted)
        if not wanted:
            return []
        if seconds(end_ns - self._commands.in_force_ns(start_ns)) > self.parameters.actuator_timeout:
            ages = self._commands.ages(start_ns, GRID_NS, n)
            for k in np.flatnonzero(ages / NS > self.parameters.actuator_timeout):
                made[k, M_NOISE:MOTION_SIZE] += self._silence(made[k, M_PARAMETERS:M_ATTITUDE]).ravel()
        starts = range(start_ns, end_ns, GRID_NS)
        return [
            Output(MOTION, PredictedMotion.packed(numbers, stamp_ns=start + GRID_NS, start_ns=start))
            for start, numbers in zip(starts, made, strict=True)
        ]

    def _silence(self, parameters: Array) -> Array:
        """What is added to a step's noise (12, 12) when the actuators are silent."""
        noise, q = self.parameters.noise, np.empty((12, 12))
        noise_of_step(2.0 * parameters[3:6] * noise.silence**2, 2.0 * parameters[6:9] * noise.silence_turn**2, _DT, q)
        return q

    def _say(self, stamp_ns: int, sensor: str, reason: str) -> Output:
        self._counts[f"{sensor}.refused"] += 1
        return Output(INNOVATIONS, refusal(stamp_ns, _FRAME, sensor, Verdict.REFUSED, reason))

    def _warm_up(self) -> None:
        """Compile (or load) every kernel now, so that no first message is late."""
        self._head_ns = self._first_ns = 0
        self._integrate(2 * GRID_NS)
        self._roll(0, GRID_NS, wanted=False)
        self._silence(self._known.mean)
        line = stacked([Odometry.packed(np.ones(ODOMETRY_SIZE))], ODOMETRY_SIZE)
        feed(self._ring, np.zeros(1, np.int64), line, 0, 0)
        self._reset()
