"""The dead service: from the filter's states at two pings to an increment and an earth measurement.

See docs/equations/deadreck.md, "Dead service".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.lie import quaternion_from_matrix, rpy_from_matrix, rpy_jacobian, skew
from fbn_common.motion_ekf.adopt import gained_information
from fbn_common.motion_ekf.core import State
from fbn_common.motion_ekf.layout import DAMPING, DEVIATION, THRUST, VELOCITY, WATER, X_PARAMETERS, X_VELOCITY
from fbn_common.motion_ekf.measure import deviation_waves
from fbn_common.motion_ekf.propagate import rotation_of
from fbn_common.records import Pose
from fbn_common.types import Array, Mat3, Mat4, Mat6, Vec3

_EARTH = slice(2, 6)  # z and rotation within the pose's error
_SLOW = [DAMPING, THRUST, WATER, WATER + 1]  # what drift is made of
_FLOOR = np.array([1e-8, 1e-8, 1e-8, 1e-10, 1e-10, 1e-10])  # m^2, rad^2: keeps an increment's covariance invertible


class Increment(NamedTuple):
    """Motion from one ping to the next, in the body frame of the first, with its white covariance."""

    translation: Vec3
    rotation: Mat3
    covariance: Mat6


def earth_of(x: Array) -> Array:
    """z, roll, pitch, yaw (4,) of a state."""
    return np.concatenate((x[2:3], rpy_from_matrix(rotation_of(x))))


def earth_covariance(x: Array, pose_covariance: Array) -> Mat4:
    """Covariance (4, 4) of z, roll, pitch, yaw from that of the pose (6, 6)."""
    j = np.eye(4)
    j[1:, 1:] = rpy_jacobian(rpy_from_matrix(rotation_of(x)))
    c = j @ pose_covariance[_EARTH, _EARTH] @ j.T
    return np.asarray(0.5 * (c + c.T))


def pushed(first: Array, translation: Vec3, rotation: Mat3) -> Mat6:
    """Jacobian (6, 6) of the second pose's error by the first's, for an exact increment between them."""
    f = np.eye(6)
    f[:3, 3:] = -rotation_of(first) @ skew(translation)
    f[3:, 3:] = rotation.T
    return f


def into_world(first: Array, rotation: Mat3) -> Mat6:
    """Jacobian (6, 6) of the second pose's error by the increment's (xyz in the first body frame, rotation)."""
    g = np.eye(6)
    g[:3, :3] = rotation_of(first)
    return g


class Lasting(NamedTuple):
    """Covariance of the errors that stay from ping to ping."""

    drift: Mat3  # m^2/s^2: world x, world y, body forward
    heading: float  # rad, standard deviation: the compass's deviation at this attitude, which no pings average away
    heading_drift: Vec3  # rad m/s, of yaw's error with the drift


def lasting_errors(state: State) -> Lasting:
    """The slow part of the errors of ground velocity and yaw, which GPS on one heading learns together.

    Forward speed is ``K f / D``: its relative error is that of K less that of D.  Increments are in the body, so the
    water's own velocity turns with yaw: at the true heading it is off by ``yaw error x water`` more.
    """
    x, waves = state.x, deviation_waves(rotation_of(state.x))
    water = x[X_PARAMETERS + 12 : X_PARAMETERS + 15]
    speed = x[X_VELOCITY] - rotation_of(x)[:, 0] @ water
    j = np.zeros((4, len(_SLOW) + len(waves)))  # drift, yaw
    j[3, len(_SLOW) :] = -waves  # the compass shows yaw and deviation: what is missing of one is in the other
    j[0, 2] = j[1, 3] = 1.0
    j[:2] += np.outer([water[1], -water[0]], j[3])
    j[2, 0] = -speed / x[X_PARAMETERS + 3]
    j[2, 1] = speed / x[X_PARAMETERS + 9]
    at = [*_SLOW, *range(DEVIATION, DEVIATION + len(waves))]
    joint = j @ state.covariance[np.ix_(at, at)] @ j.T
    return Lasting(joint[:3, :3], float(np.sqrt(joint[3, 3])), joint[3, :3])


def fast_velocity(state: State) -> Mat3:
    """Covariance (3, 3) of the linear velocity given what drift is made of."""
    p = state.covariance
    cross = p[VELOCITY : VELOCITY + 3, _SLOW]
    own = p[VELOCITY : VELOCITY + 3, VELOCITY : VELOCITY + 3]
    return np.asarray(own - cross @ np.linalg.solve(p[np.ix_(_SLOW, _SLOW)], cross.T))


def horizontal_growth(state: State, dt: float, horizon_s: float) -> Mat3:
    """White displacement noise (3, 3, world) of a ping interval that grows, over the horizon, as the filter's own.

    A velocity error of variance s^2 that decays with time constant T moves the vehicle, over a time t, by a
    variance of ``2 s^2 T (t - T (1 - exp(-t/T)))``; per interval, the share ``dt / t`` of that.
    """
    times = 1.0 / state.x[X_PARAMETERS + 3 : X_PARAMETERS + 6]
    scale = np.sqrt(2.0 * times * (1.0 - times / horizon_s * (1.0 - np.exp(-horizon_s / times))) * dt)
    r = rotation_of(state.x)
    c = r @ (scale[:, None] * fast_velocity(state) * scale) @ r.T
    flat = np.diag([1.0, 1.0, 0.0])
    return np.asarray(flat @ c @ flat)


def increment(before: State, open_loop: State, after: State, horizon_s: float) -> Increment:
    """The increment between two pings; its mean is the filter's, its covariance what predictions alone add.

    ``open_loop`` is ``before`` carried to the second ping without any measurement.  In z and attitude the
    covariance is exactly the open-loop growth; in x and y it is at least :func:`horizontal_growth`.
    """
    r0, r1 = rotation_of(before.x), rotation_of(after.x)
    translation, rotation = r0.T @ (after.x[:3] - before.x[:3]), np.ascontiguousarray(r0.T @ r1)
    f, g = pushed(before.x, translation, rotation), into_world(before.x, rotation)
    growth = open_loop.covariance[:6, :6] - f @ before.covariance[:6, :6] @ f.T
    growth[:2, :] = growth[:, :2] = 0.0
    dt = (after.stamp_ns - before.stamp_ns) * 1e-9
    growth[:3, :3] += horizontal_growth(before, dt, horizon_s)
    white = g.T @ growth @ g
    values, vectors = np.linalg.eigh(0.5 * (white + white.T))
    covariance = (vectors * np.maximum(values, 0.0)) @ vectors.T + np.diag(_FLOOR)
    return Increment(translation, rotation, covariance)


def earth_information(before: State, after: State, step: Increment) -> Mat4:
    """What was learnt of z, roll, pitch, yaw (4, 4) since the ping before: ``C_k^-1 - C_{k|k-1}^-1``, if positive."""
    f, g = pushed(before.x, step.translation, step.rotation), into_world(before.x, step.rotation)
    predicted = f @ before.covariance[:6, :6] @ f.T + g @ step.covariance @ g.T
    return gained_information(earth_covariance(after.x, predicted), earth_covariance(after.x, after.covariance))


def pose_of_increment(step: Increment) -> Pose:
    """The increment as a pose."""
    return Pose(step.translation, quaternion_from_matrix(step.rotation))


def identity() -> Increment:
    """No motion, known exactly."""
    return Increment(np.zeros(3), np.eye(3), np.diag(_FLOOR))
