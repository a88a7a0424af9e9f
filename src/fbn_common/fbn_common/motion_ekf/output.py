"""What a state looks like to others: a pose, odometry with covariances in ROS order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import quaternion_from_matrix
from fbn_common.motion_ekf.layout import (
    O_ORIENTATION,
    O_POSE_COVARIANCE,
    O_TWIST_COVARIANCE,
    O_VELOCITY,
    ODOMETRY_SIZE,
    VELOCITY,
    X_ROTATION,
    X_VELOCITY,
    IntArray,
    Snapshots,
)
from fbn_common.motion_ekf.propagate import rotation_of
from fbn_common.records import Odometry, Pose
from fbn_common.types import Array


def pose_of(x: Array) -> Pose:
    """Position and orientation of a state."""
    return Pose(x[0:3].copy(), quaternion_from_matrix(rotation_of(x)))


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
def _lines(rows: IntArray, states: Array, covariances: Array) -> Array:
    """The numbers (n, ODOMETRY_SIZE) of odometry of these rows of states and covariances."""
    lines = np.empty((rows.shape[0], ODOMETRY_SIZE))
    for i in range(rows.shape[0]):
        x, line = states[rows[i]], lines[i]
        line[:O_ORIENTATION], line[O_VELOCITY:O_TWIST_COVARIANCE] = x[0:3], x[X_VELOCITY : X_VELOCITY + 6]
        line[O_ORIENTATION:O_POSE_COVARIANCE] = quaternion_from_matrix(rotation_of(x))
        pose, twist = line[O_POSE_COVARIANCE:O_VELOCITY], line[O_TWIST_COVARIANCE:]
        _covariances(x, covariances[rows[i]], pose.reshape(6, 6), twist.reshape(6, 6))
    return lines


def odometry(snapshots: Snapshots, rows: Sequence[int] | IntArray, frame_id: str) -> list[Odometry]:
    """Snapshots as odometry: covariances in ROS order, fixed axes."""
    chosen = np.array(rows, np.int64)
    lines = _lines(chosen, snapshots.x, snapshots.covariance)
    return [
        Odometry.packed(numbers, stamp_ns=stamp, frame_id=frame_id, child_frame_id="base_link")
        for stamp, numbers in zip(snapshots.stamp[chosen].tolist(), lines, strict=True)
    ]
