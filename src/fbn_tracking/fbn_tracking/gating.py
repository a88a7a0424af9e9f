"""What a look should measure of tracks, and what giving it each echo would cost; all compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fbn_common.kernels import kernel
from fbn_common.types import Array, Mat3, Vec3
from fbn_tracking.geometry import (
    anchored_observation,
    anchored_point,
    elevation_scale,
    observe,
    u_from_theta,
)
from fbn_tracking.infants import cholesky_solve


@kernel
def predict_points(
    points: Array, slack: Array, covariance: Array, t: Array, extra: Array, R: Mat3, p: Vec3, a: float, c: float
) -> tuple[Array, Array]:
    """What an array at this pose should measure of static points: (m, 3) of r, phi, u, and covariance (m, 3, 3).

    ``slack`` (m, 2) of the drift, ``covariance`` (m, 5, 5) of point and slack, ``t`` (m) [s] the time over which slack
    acts, ``extra`` (m, 2) the variances of position [m^2] and heading [rad^2] that the poses gathered since.
    """
    m = points.shape[0]
    z, S = np.empty((m, 3)), np.empty((m, 3, 3))
    for i in range(m):
        moved = p.copy()
        moved[:2] += slack[i] * t[i]
        s, d = observe(R, moved, points[i])
        H = np.zeros((3, 5))
        H[:, :3] = d
        H[:, 3], H[:, 4] = -t[i] * d[:, 0], -t[i] * d[:, 1]
        H[2] *= a + 3.0 * c * s[2] ** 2
        z[i, 0], z[i, 1], z[i, 2] = s[0], s[1], u_from_theta(s[2], a, c)
        S[i] = H @ covariance[i] @ H.T
        S[i, 0, 0] += extra[i, 0]
        S[i, 1, 1] += extra[i, 1] + extra[i, 0] / s[0] ** 2
    return z, S


@kernel
def predict_anchored(
    T_anchor: Array, T_pose: Array, mount_anchor: Array, mount: Array, q: Vec3,
    joint: Array, anchor: int, pose: int, feature: int, a: float, c: float,
) -> tuple[Vec3, Mat3]:  # fmt: skip
    """What a look should measure of an anchored feature: r, phi, u, and their covariance (3, 3).

    ``joint`` (n, n): covariance that holds anchor and pose (6 each, may be the same) and feature (3) at these offsets.
    """
    z, by_anchor, by_pose, by_q = anchored_observation(T_anchor, T_pose, mount_anchor, mount, q)
    H, at = np.empty((3, 15)), np.empty(15, np.int64)
    H[:, :6], H[:, 6:12], H[:, 12:] = by_anchor, by_pose, by_q
    H[2] *= a + 3.0 * c * z[2] ** 2
    at[:6], at[6:12], at[12:] = anchor + np.arange(6), pose + np.arange(6), feature + np.arange(3)
    z[2] = u_from_theta(z[2], a, c)
    return z, propagated(H, joint, at)


@kernel
def anchored_place(
    T_anchor: Array, mount: Array, q: Vec3, joint: Array, anchor: int, feature: int, a: float, c: float
) -> tuple[Vec3, Mat3]:
    """World point of an anchored feature and its covariance; theta's slope by u over one standard deviation of u."""
    J, at = np.empty((3, 9)), np.empty(9, np.int64)
    point, J[:, :6], J[:, 6:] = anchored_point(T_anchor, mount, q)
    J[:, 8] *= elevation_scale(q[2], np.sqrt(joint[feature + 2, feature + 2]), a, c)
    at[:6], at[6:] = anchor + np.arange(6), feature + np.arange(3)
    return point, propagated(J, joint, at)


@kernel
def propagated(J: Array, joint: Array, at: NDArray[np.int64]) -> Mat3:
    """``J P J^T`` (3, 3), ``P`` being these rows and columns of ``joint``."""
    half, out = np.zeros((3, len(at))), np.zeros((3, 3))
    for i in range(3):
        for k in range(len(at)):
            for j in range(len(at)):
                half[i, j] += J[i, k] * joint[at[k], at[j]]
        for j in range(3):
            for k in range(len(at)):
                out[i, j] += half[i, k] * J[j, k]
    return out


@kernel
def pair_costs(z: Array, S: Array, echoes: Array) -> tuple[Array, Array, Array]:
    """For every candidate (m) and echo (d): energy increase (3 dof), NIS of r and phi, ln of |S| over |R|.

    ``z`` (m, 3) and ``S`` (m, 3, 3) are predictions of r, phi, u without the echo's own noise; ``echoes`` (d, 6).
    """
    m, n = z.shape[0], echoes.shape[0]
    energy, nis, volume = np.empty((m, n)), np.empty((m, n)), np.empty((m, n))
    for i in range(m):
        for j in range(n):
            C = S[i].copy()
            R0, R1 = echoes[j, 2] ** 2, echoes[j, 3] ** 2
            C[0, 0], C[1, 1], C[2, 2] = C[0, 0] + R0, C[1, 1] + R1, C[2, 2] + 1.0
            e = np.array([echoes[j, 0] - z[i, 0], echoes[j, 1] - z[i, 1], -z[i, 2]])
            det = C[0, 0] * C[1, 1] - C[0, 1] ** 2
            nis[i, j] = (C[1, 1] * e[0] ** 2 - 2.0 * C[0, 1] * e[0] * e[1] + C[0, 0] * e[1] ** 2) / det
            volume[i, j] = np.log(det / (R0 * R1))
            energy[i, j] = e @ cholesky_solve(C, e)
    return energy, nis, volume


@kernel
def beam_weights(point: Vec3, R: Array, p: Array, limits: Array) -> Array:
    """How well each look (n) should see a world point: ``exp(-u^2 / 2)`` inside the field of view, else 0.

    ``R`` (n, 3, 3), ``p`` (n, 3) arrays in the world; ``limits`` (n, 6): range min, max, bearing min, max, a, c.
    """
    w = np.zeros(p.shape[0])
    for i in range(p.shape[0]):
        s, _ = observe(R[i], p[i], point)
        if limits[i, 0] <= s[0] <= limits[i, 1] and limits[i, 2] <= s[1] <= limits[i, 3]:
            w[i] = np.exp(-0.5 * u_from_theta(s[2], limits[i, 4], limits[i, 5]) ** 2)
    return w


@kernel
def missed_costs(points: Array, R: Array, p: Array, limits: Array, chance: Array) -> Array:
    """Minus log probability (m,) that none of the looks (n) saw a target at each world point (m, 3).

    ``chance`` (n,): that a look sees a target amid its lobe; the rest as for :func:`beam_weights`.
    """
    costs = np.zeros(points.shape[0])
    for i in range(points.shape[0]):
        weights = beam_weights(points[i].copy(), R, p, limits)
        for j in range(p.shape[0]):
            costs[i] -= np.log1p(-chance[j] * weights[j])
    return costs
