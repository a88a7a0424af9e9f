"""A filter's first state, what it waits for before it can have one, and its state after a gap."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fbn_common.motion_ekf.core import State, fresh_sensors
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    DEPTH,
    DEVIATION,
    GRID_NS,
    OWN,
    POSITION,
    ROTATION,
    STEADY,
    TILT,
    VELOCITY,
    WATER,
    X_DEVIATION,
    X_PARAMETERS,
    X_SIZE,
    X_STEADY,
    X_VELOCITY,
)
from fbn_common.motion_ekf.measure import deviation_waves
from fbn_common.motion_ekf.parameters import FilterParameters
from fbn_common.motion_ekf.propagate import set_rotation
from fbn_common.motion_ekf.sensors import compass_data, depth_data
from fbn_common.motion_ekf.timeline import MotionLog
from fbn_common.records import FluidPressure, Imu, Record, VehicleParameters
from fbn_common.types import Array, nanoseconds

_VELOCITY_SIGMA = np.array([0.5, 0.3, 0.3, 0.3, 0.3, 0.3])  # m/s, rad/s: a vehicle at rest or under way


@dataclass(slots=True)
class FirstData:
    """What a filter waits for: the vehicle's parameters, compass, depth (not for ever), and motions over both."""

    parameters: FilterParameters
    prior: VehicleParameters | None = None
    compass: list[Imu] = field(default_factory=list)
    depth: list[FluidPressure] = field(default_factory=list)

    def keep(self, record: Record) -> None:
        """Keep a measurement that may be the first."""
        if isinstance(record, Imu):
            self.compass.append(record)
        elif isinstance(record, FluidPressure):
            self.depth.append(record)

    def forget(self) -> None:
        """Forget the measurements; the vehicle's parameters stay."""
        self.compass, self.depth = [], []

    def stamp(self, motions: MotionLog, now_ns: int) -> int:
        """The first stamp by which compass and depth have measured and motions reach; -1 if it has not come yet."""
        if self.prior is None or motions.first_ns < 0 or not self.compass:
            return -1
        patient = now_ns - self.compass[0].stamp_ns < nanoseconds(self.parameters.history.start_timeout)
        if not self.depth and self.parameters.depth.use and patient:
            return -1
        firsts = [min(r.stamp_ns for r in records) for records in (self.compass, self.depth) if records]
        t0 = max(motions.first_ns, *firsts)
        reached = t0 < motions.newest_ns and motions.has((t0 // GRID_NS + 1) * GRID_NS)
        return t0 if reached else -1

    def state(self, t0: int, motions: MotionLog, xy: tuple[float, float, float], own: Array, rows: int) -> State:
        """The state at that stamp; ``xy`` are x, y [m] and their variance [m^2], the rest as :func:`first_state`."""
        assert self.prior is not None
        imu = max((r for r in self.compass if r.stamp_ns <= t0), key=lambda r: r.stamp_ns)
        pressure = max((r for r in self.depth if r.stamp_ns <= t0), key=lambda r: r.stamp_ns, default=None)
        compass, depth = compass_data(imu, self.parameters.compass), None
        if pressure is not None:
            depth = depth_data(pressure, self.parameters.depth)
            depth[0] -= compass[6:9] @ np.array(self.parameters.depth.position)
        velocity = motions.rows.mean[(t0 // GRID_NS + 1) % len(motions.rows.stamp), 6:12]
        wander = self.parameters.walk.wander**2
        state = first_state(t0, compass, depth, self.prior, velocity, xy[2], own, wander, rows)
        state.x[:2] = xy[:2]
        return state


def first_state(
    stamp_ns: int,
    compass: Array,
    depth: Array | None,
    prior: VehicleParameters,
    velocity: Array,
    xy_variance: float,
    own: Array,
    wander: float,
    rows: int,
) -> State:
    """Attitude and z from the first measurements, with their errors correlated to the sensors' own.

    ``compass`` (18,) and ``depth`` (2,) as in the timeline (:mod:`fbn_common.motion_ekf.sensors`), depth already
    that of the origin; ``own`` the stationary variances of the states from OWN on; ``wander`` as in the kernels'
    numbers; ``rows`` of sensors.
    """
    size = OWN + len(own)
    x, p = np.zeros(X_SIZE), np.zeros((size, size))
    r, white = compass[:9].reshape(3, 3), compass[9:].reshape(3, 3)
    set_rotation(x, np.ascontiguousarray(r))
    x[X_PARAMETERS:X_DEVIATION], x[X_VELOCITY : X_VELOCITY + 6] = prior.mean, velocity
    p[POSITION, POSITION] = p[POSITION + 1, POSITION + 1] = xy_variance
    p[VELOCITY : VELOCITY + 6, VELOCITY : VELOCITY + 6] = np.diag(_VELOCITY_SIGMA**2)
    p[ACTUATION : WATER + 3, ACTUATION : WATER + 3] = prior.covariance + 1e-12 * np.eye(15)
    p[OWN:, OWN:] = np.diag(own)
    _divide_water(x, p, wander)
    waves = deviation_waves(np.ascontiguousarray(r))
    h = np.column_stack(
        (np.eye(3)[:, :2], np.outer(r[2], waves))
    )  # the compass's own errors turn the attitude the other way
    errors = np.r_[TILT : TILT + 2, DEVIATION : DEVIATION + 5]
    attitude = slice(ROTATION, ROTATION + 3)
    p[attitude, errors] = -h * p[errors, errors]
    p[errors, attitude] = p[attitude, errors].T
    p[attitude, attitude] = r.T @ white @ r + (h * p[errors, errors]) @ h.T
    if depth is None:
        p[2, 2] = 100.0
    else:
        x[2], p[2, 2] = depth[0], depth[1] + p[DEPTH, DEPTH]
        p[2, DEPTH] = p[DEPTH, 2] = -p[DEPTH, DEPTH]
    return State(stamp_ns, x, p, fresh_sensors(rows))


def _divide_water(x: Array, p: Array, wander: float) -> None:
    """The water of the prior is a steady part, and the share of its variance by which it wanders about that."""
    water, steady = slice(WATER, WATER + 2), slice(STEADY, STEADY + 2)
    x[X_STEADY : X_STEADY + 2] = x[X_PARAMETERS + 12 : X_PARAMETERS + 14]
    p[steady, :] = p[water, :] / (1.0 + wander)
    p[:, steady] = p[steady, :].T
    p[steady, steady] = p[water, water] / (1.0 + wander)


def state_after_gap(state: State, stamp_ns: int, drift_speed: float) -> State:
    """The state at a later stamp with nothing known of the motion between: position kept, with what it may be off."""
    t, x, p, sensors = state.copy()
    opened = np.zeros(len(p))
    opened[:3] = (drift_speed * (stamp_ns - t) * 1e-9) ** 2
    opened[ROTATION : ROTATION + 3] = 1.0
    opened[VELOCITY : VELOCITY + 6] = _VELOCITY_SIGMA**2
    return State(stamp_ns // GRID_NS * GRID_NS, x, p + np.diag(opened), sensors)
