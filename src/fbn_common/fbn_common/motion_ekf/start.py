"""A filter's first state, and its state after a gap."""

from __future__ import annotations

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
    TILT,
    VELOCITY,
    WATER,
    X_DEVIATION,
    X_PARAMETERS,
    X_SIZE,
    X_VELOCITY,
)
from fbn_common.motion_ekf.measure import deviation_waves
from fbn_common.motion_ekf.propagate import set_rotation
from fbn_common.records import VehicleParameters
from fbn_common.types import Array

_VELOCITY_SIGMA = np.array([0.5, 0.3, 0.3, 0.3, 0.3, 0.3])  # m/s, rad/s: a vehicle at rest or under way


def first_state(
    stamp_ns: int,
    compass: Array,
    depth: Array | None,
    prior: VehicleParameters,
    velocity: Array,
    xy_variance: float,
    own: Array,
    rows: int,
) -> State:
    """Attitude and z from the first measurements, with their errors correlated to the sensors' own.

    ``compass`` (18,) and ``depth`` (2,) as in the timeline (:mod:`fbn_common.motion_ekf.sensors`), depth already
    that of the origin; ``own`` the stationary variances of the considered sensor states; ``rows`` of sensors.
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


def state_after_gap(state: State, stamp_ns: int, drift_speed: float) -> State:
    """The state at a later stamp with nothing known of the motion between: position kept, with what it may be off."""
    t, x, p, sensors = state.copy()
    opened = np.zeros(len(p))
    opened[:3] = (drift_speed * (stamp_ns - t) * 1e-9) ** 2
    opened[ROTATION : ROTATION + 3] = 1.0
    opened[VELOCITY : VELOCITY + 6] = _VELOCITY_SIGMA**2
    return State(stamp_ns // GRID_NS * GRID_NS, x, p + np.diag(opened), sensors)
