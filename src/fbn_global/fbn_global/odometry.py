"""Dead reckoning between the state's pose and another time: displacement, how drift enters, and how it grows."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from fbn_common.lie import matrix_from_quaternion, rpy_from_matrix
from fbn_common.records import Odometry, Pose
from fbn_common.types import Array, Mat2, Mat3, seconds
from fbn_global.state import POSE, YAW, State


@dataclass(frozen=True, slots=True, eq=False)
class Reckoned:
    """Dead reckoning at a time; ``heading`` is the integral of the bow's horizontal direction [s], for surge drift."""

    stamp_ns: int
    pose: Array  # (6,) x, y, z, roll, pitch, yaw in odom
    heading: Array  # (2,)
    variance: Array  # (4,) of z, roll, pitch, yaw


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """From one time to another by dead reckoning: ``xy += turn(yaw error) displacement + drift_jacobian drift``."""

    displacement: Array  # (2,) in odom
    drift_jacobian: Array  # (2, 3) s
    growth: Mat2  # m^2
    duration_s: float


class History:
    """The odometry of the last minutes, by stamp."""

    def __init__(self, length_s: float) -> None:
        self._length_ns = int(length_s * 1e9)
        self._kept: list[Reckoned] = []

    def add(self, odometry: Odometry) -> Reckoned:
        """Keep one odometry; stamps come in order."""
        pose = pose_vector(odometry.pose)
        bow = np.array([np.cos(pose[YAW]), np.sin(pose[YAW])]) * np.cos(pose[4])
        heading = np.zeros(2)
        if self._kept:
            last = self._kept[-1]
            before = np.array([np.cos(last.pose[YAW]), np.sin(last.pose[YAW])]) * np.cos(last.pose[4])
            heading = last.heading + 0.5 * (bow + before) * seconds(odometry.stamp_ns - last.stamp_ns)
        self._kept.append(Reckoned(odometry.stamp_ns, pose, heading, np.diag(odometry.pose_covariance)[2:].copy()))
        if self._kept[-1].stamp_ns - self._kept[0].stamp_ns > 2 * self._length_ns:  # cut seldom, in one piece
            oldest = self._kept[-1].stamp_ns - self._length_ns
            self._kept = [r for r in self._kept if r.stamp_ns >= oldest]
        return self._kept[-1]

    def clear(self) -> None:
        self._kept = []

    @property
    def latest(self) -> Reckoned | None:
        return self._kept[-1] if self._kept else None

    def at(self, stamp_ns: int) -> Reckoned | None:
        """Dead reckoning at a time, interpolated; None outside the history."""
        kept = self._kept
        if not kept or not kept[0].stamp_ns <= stamp_ns <= kept[-1].stamp_ns:
            return None
        low, high = 0, len(kept) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if kept[middle].stamp_ns <= stamp_ns else (low, middle)
        a, b = kept[low], kept[high]
        if b.stamp_ns == a.stamp_ns or stamp_ns == a.stamp_ns:
            return a
        return _between(a, b, (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns), stamp_ns)


def _between(a: Reckoned, b: Reckoned, part: float, stamp_ns: int) -> Reckoned:
    turn = b.pose - a.pose
    turn[3:] = (turn[3:] + np.pi) % (2 * np.pi) - np.pi
    heading = a.heading + part * (b.heading - a.heading)
    return Reckoned(stamp_ns, a.pose + part * turn, heading, a.variance + part * (b.variance - a.variance))


def pose_vector(pose: Pose) -> Array:
    """x, y, z, roll, pitch, yaw (6,) of a pose."""
    rotation = matrix_from_quaternion(np.ascontiguousarray(pose.orientation, dtype=float))
    return np.concatenate([np.asarray(pose.position, dtype=float), rpy_from_matrix(rotation)])


def link(start: Reckoned, end: Reckoned, stationary: Mat3, time_constant_s: float, noise: float) -> Link:
    """How dead reckoning ties two times together, forward or backward; drift is as at ``start``.

    Growth is the white noise [m^2/s] and what an Ornstein-Uhlenbeck drift of this stationary covariance wanders:
    ``tau^2 (2 s - 3 + 4 e^-s - e^-2s)``, ``s = |t| / tau``, per unit of it.
    """
    duration = seconds(end.stamp_ns - start.stamp_ns)
    s = abs(duration) / time_constant_s
    decay = (1.0 - exp(-s)) / s if s > 1e-9 else 1.0
    wander = (
        time_constant_s**2 * max(2.0 * s - 3.0 + 4.0 * exp(-s) - exp(-2.0 * s), 0.0)
        if s > 1e-3
        else (time_constant_s**2 * s**3 * 2.0 / 3.0)
    )
    heading = end.heading - start.heading
    jacobian = decay * np.column_stack([duration * np.eye(2), heading])
    spread = stationary[:2, :2] + (stationary[2, 2] * np.outer(heading, heading) / max(duration**2, 1e-12))
    growth = noise * abs(duration) * np.eye(2) + wander * spread
    return Link(end.pose[:2] - start.pose[:2], jacobian, growth, duration)


def xy_jacobian(state: State, start: Reckoned, tie: Link) -> tuple[Array, Array]:
    """Predicted xy (2,) at the link's other end, and its Jacobian (2, 9) by pose and drift."""
    turn = state.mean[YAW] - start.pose[YAW]
    c, s = np.cos(turn), np.sin(turn)
    moved = np.array(
        [c * tie.displacement[0] - s * tie.displacement[1], s * tie.displacement[0] + c * tie.displacement[1]]
    )
    jacobian = np.zeros((2, 9))
    jacobian[:, :2] = np.eye(2)
    jacobian[:, YAW] = -moved[1], moved[0]
    jacobian[:, 6:] = tie.drift_jacobian
    return state.mean[:2] + moved + tie.drift_jacobian @ state.mean[6:9], jacobian


def carry(state: State, start: Reckoned, end: Reckoned, tie: Link) -> tuple[Array, Array, Array]:
    """The pose (6,) carried to the link's other end, its Jacobian (6, 9) by pose and drift, its added noise (6, 6).

    Depth and attitude move as dead reckoning's do; what its own covariance gained meanwhile is added.
    """
    xy, rows = xy_jacobian(state, start, tie)
    pose = end.pose.copy()
    pose[:2] = xy
    shift = state.mean[POSE] - start.pose
    shift[3:] = (shift[3:] + np.pi) % (2 * np.pi) - np.pi
    pose[2:] += shift[2:]
    jacobian = np.zeros((6, 9))
    jacobian[:2] = rows
    jacobian[2:6, 2:6] = np.eye(4)
    noise = np.zeros((6, 6))
    noise[:2, :2] = tie.growth
    noise[2:, 2:] = np.diag(np.maximum(end.variance - start.variance, 0.0))
    return pose, jacobian, noise


def positive_part(matrix: Mat3) -> Mat3:
    """The nearest symmetric matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
