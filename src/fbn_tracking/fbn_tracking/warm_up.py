"""Compile (or load from the cache) every kernel with the layouts it is called with, so that no first ping is late.

Kernels that only kernels call are compiled into those.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from fbn_common import lie
from fbn_tracking import factors, gating, geometry, infants, motion_check, swept, track


@cache
def warm_up() -> None:
    """Call each kernel once; the second call does nothing."""
    pose, eye3, mount = np.eye(4), np.eye(3), np.eye(4)
    q, z, zero3 = np.array([10.0, 1.5, 0.1]), np.array([10.0, 1.5, 0.05, 0.02, 0.3, 150.0]), np.zeros(3)
    factors.link_kernel(pose, pose, zero3, zero3, eye3, 1.0, np.eye(6))
    geometry.elevation_shape(0.17, 2e-3, True)
    geometry.theta_from_u(1.0, z[4], z[5])
    geometry.elevation_scale(0.1, 0.5, 0.3, 150.0)
    geometry.anchored_point(pose, mount, q)
    track.array_pose(pose, mount)
    geometry.world_point(eye3, zero3, q)
    geometry.observe(eye3, zero3, np.array([1.0, 2.0, 3.0]))
    R, p, t = np.stack((eye3, eye3)), np.zeros((2, 3)), np.zeros(2)
    looked = np.stack((z, z))
    x, point, covariance, *_ = infants.settled(q, R, p, t, looked, looked, np.eye(2), zero3, np.eye(3))
    infants.profile(np.array([0.1]), x, R, p, t, looked, np.eye(2))
    zs, S = gating.predict_points(
        point[None], np.zeros((1, 2)), covariance[None], np.zeros(1), np.zeros((1, 2)), eye3, zero3, 0.3, 150.0
    )
    gating.pair_costs(zs, S, z[None])
    gating.predict_anchored(pose, pose, mount, mount, q, np.eye(15), 0, 6, 12, z[4], z[5])
    gating.anchored_place(pose, mount, q, np.eye(15), 0, 12, z[4], z[5])
    gating.beam_weights(point, R, p, looked)
    gating.missed_costs(point[None], R, p, looked, np.array([0.5, 0.5]))
    infants.symmetric_inverse(np.eye(3))
    times, looks = np.arange(4.0), (np.stack((eye3,) * 4), np.outer(np.arange(4.0), q), np.stack((z,) * 4))
    motion_check.check_motion(times, *looks, np.zeros((4, 2)), np.eye(2))
    infants.normal_equations(x, R, p, t, looked, np.eye(2), zero3, np.eye(3))
    lie.rpy_jacobian(zero3)
    lie.skew(zero3)
    lie.matrix_from_quaternion(lie.quaternion_from_matrix(lie.matrix_from_rpy(lie.rpy_from_matrix(eye3))))
    swept.swept_area([(eye3, zero3, np.array([1.0, 2.0, 1.0, 2.0]))], np.zeros(2), 1.0)
