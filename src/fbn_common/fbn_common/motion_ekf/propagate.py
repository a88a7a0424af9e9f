"""The EKF's prediction: a published motion increment, re-linearised about the filter's own state.

See docs/equations/deadreck.md, "Prediction".  Written in scalars for numba; one layout (C) per argument.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import product_into, so3_exp_into, so3_log_into, so3_right_jacobian_into
from fbn_common.motion_ekf.covariance import CovarianceScratch, add_noise, age, new_covariance_scratch, push
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    POSITION,
    ROTATION,
    THRUST,
    WATER,
    X_LAYER,
    X_PARAMETERS,
    X_ROTATION,
    X_VELOCITY,
    Config,
    Motions,
)
from fbn_common.types import Array, Mat3, Vec3


class Scratch(NamedTuple):
    """Room to work in for one step after the other."""

    d: Array  # (24,) our state less the motion's: rotation 3, velocity 6, parameters 15
    change: Array  # (12,) what that adds to the motion over the whole step
    f: Array  # (12, 24) F - I: position, rotation, velocity by rotation 3, velocity 6, parameters 15
    g: Array  # (12, 3) the same by the surface's own states
    s: Vec3  # increment
    phi: Vec3  # rotation vector
    v: Vec3
    w: Vec3
    r: Mat3  # R_world_base at the start
    turn: Mat3  # from the start of this part of the step to the start of the step
    r_turn: Mat3
    jr: Mat3
    m: Mat3
    n: Mat3
    covariance: CovarianceScratch


@kernel
def new_scratch(size: int) -> Scratch:
    """Made once before a loop of steps; ``size`` of the error state."""
    m = np.empty((6, 3, 3))
    v = np.empty((4, 3))
    return Scratch(
        np.empty(24), np.empty(12), np.empty((12, 24)), np.zeros((12, 3)), v[0], v[1], v[2], v[3],
        m[0], m[1], m[2], m[3], m[4], m[5], new_covariance_scratch(size),
    )  # fmt: skip


@inner_kernel
def _apply(a: Mat3, v: Array, out: Vec3) -> None:
    for i in range(3):
        out[i] = a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2]


@kernel
def rotation_of(x: Array) -> Mat3:
    """R_world_base (3, 3) of a state, a copy."""
    r = np.empty((3, 3))
    rotation_into(x, r)
    return r


@inner_kernel
def rotation_into(x: Array, r: Mat3) -> None:
    """:func:`rotation_of` written into ``r``."""
    for i in range(3):
        for j in range(3):
            r[i, j] = x[X_ROTATION + 3 * i + j]


@inner_kernel
def set_rotation(x: Array, rotation: Mat3) -> None:
    """Write R_world_base into a state, its columns made orthonormal again (Gram-Schmidt)."""
    a0, a1, a2, b0, b1, b2 = (rotation[0, 0], rotation[1, 0], rotation[2, 0],
                              rotation[0, 1], rotation[1, 1], rotation[2, 1])  # fmt: skip
    length = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    a0, a1, a2 = a0 / length, a1 / length, a2 / length
    along = a0 * b0 + a1 * b1 + a2 * b2
    b0, b1, b2 = b0 - along * a0, b1 - along * a1, b2 - along * a2
    length = np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
    b0, b1, b2 = b0 / length, b1 / length, b2 / length
    x[X_ROTATION], x[X_ROTATION + 1], x[X_ROTATION + 2] = a0, b0, a1 * b2 - a2 * b1
    x[X_ROTATION + 3], x[X_ROTATION + 4], x[X_ROTATION + 5] = a1, b1, a2 * b0 - a0 * b2
    x[X_ROTATION + 6], x[X_ROTATION + 7], x[X_ROTATION + 8] = a2, b2, a0 * b1 - a1 * b0


@inner_kernel
def _layer_share(depth: float, config: Config) -> float:
    """Share of the top layer's motion at a depth [m]; none where that is below a 400th."""
    if depth > 6.0 * config.layer_depth:
        return 0.0
    return float(np.exp(-max(depth, 0.0) / config.layer_depth))


@inner_kernel
def _heading_change(x: Array, used: Array, ahead: float) -> tuple[float, float]:
    """Cosine and sine of the turn from our heading to the one used, and by ``ahead`` [rad] on."""
    u0, u1, o0, o1 = used[0], used[3], x[X_ROTATION], x[X_ROTATION + 3]
    length = np.sqrt((u0 * u0 + u1 * u1) * (o0 * o0 + o1 * o1))
    c, s = 1.0, 0.0
    if length > 0.0:  # else one of them looks straight up, and any heading is as good
        c, s = (u0 * o0 + u1 * o1) / length, (u1 * o0 - u0 * o1) / length
    if ahead != 0.0:
        ca, sa = np.cos(ahead), np.sin(ahead)
        c, s = c * ca - s * sa, s * ca + c * sa
    return c, s


@inner_kernel
def _rotation_offset(used: Array, mean: Array, a0: float, c: float, s: float, room: Scratch) -> None:
    """Ours, turned to the heading used, less the one used at this part of the step, into ``d[0:3]``."""
    base, turned, r = room.m, room.n, room.r
    for j in range(3):
        turned[0, j], turned[1, j], turned[2, j] = c * r[0, j] - s * r[1, j], s * r[0, j] + c * r[1, j], r[2, j]
    used_r = used.reshape(3, 3)
    for i in range(3):  # base' turned, with base = used Exp(a0 rotation)
        for j in range(3):
            base[i, j] = used_r[0, i] * turned[0, j] + used_r[1, i] * turned[1, j] + used_r[2, i] * turned[2, j]
    if a0 > 0.0:
        for i in range(3):
            room.v[i] = -a0 * mean[3 + i]
        so3_exp_into(room.v, room.jr)
        product_into(room.jr, base, turned)
        so3_log_into(turned, room.d[0:3])
    else:
        so3_log_into(base, room.d[0:3])


@inner_kernel
def _offsets(
    x: Array, motions: Motions, k: int, a0: float, estimated: int, share: float, room: Scratch
) -> tuple[float, float]:
    """Our state less the one the motion was computed with, into ``d``.

    The dynamics do not know the heading but through the water velocity, so ours is first turned to the
    heading used: heading may differ by any angle.  ``share`` of the top layer's motion adds to the water's, which the
    motion knows nothing of.  Returns cosine and sine of that turn.
    """
    mean, used, parameters, d = motions.mean[k], motions.attitude[k], motions.parameters[k], room.d
    # to first order, the heading at the start of this part of the step
    c, s = _heading_change(x, used, a0 * mean[5])
    _rotation_offset(used, mean, a0, c, s, room)
    for i in range(6):
        d[3 + i] = x[X_VELOCITY + i] - (mean[6 + i] + a0 * (mean[12 + i] - mean[6 + i]))
    if estimated <= ACTUATION + 3:  # considered parameters follow the motion's
        for i in range(3, 15):
            x[X_PARAMETERS + i] = parameters[i]
    for i in range(12):
        d[9 + i] = x[X_PARAMETERS + i] - parameters[i]
    wx, wy = x[X_PARAMETERS + 12], x[X_PARAMETERS + 13]
    if estimated <= ACTUATION + 3:  # the water is the motion's own, whatever the headings
        d[21], d[22], d[23] = c * wx - s * wy - wx, s * wx + c * wy - wy, 0.0
    else:
        d[21], d[22] = c * wx - s * wy - parameters[12], s * wx + c * wy - parameters[13]
        d[23] = x[X_PARAMETERS + 14] - parameters[14]
    east, north = share * x[X_LAYER], share * x[X_LAYER + 1]
    d[21] += c * east - s * north
    d[22] += s * east + c * north
    return c, s


@inner_kernel
def _transition(jacobian: Array, w: float, c: float, sn: float, room: Scratch) -> None:
    """F - I (12, 24), into ``f``."""
    f, rt, jr, m, n = room.f, room.r_turn, room.jr, room.m, room.n
    product_into(room.r, room.turn, rt)
    so3_right_jacobian_into(room.phi, jr)
    for i in range(3):
        t0, t1, t2, j0, j1, j2 = w * rt[i, 0], w * rt[i, 1], w * rt[i, 2], w * jr[i, 0], w * jr[i, 1], w * jr[i, 2]
        for j in range(24):
            f[i, j] = t0 * jacobian[0, j] + t1 * jacobian[1, j] + t2 * jacobian[2, j]
            f[3 + i, j] = j0 * jacobian[3, j] + j1 * jacobian[4, j] + j2 * jacobian[5, j]
    for i in range(6):
        for j in range(24):
            f[6 + i, j] = w * jacobian[6 + i, j]
        f[6 + i, 3 + i] -= w
    _apply(room.turn, room.s, room.v)
    a, b, e = room.v[0], room.v[1], room.v[2]
    for i in range(3):  # - R [turn s]x
        m[i, 0], m[i, 1], m[i, 2] = (
            room.r[i, 1] * e - room.r[i, 2] * b,
            room.r[i, 2] * a - room.r[i, 0] * e,
            room.r[i, 0] * b - room.r[i, 1] * a,
        )
        room.w[i] = -room.phi[i]
    so3_exp_into(room.w, n)
    for i in range(3):
        n[i, i] -= 1.0
    for i in range(3):
        for j in range(3):
            f[i, j] -= m[i, j]
            f[3 + i, j] += n[i, j]
    for i in range(12):
        east, north = f[i, 21], f[i, 22]
        f[i, 21], f[i, 22] = c * east + sn * north, -sn * east + c * north


@inner_kernel
def _surface(x: Array, share: float, config: Config, f: Array, g: Array) -> bool:
    """Columns (12, 3) of the surface's own states: top layer and thrust lost; they act as water and thrust do.

    The motion's Jacobian has them in it: thrust lost takes from the gain ahead, the top layer adds to the water.
    Whether the vehicle is near enough to the surface for them.
    """
    depth = -x[2]
    if share == 0.0 and depth > config.surface_depth:
        return False
    lost = -x[X_PARAMETERS + 9] if depth < config.surface_depth else 0.0
    for i in range(12):
        g[i, 0], g[i, 1] = share * f[i, WATER - ROTATION], share * f[i, WATER - ROTATION + 1]
        g[i, 2] = lost * f[i, THRUST - ROTATION]
    return True


@inner_kernel
def _change(jacobian: Array, d: Array, change: Array) -> None:
    """What our offset adds to increment, rotation vector and velocity (12,) over the whole step."""
    for i in range(12):
        total = 0.0
        for j in range(6):  # four at a time: none waits for the one before
            total += (jacobian[i, j] * d[j] + jacobian[i, 6 + j] * d[6 + j]) + (
                jacobian[i, 12 + j] * d[12 + j] + jacobian[i, 18 + j] * d[18 + j]
            )
        change[i] = total


@kernel
def propagate(x: Array, p: Array, motions: Motions, k: int, a0: float, a1: float, dt: float, config: Config) -> None:
    """:func:`carry` once."""
    carry(x, p, motions, k, a0, a1, dt, config, new_scratch(p.shape[0]))


@inner_kernel
def carry(
    x: Array, p: Array, motions: Motions, k: int, a0: float, a1: float, dt: float, config: Config, room: Scratch
) -> None:
    """State and covariance through the part ``a0..a1`` of motion ``k``, in place; ``dt`` [s] of that part.

    Increment, Jacobians and noise are interpolated linearly within the step, such that parts add up to the whole.
    """
    d, change, s, phi = room.d, room.change, room.s, room.phi
    share = _layer_share(-x[2], config)
    rotation_into(x, room.r)
    c, sn = _offsets(x, motions, k, a0, config.estimated, share, room)
    w, mean, jacobian = a1 - a0, motions.mean[k], motions.jacobian[k]
    _change(jacobian, d, change)
    if a0 > 0.0:  # our offset at the start of the step, so that parts add up to the whole
        for i in range(6):
            d[3 + i] -= a0 * (change[6 + i] - d[3 + i])
        _change(jacobian, d, change)
    for i in range(3):
        s[i], phi[i] = w * (mean[i] + change[i]), w * (mean[3 + i] + change[3 + i])
        room.v[i] = -a0 * mean[3 + i]
    so3_exp_into(room.v, room.turn)
    _transition(jacobian, w, c, sn, room)
    _apply(room.turn, s, room.v)
    _apply(room.r, room.v, room.w)
    for i in range(3):
        x[POSITION + i] += room.w[i]
    for i in range(6):
        x[X_VELOCITY + i] += w * (mean[12 + i] - mean[6 + i] + change[6 + i] - d[3 + i])
    so3_exp_into(phi, room.m)
    product_into(room.r, room.m, room.n)
    set_rotation(x, room.n)
    near = _surface(x, share, config, room.f, room.g)
    push(p, room.f, near, room.g, room.covariance)
    add_noise(p, room.r_turn, room.jr, motions.noise[k], w, room.covariance)
    age(x, p, dt, config, room.covariance)
