"""The factors of the tracking graph: motion between pings, earth, prior at the base, detections.

Variables: poses ``x`` (gtsam ``Pose3``, tangent rotation then translation in the body frame), one drift ``b`` per
window (world x, world y, body forward [m/s]), features ``f = (r, phi, theta)`` in the frame of the array and
pose that saw them first.  Each factor is whitened in its kernel; its closure captures arrays only.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import rpy_from_matrix, rpy_jacobian, so3_log, so3_right_jacobian_inverse, wrap
from fbn_common.types import Array, Mat3, Vec3
from fbn_tracking.geometry import anchored_observation, cross_matrix

DRIFT: int = gtsam.symbol("b", 0)
_UNIT = {n: gtsam.noiseModel.Unit.Create(n) for n in (2, 4, 5, 6, 7)}


def pose_key(index: int) -> int:
    """Key of the pose of ping ``index``."""
    return int(gtsam.symbol("x", index))


def feature_key(key: int) -> int:
    """Key of a feature's variable."""
    return int(gtsam.symbol("f", key))


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
    t = R_1.T @ (T_to[:3, 3] - T_from[:3, 3])
    R = R_1.T @ R_2
    current = R_1.T @ np.array([drift[0], drift[1], 0.0]) * dt
    rotation = so3_log(R_inc.T @ R)
    J = so3_right_jacobian_inverse(rotation)
    e, H1, H2, Hb = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 3))
    e[:3], e[3:] = t - inc - current, rotation
    e[0] -= drift[2] * dt
    H1[:3, :3], H1[:3, 3:] = cross_matrix(t - current, np.eye(3)), -np.eye(3)
    H1[3:, :3] = -J @ R.T
    H2[:3, 3:], H2[3:, :3] = R, J
    Hb[:3, 0], Hb[:3, 1] = -dt * R_1[0, :], -dt * R_1[1, :]
    Hb[0, 2] = -dt
    return W @ e, W @ H1, W @ H2, W @ Hb


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
    return W @ e, W @ H


@kernel
def detection_kernel(
    T_anchor: Array, T_pose: Array, mount_anchor: Array, mount: Array, q: Vec3, z: Array, curved: bool
) -> tuple[Array, Array, Array, Array]:
    """Whitened residual (4) of a detection and derivatives by anchor, pose (4, 6) and feature (4, 3).

    ``z`` is r, phi, their sigmas, and ``a``, ``c`` of the elevation's shape.  Rows: r, phi, u, and one whose
    residual is always zero: where ``curved``, its derivative is ``sqrt(u u'') d theta``, the curvature of ``u^2 / 2``
    that Gauss-Newton leaves out, without which it oscillates about the optimum.
    """
    s, D_a, D_j, D_f = anchored_observation(T_anchor, T_pose, mount_anchor, mount, q)
    u, slope, bend = u_row(s[2], z[4], z[5], curved)
    e = np.array([(s[0] - z[0]) / z[2], (s[1] - z[1]) / z[3], u, 0.0])
    scale, source = np.array([1.0 / z[2], 1.0 / z[3], slope, bend]), np.array([0, 1, 2, 2])
    H_a, H_j, H_f = np.empty((4, 6)), np.empty((4, 6)), np.empty((4, 3))
    for i in range(4):
        H_a[i] = scale[i] * D_a[source[i]]
        H_j[i] = scale[i] * D_j[source[i]]
        H_f[i] = scale[i] * D_f[source[i]]
    return e, H_a, H_j, H_f


@kernel
def u_row(theta: float, a: float, c: float, curved: bool) -> tuple[float, float, float]:
    """``u``, ``u'`` and, where ``curved``, ``sqrt(u u'')`` of ``u = a theta + c theta^3``."""
    u = a * theta + c * theta**3
    bend = np.sqrt(6.0 * c * theta * u) if curved else 0.0
    return u, a + 3.0 * c * theta**2, bend


def link_factor(index_from: int, index_to: int, inc: Vec3, R_inc: Mat3, dt: float, W: Array) -> Any:
    """Motion between two pings: ``increment + (R^T (b_x, b_y, 0) + (b_s, 0, 0)) dt``, whitened by ``W`` (6, 6)."""
    k1, k2 = pose_key(index_from), pose_key(index_to)

    def error(_: Any, v: Any, H: Any) -> Array:
        T_1, T_2 = v.atPose3(k1).matrix(), v.atPose3(k2).matrix()
        e, H1, H2, Hb = link_kernel(T_1, T_2, v.atPoint3(DRIFT), inc, R_inc, dt, W)
        if H is not None:
            H[0], H[1], H[2] = H1, H2, Hb
        return np.asarray(e)

    return gtsam.CustomFactor(_UNIT[6], [k1, k2, DRIFT], error)


def earth_factor(index: int, mean: Array, W: Array) -> Any:
    """Earth measurement z, roll, pitch, yaw (4) with whitener ``W`` (4, 4), which may be rank-deficient."""
    key = pose_key(index)

    def error(_: Any, v: Any, H: Any) -> Array:
        e, Hx = earth_kernel(v.atPose3(key).matrix(), mean, W)
        if H is not None:
            H[0] = Hx
        return np.asarray(e)

    return gtsam.CustomFactor(_UNIT[4], [key], error)


def base_factor(index: int, mean: Array, W: Array) -> Any:
    """Prior on the base's z, roll, pitch, yaw and the drift together: mean (7), whitener (7, 7)."""
    key, earth, eye = pose_key(index), np.ascontiguousarray(mean[:4]), np.eye(4)

    def error(_: Any, v: Any, H: Any) -> Array:
        e, Hx = earth_kernel(v.atPose3(key).matrix(), earth, eye)
        if H is not None:
            H[0], H[1] = W[:, :4] @ Hx, np.ascontiguousarray(W[:, 4:])
        return np.asarray(W @ np.concatenate((e, v.atPoint3(DRIFT) - mean[4:])))

    return gtsam.CustomFactor(_UNIT[7], [key, DRIFT], error)


def gauge_factor(index: int, xy: Array) -> Any:
    """Pins the base's x and y [m]: no other factor depends on them, so its width (1 m) is of no consequence."""
    key = pose_key(index)

    def error(_: Any, v: Any, H: Any) -> Array:
        T = v.atPose3(key).matrix()
        if H is not None:
            H[0] = np.hstack((np.zeros((2, 3)), T[:2, :3]))
        return np.asarray(T[:2, 3] - xy)

    return gtsam.CustomFactor(_UNIT[2], [key], error)


def first_detection_factor(key: int, z: Array, weak_theta_sigma: float, curved: bool) -> Any:
    """The anchor's own detection, exact in the feature's coordinates, with a loose bound on theta."""
    kf, r, phi, a, c = feature_key(key), z[0], z[1], z[4], z[5]
    scale = np.array([1.0 / z[2], 1.0 / z[3]])

    def error(_: Any, v: Any, H: Any) -> Array:
        f = v.atPoint3(kf)
        u, slope, bend = u_row(f[2], a, c, curved)
        if H is not None:
            J = np.zeros((5, 3))
            J[0, 0], J[1, 1], J[2:, 2] = scale[0], scale[1], (slope, 1.0 / weak_theta_sigma, bend)
            H[0] = J
        return np.array([(f[0] - r) * scale[0], (f[1] - phi) * scale[1], u, f[2] / weak_theta_sigma, 0.0])

    return gtsam.CustomFactor(_UNIT[5], [kf], error)


def detection_factor(
    anchor: int, index: int, key: int, mount_anchor: Array, mount: Array, z: Array, curved: bool
) -> Any:
    """A later detection of an anchored feature, from another pose or from another array of the same ping."""
    ka, kj, kf = pose_key(anchor), pose_key(index), feature_key(key)
    same = anchor == index

    def error(_: Any, v: Any, H: Any) -> Array:
        T_a = v.atPose3(ka).matrix()
        T_j = T_a if same else v.atPose3(kj).matrix()
        e, H_a, H_j, H_f = detection_kernel(T_a, T_j, mount_anchor, mount, v.atPoint3(kf), z, curved)
        if H is not None:
            H[0] = H_a + H_j if same else H_a
            if not same:
                H[1] = H_j
            H[-1] = H_f
        return np.asarray(e)

    return gtsam.CustomFactor(_UNIT[4], [ka, kf] if same else [ka, kj, kf], error)
