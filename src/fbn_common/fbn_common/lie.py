"""Rotations: SO(3) with the right (body-frame) perturbation ``R Exp(dtheta)``.

Every function takes and gives C-ordered float64 arrays and is compiled (numba, cached on disk), so that
the estimators' kernels can call them.  Roll, pitch and yaw are the fixed-axis x, y, z angles of ROS:
``R = Rz(yaw) Ry(pitch) Rx(roll)``.  Quaternions are x, y, z, w.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.types import Mat3, Quaternion, Vec3

_SMALL = 1e-8  # rad: below it the series' next term is under the double's resolution


@kernel
def skew(v: Vec3) -> Mat3:
    """The matrix ``[v]x`` with ``[v]x w = v x w``."""
    m = np.empty((3, 3))
    skew_into(v, m)
    return m


@inner_kernel
def skew_into(v: Vec3, m: Mat3) -> None:
    """:func:`skew` written into ``m``."""
    m[0, 0] = m[1, 1] = m[2, 2] = 0.0
    m[0, 1], m[0, 2], m[1, 0] = -v[2], v[1], v[2]
    m[1, 2], m[2, 0], m[2, 1] = -v[0], -v[1], v[0]


@kernel
def product(a: Mat3, b: Mat3) -> Mat3:
    """``a b``, summed in a fixed order: in a kernel quicker than BLAS, and the same to the last bit everywhere."""
    c = np.empty((3, 3))
    product_into(a, b, c)
    return c


@inner_kernel
def product_into(a: Mat3, b: Mat3, c: Mat3) -> None:
    """``a b`` written into ``c``, which is neither of them."""
    for i in range(3):
        for j in range(3):
            c[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@inner_kernel
def cross_into(a: Vec3, b: Vec3, c: Vec3) -> None:
    """``a x b`` written into ``c``, which is neither of them."""
    c[0], c[1], c[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def so3_exp(theta: Vec3) -> Mat3:
    """Rotation matrix of a rotation vector [rad] (Rodrigues)."""
    m = np.empty((3, 3))
    so3_exp_into(theta, m)
    return m


@inner_kernel
def so3_exp_into(theta: Vec3, m: Mat3) -> None:
    """:func:`so3_exp` written into ``m``: an inner loop has no time to make arrays."""
    a2 = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    a = np.sqrt(a2)
    if a < 1e-4:  # series: next terms are a**4 / 120 and a**4 / 720
        s, c = 1.0 - a2 / 6.0, 0.5 - a2 / 24.0
    else:
        s, c = np.sin(a) / a, (1.0 - np.cos(a)) / a2
    for i in range(3):
        for j in range(3):
            m[i, j] = c * theta[i] * theta[j]
        m[i, i] += 1.0 - c * a2
    m[0, 1] -= s * theta[2]
    m[0, 2] += s * theta[1]
    m[1, 0] += s * theta[2]
    m[1, 2] -= s * theta[0]
    m[2, 0] -= s * theta[1]
    m[2, 1] += s * theta[0]


@kernel
def quaternion_from_matrix(rotation: Mat3) -> Quaternion:
    """Unit quaternion (x, y, z, w; w >= 0) of a rotation matrix, by its largest component."""
    q = np.empty(4)
    quaternion_into(rotation, q)
    return q


@inner_kernel
def quaternion_into(rotation: Mat3, q: Quaternion) -> None:
    """:func:`quaternion_from_matrix` written into ``q``."""
    q[0], q[1], q[2], q[3] = _quaternion(rotation)


@inner_kernel
def _quaternion(r: Mat3) -> tuple[float, float, float, float]:
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace > r[0, 0] and trace > r[1, 1] and trace > r[2, 2]:
        x, y, z, w = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1.0 + trace
    elif r[0, 0] >= r[1, 1] and r[0, 0] >= r[2, 2]:
        x, y, z, w = 1.0 + 2.0 * r[0, 0] - trace, r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]
    elif r[1, 1] >= r[2, 2]:
        x, y, z, w = r[1, 0] + r[0, 1], 1.0 + 2.0 * r[1, 1] - trace, r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]
    else:
        x, y, z, w = r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], 1.0 + 2.0 * r[2, 2] - trace, r[1, 0] - r[0, 1]
    scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z, scale * w


@kernel
def matrix_from_quaternion(quaternion: Quaternion) -> Mat3:
    """Rotation matrix of a quaternion x, y, z, w (normalised here; its norm must not be zero)."""
    m = np.empty((3, 3))
    matrix_from_quaternion_into(quaternion, m)
    return m


@inner_kernel
def matrix_from_quaternion_into(q: Quaternion, m: Mat3) -> None:
    """:func:`matrix_from_quaternion` written into ``m``."""
    length = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    x, y, z, w = q[0] / length, q[1] / length, q[2] / length, q[3] / length
    m[0, 0], m[0, 1], m[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    m[1, 0], m[1, 1], m[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    m[2, 0], m[2, 1], m[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@kernel
def so3_log(rotation: Mat3) -> Vec3:
    """Rotation vector [rad], of length at most pi, of a rotation matrix (through the quaternion: stable at pi)."""
    out = np.empty(3)
    so3_log_into(rotation, out)
    return out


@inner_kernel
def so3_log_into(rotation: Mat3, out: Vec3) -> None:
    """:func:`so3_log` written into ``out``."""
    x, y, z, w = _quaternion(rotation)
    n = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 if n < _SMALL else 2.0 * np.arctan2(n, w) / n
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@kernel
def so3_right_jacobian(theta: Vec3) -> Mat3:
    """``Jr`` with ``Exp(theta + d) = Exp(theta) Exp(Jr d)`` to first order."""
    out = np.empty((3, 3))
    so3_right_jacobian_into(theta, out)
    return out


@inner_kernel
def so3_right_jacobian_into(theta: Vec3, out: Mat3) -> None:
    """:func:`so3_right_jacobian` written into ``out``."""
    a2 = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    if a2 < 1e-8:
        b, c = 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        a = np.sqrt(a2)
        b, c = (1.0 - np.cos(a)) / a2, (a - np.sin(a)) / (a2 * a)
    _of_skew(theta, -b, c, out)


@kernel
def so3_right_jacobian_inverse(theta: Vec3) -> Mat3:
    """Inverse of :func:`so3_right_jacobian`: ``Log(Exp(theta) Exp(d)) = theta + Jr^-1 d``; for ``|theta| < 2 pi``."""
    a2 = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    if a2 < 1e-6:
        c = 1.0 / 12.0 + a2 / 720.0
    else:
        a = np.sqrt(a2)
        c = 1.0 / a2 - (1.0 + np.cos(a)) / (2.0 * a * np.sin(a))
    out = np.empty((3, 3))
    _of_skew(theta, 0.5, c, out)
    return out


@inner_kernel
def _of_skew(theta: Vec3, b: float, c: float, out: Mat3) -> None:
    """``out = I + b [theta]x + c [theta]x^2``, the square being ``theta theta' - |theta|^2 I``."""
    x, y, z = theta[0], theta[1], theta[2]
    out[0, 0], out[1, 1], out[2, 2] = 1.0 - c * (y * y + z * z), 1.0 - c * (x * x + z * z), 1.0 - c * (x * x + y * y)
    out[0, 1], out[1, 0] = c * x * y - b * z, c * x * y + b * z
    out[0, 2], out[2, 0] = c * x * z + b * y, c * x * z - b * y
    out[1, 2], out[2, 1] = c * y * z - b * x, c * y * z + b * x


@kernel
def rpy_from_matrix(rotation: Mat3) -> Vec3:
    """Roll, pitch, yaw [rad] of ``R = Rz(yaw) Ry(pitch) Rx(roll)``; pitch in [-pi/2, pi/2]."""
    r = rotation
    out = np.empty(3)
    out[0] = np.arctan2(r[2, 1], r[2, 2])
    out[1] = np.arctan2(-r[2, 0], np.sqrt(r[0, 0] ** 2 + r[1, 0] ** 2))
    out[2] = np.arctan2(r[1, 0], r[0, 0])
    return out


@kernel
def matrix_from_rpy(rpy: Vec3) -> Mat3:
    """``Rz(yaw) Ry(pitch) Rx(roll)`` of roll, pitch, yaw [rad]."""
    cr, sr = np.cos(rpy[0]), np.sin(rpy[0])
    cp, sp = np.cos(rpy[1]), np.sin(rpy[1])
    cy, sy = np.cos(rpy[2]), np.sin(rpy[2])
    m = np.empty((3, 3))
    m[0, 0], m[0, 1], m[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    m[1, 0], m[1, 1], m[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    m[2, 0], m[2, 1], m[2, 2] = -sp, cp * sr, cp * cr
    return m


@kernel
def rpy_jacobian(rpy: Vec3) -> Mat3:
    """``E`` with ``d(roll, pitch, yaw) = E dtheta`` for ``R Exp(dtheta)``; singular at pitch = +-pi/2."""
    cr, sr = np.cos(rpy[0]), np.sin(rpy[0])
    cp, tp = np.cos(rpy[1]), np.tan(rpy[1])
    m = np.zeros((3, 3))
    m[0, 0], m[0, 1], m[0, 2] = 1.0, sr * tp, cr * tp
    m[1, 1], m[1, 2] = cr, -sr
    m[2, 1], m[2, 2] = sr / cp, cr / cp
    return m


@kernel
def wrap(angle: float) -> float:
    """The angle [rad] brought into [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
