"""Predict: forces and torques on the vehicle, integrated into motion between measurements (100 Hz)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from fbn_common.estimator import Health, Level, Output
from fbn_common.lie import matrix_from_quaternion, quaternion_from_matrix, so3_exp
from fbn_common.motion_ekf.layout import GRID_NS
from fbn_common.motion_ekf.monitor import all_finite, refusal
from fbn_common.records import JointState, Odometry, PredictedMotion, Record, VehicleParameters, Verdict
from fbn_common.types import Array, nanoseconds, seconds
from fbn_predict.commands import ACTUATORS, Commands, Malformed, actuator_values
from fbn_predict.dynamics import COLUMNS, model_of, noise_of_step, step
from fbn_predict.parameters import PredictParameters, prior

_DT = GRID_NS * 1e-9
_UNKNOWN_DEPTH = 1.0  # m, until dead reckoning says: neither at the surface nor out of the waves
_FRAME = "base_link"
MOTION, PARAMETERS, INNOVATIONS = "predict/motion", "predict/parameters", "predict/innovations"


class Predict:
    """The vehicle's model run on a grid of 10 ms, with a history in which late commands and feedback are worked in."""

    def __init__(self, parameters: PredictParameters) -> None:
        self.parameters = parameters
        self.model = model_of(parameters.dynamics)
        self.slots = int(nanoseconds(parameters.history) / GRID_NS) + 200
        self._linear, self._angular = np.array(parameters.noise.velocity), np.array(parameters.noise.turn_rate)
        self._reset()
        self._warm_up()

    def _reset(self) -> None:
        n = self.slots
        self._inbox: list[tuple[str, Record]] = []
        self._commands = Commands()
        self._velocity, self._attitude = np.zeros((n, 6)), np.tile(np.eye(3), (n, 1, 1))  # at the grid stamps
        self._depth = np.full(n, _UNKNOWN_DEPTH)
        self._used = np.zeros((n, 15))  # parameters, by the step that starts there
        self._rebased: dict[int, tuple[Array, Array, float]] = {}
        self._prior = prior(self.parameters.dynamics, self.parameters.doubt)
        self._mean, self._covariance = self._prior.mean.copy(), self._prior.covariance.copy()
        self._head_ns = self._now_ns = self._first_ns = -1
        self._counts: Counter[str] = getattr(self, "_counts", Counter())

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
        changed = restated = self._head_ns
        for topic, record in inbox:
            if isinstance(record, JointState):
                stamp, said = self._take_command(record)
                restated = min(restated, stamp)
            elif isinstance(record, Odometry):
                stamp, said = self._take_feedback(record)
                changed = min(changed, stamp)
            else:
                assert isinstance(record, VehicleParameters)
                said = self._take_parameters(record)
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
        if silence > self.parameters.actuator_timeout:
            return Health(Level.WARN, f"actuators silent for {silence:.1f} s: last command held, uncertainty grows", values)
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
        if self._head_ns >= 0 and late > nanoseconds(self.parameters.history):
            self._counts["actuators.late"] += 1
            why = f"older than the history: {seconds(late):.3g} s"
            return untouched, [Output(INNOVATIONS, refusal(record.stamp_ns, _FRAME, "actuators", Verdict.LATE, why))]
        if record.stamp_ns > self._now_ns + nanoseconds(self.parameters.ahead):
            return untouched, [self._say(record.stamp_ns, "actuators", "stamp too far ahead of the clock")]
        self._counts["actuators.used"] += 1
        return (record.stamp_ns if self._commands.put(record.stamp_ns, values) else untouched), []

    def _take_feedback(self, record: Odometry) -> tuple[int, list[Output]]:
        """Dead reckoning's velocity and attitude at a stamp of the grid: our own history is re-run from there."""
        known = 0 <= self._head_ns - record.stamp_ns <= nanoseconds(self.parameters.history)
        if not all_finite(record.twist, record.pose.orientation, record.pose.position) or not record.pose.orientation.any():
            return self._head_ns, [self._say(record.stamp_ns, "deadreck", "not finite")]
        if not known or record.stamp_ns % GRID_NS != 0:
            self._counts["feedback.unused"] += 1
            return self._head_ns, []
        attitude = np.asarray(matrix_from_quaternion(record.pose.orientation))
        self._rebased[record.stamp_ns] = (record.twist.copy(), attitude, float(-record.pose.position[2]))
        self._counts["feedback.used"] += 1
        return record.stamp_ns, []

    def _take_parameters(self, record: VehicleParameters) -> list[Output]:
        """Adopt the reference filter's parameters from the next step on; the velocity is not touched."""
        c = record.covariance
        if not all_finite(record.mean, c) or min(record.mean[3:9]) <= 0.0 or np.linalg.eigvalsh(0.5 * (c + c.T))[0] < 0.0:
            return [self._say(record.stamp_ns, "parameters", "not finite, damping not positive, or not a covariance")]
        self._mean, self._covariance = record.mean.copy(), record.covariance.copy()
        self._counts["parameters.used"] += 1
        return [self._parameters_now()] if self._head_ns >= 0 else []

    def _parameters_now(self) -> Output:
        record = VehicleParameters(self._head_ns, "map", self._mean.copy(), self._covariance.copy())
        return Output(PARAMETERS, record)

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
        out = []
        t = max(from_ns // GRID_NS * GRID_NS, self._first_ns)
        while t < self._head_ns:
            again = t + GRID_NS > restated_ns
            motion = self._step(t, wanted=again)
            if motion is not None:
                self._counts["motions.restated"] += 1
                out.append(Output(MOTION, motion))
            t += GRID_NS
        return out

    def _integrate(self, now_ns: int) -> list[Output]:
        out = []
        while self._head_ns + GRID_NS <= now_ns:
            self._used[self._slot(self._head_ns)] = self._mean
            motion = self._step(self._head_ns, wanted=True)
            assert motion is not None
            out.append(Output(MOTION, motion))
            self._head_ns += GRID_NS
        oldest = self._head_ns - nanoseconds(self.parameters.history) - GRID_NS
        for stamp in [s for s in self._rebased if s < oldest]:
            del self._rebased[stamp]
        self._commands.forget(oldest)
        return out

    def _step(self, start_ns: int, wanted: bool) -> PredictedMotion | None:
        """From one stamp of the grid to the next; the motion where it is wanted."""
        k, n = self._slot(start_ns), self._slot(start_ns + GRID_NS)
        if start_ns in self._rebased:
            self._velocity[k], self._attitude[k], self._depth[k] = self._rebased[start_ns]
        actuators = self._commands.mean(start_ns, start_ns + GRID_NS)
        y, s = np.empty(12), np.empty((12, COLUMNS))
        velocity, attitude, depth = self._velocity[k], self._attitude[k], float(self._depth[k])
        step(velocity, attitude, self._used[k], actuators, depth, _DT, self.model, y, s, wanted)
        self._velocity[n], self._attitude[n], self._depth[n] = y[6:], attitude @ so3_exp(y[3:6]), depth
        if not wanted:
            return None
        return PredictedMotion(
            stamp_ns=start_ns + GRID_NS,
            start_ns=start_ns,
            increment=y[0:3].copy(),
            rotation=y[3:6].copy(),
            velocity_start=velocity.copy(),
            velocity_end=y[6:].copy(),
            parameters=self._used[k].copy(),
            jacobian_velocity=s[:, 0:6].copy(),
            jacobian_attitude=s[:, 6:9].copy(),
            jacobian_parameters=s[:, 9:24].copy(),
            noise=self._noise(start_ns, k, depth),
            attitude_start=quaternion_from_matrix(attitude),
        )

    def _noise(self, start_ns: int, k: int, depth: float) -> Array:
        """Covariance (12, 12) of a step: standing velocity errors as white accelerations, and wave surge."""
        p, noise = self._used[k], self.parameters.noise
        linear, angular = self._linear**2, self._angular**2
        silence = seconds(start_ns - self._commands.last_before(start_ns))
        if silence > self.parameters.actuator_timeout:
            linear, angular = linear + noise.silence**2, angular + noise.silence_turn**2
        surge = noise.surge * np.exp(-max(depth, 0.0) / noise.surge_depth)
        linear = 2.0 * p[3:6] * linear + 2.0 * noise.surge_time * (p[3:6] * surge) ** 2
        q = np.empty((12, 12))
        noise_of_step(linear, 2.0 * p[6:9] * angular, _DT, q)
        return q

    def _say(self, stamp_ns: int, sensor: str, reason: str) -> Output:
        self._counts[f"{sensor}.refused"] += 1
        return Output(INNOVATIONS, refusal(stamp_ns, _FRAME, sensor, Verdict.REFUSED, reason))

    def _warm_up(self) -> None:
        """Compile (or load) every kernel now, so that no first message is late."""
        y, s, q = np.empty(12), np.empty((12, COLUMNS)), np.empty((12, 12))
        for wanted in (False, True):
            step(np.zeros(6), np.eye(3), self._mean, np.zeros(len(ACTUATORS)), 1.0, _DT, self.model, y, s, wanted)
        noise_of_step(np.ones(3), np.ones(3), _DT, q)
        quaternion_from_matrix(self._attitude[0] @ so3_exp(y[3:6]))
        matrix_from_quaternion(np.array([0.0, 0.0, 0.0, 1.0]))

