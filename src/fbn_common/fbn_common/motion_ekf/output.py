"""What a state looks like to others: a pose, odometry with covariances in ROS order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import quaternion_from_matrix
from fbn_common.motion_ekf.layout import VELOCITY, X_ROTATION, X_VELOCITY, IntArray, Snapshots
from fbn_common.motion_ekf.propagate import rotation_of
from fbn_common.records import Odometry, Pose
from fbn_common.types import Array


def pose_of(x: Array) -> Pose:
    """Position and orientation of a state."""
    return Pose(x[0:3].copy(), quaternion_from_matrix(rotation_of(x)))


class Lines(NamedTuple):
    """What odometry says of some states."""

    position: Array  # (n, 3)
    orientation: Array  # (n, 4)
    velocity: Array  # (n, 6)
    pose_covariance: Array  # (n, 6, 6), fixed axes
    twist_covariance: Array  # (n, 6, 6)


@kernel
def _covariances(x: Array, p: Array, pose: Array, twist: Array) -> None:
    """Pose covariance in fixed axes and twist covariance, (6, 6) each."""
    turn = np.eye(6)
    for i in range(3):
        for j in range(3):
            turn[3 + i, 3 + j] = x[X_ROTATION + 3 * i + j]
    half = np.zeros((6, 6))
    for i in range(6):
        for k in range(6):
            if turn[i, k] != 0.0:
                for j in range(6):
                    half[i, j] += turn[i, k] * p[k, j]
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(6):
                total += half[i, k] * turn[j, k]
            pose[i, j] = total
            pose[j, i] = total
        for j in range(6):
            twist[i, j] = p[VELOCITY + i, VELOCITY + j]


@kernel
def _lines(rows: IntArray, states: Array, covariances: Array, out: Lines) -> None:
    """Odometry of these rows of states and covariances."""
    for i in range(rows.shape[0]):
        x = states[rows[i]]
        out.position[i], out.velocity[i] = x[0:3], x[X_VELOCITY : X_VELOCITY + 6]
        out.orientation[i] = quaternion_from_matrix(rotation_of(x))
        _covariances(x, covariances[rows[i]], out.pose_covariance[i], out.twist_covariance[i])


def odometry(snapshots: Snapshots, rows: Sequence[int], frame_id: str) -> list[Odometry]:
    """Snapshots as odometry: covariances in ROS order, fixed axes."""
    n = len(rows)
    lines = Lines(np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 6)), np.empty((n, 6, 6)), np.empty((n, 6, 6)))
    chosen = np.array(rows, np.int64)
    _lines(chosen, snapshots.x, snapshots.covariance, lines)
    return [
        Odometry(stamp, frame_id, "base_link", Pose(position, orientation), *others)
        for stamp, position, orientation, *others in zip(snapshots.stamp[chosen].tolist(), *lines, strict=True)
    ]
