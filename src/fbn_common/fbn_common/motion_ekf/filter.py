"""What the dead-reckoning and the reference filter have in common: intake, start, odometry, answers, health."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fbn_common.estimator import Health, Level, Output
from fbn_common.motion_ekf.adopt import adopt_covariance, joint_covariance, usable_parameters
from fbn_common.motion_ekf.core import MotionEkf, State
from fbn_common.motion_ekf.intake import Intake
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    CLIMB_ROW,
    COMPASS_ROW,
    DAMPING,
    DEPTH_ROW,
    GRID_NS,
    OWN,
    POSITION,
    ROTATION,
    SIZE_DEADRECK,
    SNAPSHOT_NS,
    X_DEVIATION,
    Config,
    IntArray,
    Kind,
)
from fbn_common.motion_ekf.monitor import Watch, content_of, health_of, refusal
from fbn_common.motion_ekf.output import odometry
from fbn_common.motion_ekf.parameters import (
    AltimeterParameters,
    CompassParameters,
    DepthParameters,
    HistoryParameters,
    SurfaceParameters,
    WalkParameters,
    considered,
    quantile_table,
    walk_densities,
)
from fbn_common.motion_ekf.sensors import Unusable, altitude_data, compass_data, depth_data
from fbn_common.motion_ekf.start import first_state, state_after_gap
from fbn_common.motion_ekf.warm_up import warm_up
from fbn_common.parameters import group
from fbn_common.records import FluidPressure, Imu, PredictedMotion, Record, VehicleParameters, Verdict
from fbn_common.types import Array, nanoseconds, seconds

_BRIDGE = np.array([0.02, 0.02, 0.02, 0.05, 0.05, 0.05])  # m^2/s^3, rad^2/s^3: 0.15 m/s and 0.2 rad/s after 1 s


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Parameters that both filters have."""

    compass: CompassParameters = group(CompassParameters)
    depth: DepthParameters = group(DepthParameters)
    altimeter: AltimeterParameters = group(AltimeterParameters)
    walk: WalkParameters = group(WalkParameters)
    surface: SurfaceParameters = group(SurfaceParameters)
    history: HistoryParameters = group(HistoryParameters)


class MotionFilter:
    """Base of both filters; a subclass adds its own topics, its start in x and y, and its services."""

    name = ""
    frame_id = ""
    size = SIZE_DEADRECK
    estimated = ACTUATION + 3

    def __init__(self, parameters: FilterParameters, ranks: dict[str, int], rows: int) -> None:
        self.parameters = parameters
        self.ranks = ranks
        self.intakes = self._common_intakes()
        self.rows = rows
        self.resets = self._bridged = 0
        self._inbox: list[tuple[str, Record]] = []
        self._prior: VehicleParameters | None = None
        self._now_ns: int = -1
        self._odometry_ns: int = -1
        self._restart()
        self._warm_up()

    # --- what a subclass says ---------------------------------------------------------------------------

    def config(self) -> Config:
        """The kernels' numbers."""
        p = self.parameters
        walk, limit = walk_densities(p.walk)
        tau, variance = considered(p.compass, p.depth, p.surface)
        lockout, lever = np.full(len(Kind), 1e18), np.zeros((len(Kind), 3))
        gates = {i.kind: i.parameters.gate for i in self.intakes.values()}
        for intake in self.intakes.values():
            lockout[intake.kind] = intake.parameters.lockout
        lever[Kind.DEPTH] = p.depth.position
        return Config(
            self.estimated, self.corrects(), SNAPSHOT_NS, walk, limit, p.walk.water_share**2 / 3600.0, tau, variance,
            p.compass.dip, p.compass.wave_acceleration, p.compass.wave_depth, p.surface.depth, p.surface.layer_depth,
            p.depth.density_sigma / p.depth.bias, quantile_table(gates), lockout, lever, 1.0, 1.0, 1.0, True, 60.0,
        )  # fmt: skip

    def corrects(self) -> IntArray:
        """Error states (kinds, 2) that each kind of measurement corrects, first and last + 1.

        Compass, depth and altimeter do not see x, y, thrust, damping and water, and what the model makes of them by
        way of its lateral forces is its own error: they correct z, attitude, velocity and angular actuation.
        """
        return np.tile(np.array([POSITION + 2, ACTUATION + 3], np.int64), (len(Kind), 1))

    def position_variance(self) -> float:
        """Of x and y at the start [m^2]."""
        return 1e-4

    def take(self, topic: str, record: Record, now_ns: int) -> list[Output]:
        """Take in a record of a topic of the subclass's own."""
        return []

    def settle(self, now_ns: int) -> list[Output]:
        """Decide on what the subclass kept back, with the head where it is."""
        return []

    def services(self, now_ns: int) -> list[Output]:
        """What else there is to publish after an advance."""
        return []

    def notes(self) -> list[str]:
        """What else there is to complain of."""
        return []

    # --- the two doors ----------------------------------------------------------------------------------

    def put(self, topic: str, record: Record) -> None:
        """Keep a record for the next advance."""
        self._inbox.append((topic, record))

    def advance(self, now_ns: int) -> list[Output]:
        """Process all that is stamped up to now, as far as the predicted motions reach."""
        out: list[Output] = []
        inbox, self._inbox = self._inbox, []
        if now_ns < self._now_ns:
            out.append(
                self._say(
                    now_ns, "clock", Verdict.REFUSED, f"went back by {seconds(self._now_ns - now_ns):.3g} s: reset"
                )
            )
            self._restart()
            self.resets += 1
        self._now_ns = now_ns
        out += self._take_motions([record for _, record in inbox if isinstance(record, PredictedMotion)])
        for topic, record in inbox:
            if not isinstance(record, PredictedMotion):
                out += self._admit(topic, record, now_ns)
        if self.ekf.head_ns < 0:
            out += self._try_start(now_ns)
        if self.ekf.head_ns >= 0:
            self.ekf.advance(now_ns)
            out += self._bridge(now_ns)
            out += self.settle(now_ns)
            out += self._answers()
            out += self._odometry()
            out += self.services(now_ns)
        return out

    def health(self) -> Health:
        """One line, and the counters of all sensors."""
        notes = self.notes()
        values: dict[str, int | float | str] = {
            "reruns": self.ekf.reruns,
            "bridged": self._bridged,
            "resets": self.resets,
        }
        if self.ekf.head_ns < 0:
            wanted = "first compass, depth, motion and parameters"
            health = health_of(self._watches(), self._now_ns, [f"waiting for {wanted}", *notes], values)
            return replace(health, level=Level.WARN)
        behind = seconds(self._now_ns - self.ekf.head_ns)
        values["behind_s"] = round(behind, 3)
        if behind > 1.0:
            notes.append(f"no predicted motion for {behind:.1f} s")
        return health_of(self._watches(), self._now_ns, notes, values)

    # --- intake -----------------------------------------------------------------------------------------

    def _common_intakes(self) -> dict[str, Intake]:
        p = self.parameters
        return {
            "imu/data": Intake(
                "compass", p.compass, Kind.COMPASS, COMPASS_ROW,
                lambda r: compass_data(r, p.compass), lambda r: content_of(r.orientation),
            ),
            "pressure": Intake(
                "depth", p.depth, Kind.DEPTH, DEPTH_ROW,
                lambda r: depth_data(r, p.depth), lambda r: content_of(r.fluid_pressure),
            ),
            "altitude": Intake(
                "altimeter", p.altimeter, Kind.CLIMB, CLIMB_ROW,
                lambda r: altitude_data(r, p.altimeter), lambda r: content_of(r.range),
            ),
        }  # fmt: skip

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
        head, history = self.ekf.head_ns, self.parameters.history
        oldest = max(self.ekf.base.stamp_ns + 1, head - self.ekf.history_ns) if head >= 0 else 0
        bounds = (oldest, now_ns + nanoseconds(history.ahead))
        objection = intake.watch.objection(record.stamp_ns, intake.content(record), bounds)
        if not intake.parameters.use:
            objection = (Verdict.REFUSED, "switched off by parameter")
        if objection is not None:
            return None, [self._refuse(intake, record.stamp_ns, *objection)]
        try:
            data = intake.data(record)
        except Unusable as error:
            return None, [self._refuse(intake, record.stamp_ns, Verdict.REFUSED, str(error))]
        if data is None:
            intake.watch.verdicts["NO_BOTTOM"] += 1
        return data, []

    def enter(self, intake: Intake, topic: str, record: Any, data: Array) -> list[Output]:
        """Put a measurement that nothing speaks against into the timeline."""
        slot = self.ekf.put_event(record.stamp_ns, self.ranks[topic], intake.kind, intake.row, data)
        if slot < 0:
            return [self._refuse(intake, record.stamp_ns, Verdict.REFUSED, "more measurements than the history holds")]
        self._pending[slot] = intake
        if intake.kind in (Kind.COMPASS, Kind.DEPTH) and self.ekf.head_ns < 0:
            self._first.setdefault(intake.kind, []).append(record)
        return []

    def _take_motions(self, motions: list[PredictedMotion]) -> list[Output]:
        oldest, out = self.ekf.head_ns - self.ekf.history_ns, []
        for motion, error in zip(motions, self.ekf.put_motions(*motions), strict=True):
            why = "older than the history" if motion.stamp_ns < oldest else error
            if why:
                out.append(self._say(motion.stamp_ns, "predict", Verdict.REFUSED, why))
        return out

    def _take_parameters(self, record: VehicleParameters) -> list[Output]:
        if not usable_parameters(record):
            return [self._say(record.stamp_ns, "parameters", Verdict.REFUSED, "not finite, or not a covariance")]
        if self._prior is None:
            self._prior = record
        elif self.estimated == ACTUATION + 3:  # who estimates them all is the one they come from
            slot = self.ekf.put_event(
                record.stamp_ns, self.ranks["predict/parameters"], Kind.PARAMETERS, CLIMB_ROW, np.zeros(1)
            )
            self._adoptions[slot] = record
        return []

    def _adopt(self, slot: int, x: Array, p: Array) -> None:
        """Take over what reference knows; the mean of the considered parameters comes with each motion."""
        record = self._adoptions.get(slot)
        if record is None:
            return
        known = joint_covariance(record)[3:, 3:]
        if len(known) > 12:
            x[X_DEVIATION:] = record.further
        states, attitude = slice(DAMPING, DAMPING + len(known)), slice(ROTATION, ROTATION + 3)
        adopt_covariance(p, states, known + 1e-12 * np.eye(len(known)), attitude)

    # --- start, gaps ------------------------------------------------------------------------------------

    def _restart(self) -> None:
        """Forget all but the parameters: at construction, and when the clock went back."""
        for intake in self.intakes.values():
            intake.reset()
        self.ekf = MotionEkf(self.size, self.rows, self.config(), self.parameters.history.length, self._adopt)
        self._pending: dict[int, Intake] = {}
        self._adoptions: dict[int, VehicleParameters] = {}
        self._first: dict[Kind, list[Any]] = {}
        self._now_ns = self._odometry_ns = -1

    def _try_start(self, now_ns: int) -> list[Output]:
        """Start at the first stamp by which compass and depth have measured and motions reach."""
        compass, depth = self._first.get(Kind.COMPASS, []), self._first.get(Kind.DEPTH, [])
        motions = self.ekf.motions
        if self._prior is None or motions.first_ns < 0 or not compass:
            return []
        patient = now_ns - compass[0].stamp_ns < nanoseconds(self.parameters.history.start_timeout)
        if not depth and self.parameters.depth.use and patient:
            return []
        firsts = [motions.first_ns, min(r.stamp_ns for r in compass)]
        if depth:
            firsts.append(min(r.stamp_ns for r in depth))
        t0 = max(firsts)
        if t0 >= motions.newest_ns or not motions.has((t0 // GRID_NS + 1) * GRID_NS):
            return []
        imu = max((r for r in compass if r.stamp_ns <= t0), key=lambda r: r.stamp_ns)
        pressure = max((r for r in depth if r.stamp_ns <= t0), key=lambda r: r.stamp_ns, default=None)
        self.ekf.start(self._initial(t0, imu, pressure))
        self._first.clear()
        return self._too_early(t0)

    def _initial(self, t0: int, imu: Imu, pressure: FluidPressure | None) -> State:
        """The state at the start, from the first measurements."""
        assert self._prior is not None
        compass, motions = compass_data(imu, self.parameters.compass), self.ekf.motions.rows
        k = (t0 // GRID_NS + 1) % len(motions.stamp)
        depth = None
        if pressure is not None:
            depth = depth_data(pressure, self.parameters.depth)
            depth[0] -= compass[6:9] @ np.array(self.parameters.depth.position)
        own = self.ekf.config.variance[: self.size - OWN]
        velocity = motions.mean[k, 6:12]
        return first_state(t0, compass, depth, self._prior, velocity, self.position_variance(), own, self.rows)

    def _too_early(self, t0: int, why: str = "before the filter's start") -> list[Output]:
        """Answer what was measured before a start and will not be processed."""
        out = []
        n = self.ekf.events.after(t0)
        for slot in self.ekf.events.slots[:n]:
            intake = self._pending.pop(slot, None)
            if intake is not None:
                self.ekf.events.rows.verdict[slot] = Verdict.REFUSED  # nobody is to take it for a used one
                stamp = int(self.ekf.events.rows.stamp[slot])
                out.append(self._refuse(intake, stamp, Verdict.REFUSED, why))
        return out

    def _bridge(self, now_ns: int) -> list[Output]:
        """Step over motions that never came: hold the velocity; after a long gap start anew, position kept."""
        ekf, h = self.ekf, self.parameters.history
        head, newest = ekf.head_ns, ekf.motions.newest_ns
        missing = not ekf.motions.has(head + GRID_NS)
        if not missing or newest - head < nanoseconds(h.patience) or now_ns - head < nanoseconds(h.patience):
            return []
        if newest - head > nanoseconds(h.max_gap):
            return self._leap(newest - GRID_NS)
        end = head + GRID_NS
        while not ekf.motions.has(end):
            ekf.motions.bridge(end, _BRIDGE)
            self._bridged += 1
            end += GRID_NS
        said = self._say(
            head, "predict", Verdict.REFUSED, f"motions of {seconds(end - GRID_NS - head):.2f} s missing: velocity held"
        )
        ekf.advance(now_ns)
        return [said]

    def _leap(self, t1: int) -> list[Output]:
        """Go on at ``t1`` with the position as it was, uncertain by what may have happened in the gap."""
        gap = seconds(t1 - self.ekf.head_ns)
        self.ekf.start(state_after_gap(self.ekf.state, t1, self.parameters.history.drift_speed))
        self._odometry_ns = -1
        self.resets += 1
        why = f"gap of {gap:.1f} s in the motions: started anew, position kept"
        skipped = self._too_early(self.ekf.head_ns, "in a gap of the motions")
        return [self._say(t1, "predict", Verdict.REFUSED, why), *skipped]

    # --- what goes out ----------------------------------------------------------------------------------

    def _answers(self) -> list[Output]:
        """One innovation for each measurement that was processed for the first time."""
        out = []
        stamp, head = self.ekf.events.rows.stamp.item, self.ekf.head_ns
        for _, slot in sorted((stamp(slot), slot) for slot in self._pending if stamp(slot) <= head):
            answer = self._pending.pop(slot).answer(self.ekf.events.rows, slot, self.frame_id)
            out.append(Output(f"{self.name}/innovations", answer))
        return out

    def _refuse(self, intake: Intake, stamp_ns: int, verdict: Verdict, reason: str) -> Output:
        intake.watch.verdicts[verdict.name] += 1
        return self._say(stamp_ns, intake.sensor, verdict, reason)

    def _say(self, stamp_ns: int, sensor: str, verdict: Verdict, reason: str) -> Output:
        return Output(f"{self.name}/innovations", refusal(stamp_ns, self.frame_id, sensor, verdict, reason))

    def _odometry(self) -> list[Output]:
        """Odometry at each multiple of SNAPSHOT_NS that the head has passed since the last one."""
        first = self._odometry_ns + SNAPSHOT_NS
        if self._odometry_ns < 0:
            first = -(-self.ekf.base.stamp_ns // SNAPSHOT_NS) * SNAPSHOT_NS
        stamps = range(first, self.ekf.head_ns + 1, SNAPSHOT_NS)
        if not stamps:
            return []
        self._odometry_ns = stamps[-1]
        rows = [row for stamp in stamps if (row := self.ekf.snapshot_row(stamp)) >= 0] if self.publishes() else []
        topic = f"{self.name}/odometry"
        return [Output(topic, record) for record in odometry(self.ekf.snapshots, rows, self.frame_id)]

    def publishes(self) -> bool:
        """Whether there is odometry to publish at all."""
        return True

    def _warm_up(self) -> None:
        """Compile (or load) every kernel now, so that no first message is late."""
        warm_up(self.ekf.config, self.size, self.rows)

    def _watches(self) -> dict[str, Watch]:
        return {i.sensor: i.watch for i in self.intakes.values()}
