"""The sonar's measurement model: range, bearing to the axis and angle around it, with derivatives.

A detection of array ``s`` at pose ``j`` measures ``(r, phi)``; of ``theta`` it says only that the target was
in the lobe: ``u(theta) ~ N(0, 1)`` with ``u = k (alpha theta + theta^3)``, ``u = 1`` at the lobe's edge (IROS
2007, eq. 6).  ``theta`` is the state's coordinate and ``u`` the space of the noise: same likelihood, better
convergence.  All functions are compiled; see docs/equations/tracking.md.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import product, product_into
from fbn_common.types import Array, Mat3, Vec3

_NEAR = 1e-9  # m: an echo from the array's own axis or origin has no direction


@kernel
def elevation_shape(half_lobe: float, alpha: float, cubic: bool) -> tuple[float, float]:
    """``(a, c)`` of ``u = a theta + c theta^3`` with u = 1 at the lobe's edge [1/rad, 1/rad^3]."""
    if not cubic:
        return 1.0 / half_lobe, 0.0
    k = 1.0 / (alpha * half_lobe + half_lobe**3)
    return k * alpha, k


@kernel
def u_from_theta(theta: float, a: float, c: float) -> float:
    """Noise coordinate of an angle around the axis."""
    return a * theta + c * theta**3


@kernel
def theta_from_u(u: float, a: float, c: float) -> float:
    """Inverse of :func:`u_from_theta` (the real root of the depressed cubic, by hyperbolic sine) [rad]."""
    if c == 0.0:
        return u / a
    b = np.sqrt(a / (3.0 * c))
    return 2.0 * b * np.sinh(np.arcsinh(u / (2.0 * c * b**3)) / 3.0)


@kernel
def finite_slope(theta: float, sigma_u: float, a: float, c: float) -> float:
    """``d theta / d u`` [rad] over one standard deviation of u to either side (IROS 2007, IV)."""
    u = u_from_theta(theta, a, c)
    s = min(max(sigma_u, 1e-6), 1.0)
    return (theta_from_u(u + s, a, c) - theta_from_u(u - s, a, c)) / (2.0 * s)


@kernel
def elevation_scale(theta: float, sigma_theta: float, a: float, c: float) -> float:
    """Finite over local slope of theta by u, over one standard deviation of u (IROS 2007, IV)."""
    sigma_u = (a + 3.0 * c * theta**2) * sigma_theta
    return finite_slope(theta, sigma_u, a, c) * min(sigma_u, 1.0) / max(sigma_theta, 1e-9)


@kernel
def cartesian_jacobian(q: Vec3) -> tuple[Vec3, Mat3]:
    """Point in the array's frame at ``q = (r, phi, theta)`` and its derivative by q."""
    point, d = np.empty(3), np.empty((3, 3))
    cartesian_into(q, point, d)
    return point, d


@inner_kernel
def cartesian_into(q: Vec3, point: Vec3, d: Mat3) -> None:
    """:func:`cartesian_jacobian` written into ``point`` and ``d``."""
    sp, cp, st, ct = np.sin(q[1]), np.cos(q[1]), np.sin(q[2]), np.cos(q[2])
    d[0, 0], d[1, 0], d[2, 0] = sp * ct, sp * st, cp
    d[0, 1], d[1, 1], d[2, 1] = q[0] * cp * ct, q[0] * cp * st, -q[0] * sp
    d[0, 2], d[1, 2], d[2, 2] = -q[0] * sp * st, q[0] * sp * ct, 0.0
    for i in range(3):
        point[i] = q[0] * d[i, 0]


@kernel
def polar_jacobian(s: Vec3) -> tuple[Vec3, Mat3]:
    """``(r, phi, theta)`` of a point in the array's frame and its derivative by the point."""
    z, d = s.copy(), np.empty((3, 3))
    polar_into(z, d)
    return z, d


@inner_kernel
def polar_into(z: Vec3, d: Mat3) -> None:
    """:func:`polar_jacobian` written over the point and into ``d``."""
    x, y, along = z[0], z[1], z[2]
    rho, r = distances(z)
    for i in range(3):
        d[0, i] = z[i] / r
        d[1, i] = along * z[i] / (r * r * rho)
    d[1, 2] -= 1.0 / rho
    d[2, 0], d[2, 1], d[2, 2] = -y / rho**2, x / rho**2, 0.0
    z[0], z[1], z[2] = r, np.arctan2(rho, along), np.arctan2(y, x)


@inner_kernel
def distances(s: Vec3) -> tuple[float, float]:
    """Distance of a point in the array's frame from the array's axis, and its range [m]."""
    rho = max(np.sqrt(s[0] ** 2 + s[1] ** 2), _NEAR)
    return rho, max(np.sqrt(rho**2 + s[2] ** 2), _NEAR)


@kernel
def world_point(R_world_array: Mat3, p_world_array: Vec3, q: Vec3) -> tuple[Vec3, Mat3]:
    """World point of ``q`` seen by an array at this pose, and its derivative by q."""
    c, dc = cartesian_jacobian(q)
    R, point = R_world_array, np.empty(3)
    for i in range(3):
        point[i] = p_world_array[i] + R[i, 0] * c[0] + R[i, 1] * c[1] + R[i, 2] * c[2]
    return point, product(R, dc)


@kernel
def observe(R_world_array: Mat3, p_world_array: Vec3, point: Vec3) -> tuple[Vec3, Mat3]:
    """``(r, phi, theta)`` of a world point as an array at this pose sees it, and its derivative by the point."""
    z, d = np.empty(3), np.empty((3, 3))
    observe_into(R_world_array, p_world_array, point, z, d, np.empty((3, 3)))
    return z, d


@inner_kernel
def observe_into(R: Mat3, p: Vec3, point: Vec3, z: Vec3, d: Mat3, room: Mat3) -> None:
    """:func:`observe` written into ``z`` and ``d``; ``room`` is written over."""
    to_array_into(R, p, point, z)
    polar_into(z, room)
    times_transposed_into(room, R, d)


@inner_kernel
def see_into(R: Mat3, p: Vec3, point: Vec3, z: Vec3) -> None:
    """:func:`observe` without the derivative, written into ``z``."""
    to_array_into(R, p, point, z)
    rho, r = distances(z)
    z[0], z[1], z[2] = r, np.arctan2(rho, z[2]), np.arctan2(z[1], z[0])


@inner_kernel
def to_array_into(R: Mat3, p: Vec3, point: Vec3, out: Vec3) -> None:
    """A world point in the frame of an array at this pose, written into ``out``."""
    a, b, c = point[0] - p[0], point[1] - p[1], point[2] - p[2]
    for i in range(3):
        out[i] = R[0, i] * a + R[1, i] * b + R[2, i] * c


@kernel
def cross_matrix(v: Vec3, m: Mat3) -> Mat3:
    """``m [v]x`` without forming the skew matrix."""
    out = np.empty((m.shape[0], 3))
    cross_matrix_into(v, m, out)
    return out


@inner_kernel
def cross_matrix_into(v: Vec3, m: Mat3, out: Array) -> None:
    """:func:`cross_matrix` written into the first three columns of ``out``, which is not ``m``."""
    for i in range(m.shape[0]):
        out[i, 0] = m[i, 1] * v[2] - m[i, 2] * v[1]
        out[i, 1] = m[i, 2] * v[0] - m[i, 0] * v[2]
        out[i, 2] = m[i, 0] * v[1] - m[i, 1] * v[0]


@kernel
def carried(T: Array, x: Vec3) -> Vec3:
    """``T x``: a point of a frame in its parent's, by the pose (4, 4)."""
    out = np.empty(3)
    carry_into(T, x, out)
    return out


@inner_kernel
def carry_into(T: Array, x: Vec3, out: Vec3) -> None:
    """:func:`carried` written into ``out``, which may be ``x``."""
    a, b, c = x[0], x[1], x[2]
    for i in range(3):
        out[i] = T[i, 3] + T[i, 0] * a + T[i, 1] * b + T[i, 2] * c


@kernel
def brought(T: Array, x: Vec3) -> Vec3:
    """``T^-1 x``: the other way."""
    out = np.empty(3)
    bring_into(T, x, out)
    return out


@inner_kernel
def bring_into(T: Array, x: Vec3, out: Vec3) -> None:
    """:func:`brought` written into ``out``, which may be ``x``."""
    a, b, c = x[0] - T[0, 3], x[1] - T[1, 3], x[2] - T[2, 3]
    for i in range(3):
        out[i] = T[0, i] * a + T[1, i] * b + T[2, i] * c


@kernel
def times_transposed(d: Mat3, T: Array) -> Mat3:
    """``d R^T``."""
    out = np.empty((3, 3))
    times_transposed_into(d, T, out)
    return out


@inner_kernel
def times_transposed_into(d: Mat3, T: Array, out: Mat3) -> None:
    """``d R^T`` written into ``out``, which is neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = d[i, 0] * T[j, 0] + d[i, 1] * T[j, 1] + d[i, 2] * T[j, 2]


@kernel
def anchored_point(T_anchor: Array, mount: Array, q: Vec3) -> tuple[Vec3, Array, Mat3]:
    """World point of an anchored feature, and its derivatives by the anchor's tangent (3, 6) and by q (3, 3)."""
    c, dc = cartesian_jacobian(q)
    y, R = carried(mount, c), T_anchor[:3, :3].copy()
    by_anchor = np.empty((3, 6))
    by_anchor[:, :3], by_anchor[:, 3:] = -cross_matrix(y, R), R
    return carried(T_anchor, y), by_anchor, product(product(R, mount), dc)


@kernel
def anchored_observation(
    T_anchor: Array, T_pose: Array, mount_anchor: Array, mount: Array, q: Vec3
) -> tuple[Vec3, Array, Array, Mat3]:
    """``(r, phi, theta)`` of an anchored feature from another pose, and derivatives by anchor, pose and q.

    Poses and mounts are 4 x 4 (base in world, array in base).  Pose derivatives (3, 6) are by the tangent:
    rotation then translation, both in the body frame, perturbing on the right.
    """
    z, by_anchor, by_pose, by_q = np.empty(3), np.empty((3, 6)), np.empty((3, 6)), np.empty((3, 3))
    observe_anchored_into(T_anchor, T_pose, mount_anchor, mount, q, z, by_anchor, by_pose, by_q, np.empty((6, 3, 3)))
    return z, by_anchor, by_pose, by_q


@inner_kernel
def observe_anchored_into(
    T_anchor: Array, T_pose: Array, mount_anchor: Array, mount: Array, q: Vec3,
    z: Vec3, by_anchor: Array, by_pose: Array, by_q: Mat3, room: Array,
) -> None:  # fmt: skip
    """:func:`anchored_observation` written into what follows ``q``; ``room`` (6, 3, 3) is written over."""
    d_c, d_z, d_y, d_a, half, y_a, y_j = room[0], room[1], room[2], room[3], room[4], room[5, 0], room[5, 1]
    cartesian_into(q, y_a, d_c)
    carry_into(mount_anchor, y_a, y_a)
    carry_into(T_anchor, y_a, y_j)
    bring_into(T_pose, y_j, y_j)
    bring_into(mount, y_j, z)
    polar_into(z, d_z)
    times_transposed_into(d_z, mount, d_y)
    times_transposed_into(d_y, T_pose, half)
    product_into(half, T_anchor, d_a)
    cross_matrix_into(y_a, d_a, by_anchor)
    cross_matrix_into(y_j, d_y, by_pose)
    for i in range(3):
        for j in range(3):
            by_anchor[i, j], by_anchor[i, 3 + j] = -by_anchor[i, j], d_a[i, j]
            by_pose[i, 3 + j] = -d_y[i, j]
    product_into(d_a, mount_anchor, half)
    product_into(half, d_c, by_q)
