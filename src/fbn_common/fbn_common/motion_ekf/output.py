"""What a state looks like to others: a pose, odometry with covariances in ROS order."""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import quaternion_from_matrix
from fbn_common.motion_ekf.core import State
from fbn_common.motion_ekf.layout import VELOCITY, X_ROTATION, X_VELOCITY
from fbn_common.motion_ekf.propagate import rotation_of
from fbn_common.records import Odometry, Pose
from fbn_common.types import Array


def pose_of(x: Array) -> Pose:
    """Position and orientation of a state."""
    return Pose(x[0:3].copy(), quaternion_from_matrix(rotation_of(x)))


@kernel
def _covariances(x: Array, p: Array) -> tuple[Array, Array]:
    """Pose covariance in fixed axes and twist covariance, (6, 6) each."""
    turn = np.eye(6)
    for i in range(3):
        for j in range(3):
            turn[3 + i, 3 + j] = x[X_ROTATION + 3 * i + j]
    half, pose, twist = np.zeros((6, 6)), np.zeros((6, 6)), np.empty((6, 6))
    for i in range(6):
        for k in range(6):
            if turn[i, k] != 0.0:
                for j in range(6):
                    half[i, j] += turn[i, k] * p[k, j]
    for i in range(6):
        for j in range(i + 1):
            for k in range(6):
                pose[i, j] += half[i, k] * turn[j, k]
            pose[j, i] = pose[i, j]
        for j in range(6):
            twist[i, j] = p[VELOCITY + i, VELOCITY + j]
    return pose, twist


def odometry(state: State, frame_id: str) -> Odometry:
    """A state as odometry: covariances in ROS order, fixed axes."""
    pose, twist = _covariances(state.x, state.covariance)
    velocity = state.x[X_VELOCITY : X_VELOCITY + 6].copy()
    return Odometry(state.stamp_ns, frame_id, "base_link", pose_of(state.x), velocity, pose, twist)
