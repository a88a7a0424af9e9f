"""What the motion between pings and the earth measurements say, whitened, with derivatives.

Variables: poses ``x`` (4 x 4, tangent rotation then translation in the body frame), one drift ``b`` per window
(world x, world y, body forward [m/s]), features ``f = (r, phi, theta)`` in the frame of the array and pose that saw
them first.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import rpy_from_matrix, rpy_jacobian, so3_log, so3_right_jacobian_inverse, wrap
from fbn_common.types import Array, Mat3, Vec3
from fbn_tracking.geometry import brought, cross_matrix, times_transposed


def inverse(covariance: Array) -> Array:
    """Inverse of a covariance (n, n), symmetric; scaled first, since its units may differ."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    scaled = np.linalg.inv(covariance * np.outer(scale, scale))
    return np.asarray(0.5 * (scaled + scaled.T) * np.outer(scale, scale))


def whitener(information: Array) -> Array:
    """``W`` with ``W^T W`` = information (n, n), which may be rank-deficient; negative directions carry none."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    return np.ascontiguousarray((vectors * np.sqrt(np.maximum(values, 0.0))).T)


@kernel
def link_kernel(
    T_from: Array, T_to: Array, drift: Vec3, inc: Vec3, R_inc: Mat3, dt: float, W: Array
) -> tuple[Array, Array, Array, Array]:
    """Whitened residual (6) of a link and its derivatives by both poses (6, 6) and the drift (6, 3)."""
    R_1, R_2 = T_from[:3, :3].copy(), T_to[:3, :3].copy()
    t = brought(T_from, T_to[:3, 3])
    R = transposed_times(R_1, R_2)
    current = np.empty(3)
    for i in range(3):
        current[i] = (R_1[0, i] * drift[0] + R_1[1, i] * drift[1]) * dt
    rotation = so3_log(transposed_times(R_inc, R))
    J = so3_right_jacobian_inverse(rotation)
    e, H1, H2, Hb = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 3))
    e[:3], e[3:] = t - inc - current, rotation
    e[0] -= drift[2] * dt
    H1[:3, :3], H1[:3, 3:] = cross_matrix(t - current, np.eye(3)), -np.eye(3)
    H1[3:, :3] = -times_transposed(J, R)
    H2[:3, 3:], H2[3:, :3] = R, J
    Hb[:3, 0], Hb[:3, 1] = -dt * R_1[0, :], -dt * R_1[1, :]
    Hb[0, 2] = -dt
    return weighted_vector(W, e), weighted(W, H1), weighted(W, H2), weighted(W, Hb)


@kernel
def weighted(W: Array, H: Array) -> Array:
    """``W H``; for the few rows of a factor quicker than BLAS."""
    out = np.zeros((W.shape[0], H.shape[1]))
    for i in range(W.shape[0]):
        for k in range(W.shape[1]):
            w = W[i, k]
            if w != 0.0:
                for j in range(H.shape[1]):
                    out[i, j] += w * H[k, j]
    return out


@kernel
def weighted_vector(W: Array, e: Array) -> Array:
    """``W e``."""
    out = np.zeros(W.shape[0])
    for i in range(W.shape[0]):
        for k in range(W.shape[1]):
            out[i] += W[i, k] * e[k]
    return out


@kernel
def transposed_times(A: Mat3, B: Mat3) -> Mat3:
    """``A^T B``."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
    return out


@kernel
def earth_kernel(T: Array, mean: Array, W: Array) -> tuple[Array, Array]:
    """Whitened residual (4) of z, roll, pitch, yaw and its derivative by the pose (4, 6)."""
    R = T[:3, :3].copy()
    rpy = rpy_from_matrix(R)
    e, H = np.zeros(4), np.zeros((4, 6))
    e[0] = T[2, 3] - mean[0]
    for i in range(3):
        e[1 + i] = wrap(rpy[i] - mean[1 + i])
    H[0, 3:] = R[2, :]
    H[1:, :3] = rpy_jacobian(rpy)
    return weighted_vector(W, e), weighted(W, H)
