"""The EKF's prediction: a published motion increment, re-linearised about the filter's own state.

See docs/equations/deadreck.md, "Prediction".  Written in scalars for numba; one layout (C) per argument.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import product, skew, so3_exp, so3_log, so3_right_jacobian
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    LAYER,
    OWN,
    POSITION,
    ROTATION,
    THRUST,
    WATER,
    X_DEVIATION,
    X_LAYER,
    X_PARAMETERS,
    X_ROTATION,
    X_SIZE,
    X_VELOCITY,
    Config,
    Motions,
)
from fbn_common.types import Array, Mat3


@kernel
def _apply(a: Mat3, v: Array) -> Array:
    return np.array([a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2] for i in range(3)])


@kernel
def rotation_of(x: Array) -> Mat3:
    """R_world_base (3, 3) of a state, a copy."""
    r = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            r[i, j] = x[X_ROTATION + 3 * i + j]
    return r


@kernel
def set_rotation(x: Array, rotation: Mat3) -> None:
    """Write R_world_base into a state, its columns made orthonormal again (Gram-Schmidt)."""
    r = rotation
    a, b = r[:, 0], r[:, 1]
    a = a / np.sqrt((a * a).sum())
    b = b - (a * b).sum() * a
    b = b / np.sqrt((b * b).sum())
    for i in range(3):
        x[X_ROTATION + 3 * i] = a[i]
        x[X_ROTATION + 3 * i + 1] = b[i]
    x[X_ROTATION + 2] = a[1] * b[2] - a[2] * b[1]
    x[X_ROTATION + 5] = a[2] * b[0] - a[0] * b[2]
    x[X_ROTATION + 8] = a[0] * b[1] - a[1] * b[0]


@kernel
def _layer_share(depth: float, config: Config) -> float:
    """Share of the top layer's motion at a depth [m]; none where that is below a 400th."""
    if depth > 6.0 * config.layer_depth:
        return 0.0
    return float(np.exp(-max(depth, 0.0) / config.layer_depth))


@kernel
def _offsets(
    x: Array, motions: Motions, k: int, a0: float, estimated: int, share: float, d: Array
) -> tuple[float, float]:
    """Our state less the one the motion was computed with: rotation 3, velocity 6, parameters 15, into ``d``.

    The dynamics do not know the heading but through the water velocity, so ours is first turned to the
    heading used: heading may differ by any angle.  ``share`` of the top layer's motion adds to the water's, which the
    motion knows nothing of.  Returns cosine and sine of that turn.
    """
    mean, used = motions.mean[k], motions.attitude[k].reshape(3, 3)
    yaw = np.arctan2(used[1, 0], used[0, 0]) - np.arctan2(x[X_ROTATION + 3], x[X_ROTATION])
    yaw += a0 * mean[5]  # to first order, the heading at the start of this part of the step
    c, s = np.cos(yaw), np.sin(yaw)
    ours = rotation_of(x)
    turned = np.empty((3, 3))
    for j in range(3):
        turned[0, j] = c * ours[0, j] - s * ours[1, j]
        turned[1, j] = s * ours[0, j] + c * ours[1, j]
        turned[2, j] = ours[2, j]
    base = product(used, so3_exp(a0 * mean[3:6]))
    d[0:3] = so3_log(product(np.ascontiguousarray(base.T), turned))
    for i in range(6):
        d[3 + i] = x[X_VELOCITY + i] - (mean[6 + i] + a0 * (mean[12 + i] - mean[6 + i]))
    if estimated <= ACTUATION + 3:  # considered parameters follow the motion's
        x[X_PARAMETERS + 3 : X_PARAMETERS + 15] = motions.parameters[k, 3:15]
    for i in range(12):
        d[9 + i] = x[X_PARAMETERS + i] - motions.parameters[k, i]
    wx, wy = x[X_PARAMETERS + 12], x[X_PARAMETERS + 13]
    if estimated <= ACTUATION + 3:  # the water is the motion's own, whatever the headings
        d[21:24] = 0.0
        d[21] = c * wx - s * wy - wx
        d[22] = s * wx + c * wy - wy
    else:
        d[21] = c * wx - s * wy - motions.parameters[k, 12]
        d[22] = s * wx + c * wy - motions.parameters[k, 13]
        d[23] = x[X_PARAMETERS + 14] - motions.parameters[k, 14]
    east, north = share * x[X_LAYER], share * x[X_LAYER + 1]
    d[21] += c * east - s * north
    d[22] += s * east + c * north
    return c, s


@kernel
def _transition(r: Mat3, turn: Mat3, s: Array, phi: Array, jacobian: Array, w: float, c: float, sn: float) -> Array:
    """F - I (12, 24): position, rotation, velocity by rotation 3, velocity 6, parameters 15."""
    f = np.zeros((12, 24))
    rc = product(r, turn)
    jr = so3_right_jacobian(phi)
    for j in range(24):
        for i in range(3):
            f[i, j] = w * (rc[i, 0] * jacobian[0, j] + rc[i, 1] * jacobian[1, j] + rc[i, 2] * jacobian[2, j])
            f[3 + i, j] = w * (jr[i, 0] * jacobian[3, j] + jr[i, 1] * jacobian[4, j] + jr[i, 2] * jacobian[5, j])
        for i in range(6):
            f[6 + i, j] = w * jacobian[6 + i, j]
    for i in range(6):
        f[6 + i, 3 + i] -= w
    moved = product(r, skew(_apply(turn, s)))
    back = so3_exp(-phi)
    for i in range(3):
        back[i, i] -= 1.0
        for j in range(3):
            f[i, j] -= moved[i, j]
    for i in range(3):
        for j in range(3):
            f[3 + i, j] += back[i, j]
    for i in range(12):
        east, north = f[i, 21], f[i, 22]
        f[i, 21], f[i, 22] = c * east + sn * north, -sn * east + c * north
    return f


@kernel
def _surface(x: Array, f: Array, share: float, config: Config) -> tuple[bool, Array]:
    """Columns (12, 3) of the surface's own states: top layer and thrust lost; they act as water and thrust do.

    The motion's Jacobian has them in it: thrust lost takes from the gain ahead, the top layer adds to the water.
    """
    g = np.zeros((12, 3))
    depth = -x[2]
    if share == 0.0 and depth > config.surface_depth:
        return False, g
    lost = -x[X_PARAMETERS + 9] if depth < config.surface_depth else 0.0
    for i in range(12):
        g[i, 0], g[i, 1] = share * f[i, WATER - ROTATION], share * f[i, WATER - ROTATION + 1]
        g[i, 2] = lost * f[i, THRUST - ROTATION]
    return True, g


@kernel
def _push(p: Array, f: Array, near: bool, g: Array) -> None:
    """P <- F P F' for F = [I + f, and g where near the surface, on the first 12 rows; I], in place."""
    n = p.shape[0]
    top, f_t, own = np.empty((12, n)), np.empty((24, 12)), np.empty(12)
    for i in range(12):
        for j in range(n):
            top[i, j] = p[i, j]
        for c in range(24):
            f_t[c, i] = f[i, c]
        _add_rows(f[i], p, ROTATION, top[i])
        if near:
            for c in range(3):
                for j in range(n):
                    top[i, j] += g[i, c] * p[LAYER + c, j]
    for i in range(12):
        for j in range(12, n):
            p[i, j] = top[i, j]
            p[j, i] = top[i, j]
        for j in range(12):
            own[j] = top[i, j]
        _add_rows(top[i, ROTATION : ROTATION + 24], f_t, 0, own)
        for j in range(i + 1):
            if near:
                for c in range(3):
                    own[j] += top[i, LAYER + c] * g[j, c]
            p[i, j] = own[j]
            p[j, i] = own[j]


@kernel
def _add_rows(a: Array, rows: Array, first: int, out: Array) -> None:
    """``out += a rows[first : first + 24]``; four rows a round, as each round reads and writes ``out``."""
    for c in range(0, 24, 4):
        k, a0, a1, a2, a3 = first + c, a[c], a[c + 1], a[c + 2], a[c + 3]
        for j in range(out.shape[0]):
            out[j] = out[j] + a0 * rows[k, j] + a1 * rows[k + 1, j] + a2 * rows[k + 2, j] + a3 * rows[k + 3, j]


@kernel
def _add_noise(p: Array, r: Mat3, turn: Mat3, phi: Array, noise: Array, w: float) -> None:
    """P += w G Q G', with G taking (increment, rotation vector, velocity) to the error state."""
    g = np.zeros((12, 12))
    g[0:3, 0:3] = product(r, turn)
    g[3:6, 3:6] = so3_right_jacobian(phi)
    half = np.zeros((6, 12))
    for i in range(6):
        first = 0 if i < 3 else 3
        for k in range(first, first + 3):
            for j in range(12):
                half[i, j] += g[i, k] * noise[k, j]
    for i in range(6):
        for j in range(i + 1):
            first, total = (0 if j < 3 else 3), 0.0
            for k in range(first, first + 3):
                total += half[i, k] * g[j, k]
            p[i, j] += w * total
            if i != j:
                p[j, i] += w * total
        for j in range(6, 12):
            p[i, j] += w * half[i, j]
            p[j, i] += w * half[i, j]
    for i in range(6, 12):
        for j in range(6, 12):
            p[i, j] += w * noise[i, j]


@kernel
def _age(x: Array, p: Array, dt: float, config: Config) -> None:
    """Random walks of the parameters and decorrelation of sensors' and surface's own errors, in place.

    The water's walk grows with the water's own speed, of which the filter expects the mean square.
    """
    square = 0.0
    for i in range(2):
        square += 0.5 * (x[X_PARAMETERS + 12 + i] ** 2 + p[WATER + i, WATER + i])
    for i in range(15):
        if p[ACTUATION + i, ACTUATION + i] < config.limit[i]:
            own = config.water_share * square if i == 12 or i == 13 else 0.0
            p[ACTUATION + i, ACTUATION + i] += (config.walk[i] + own) * dt
    n = p.shape[0]
    keep = np.ones(n)
    for b in range(OWN, n):
        keep[b] = np.exp(-dt / config.tau[b - OWN])
    for i in range(X_SIZE - X_DEVIATION):
        x[X_DEVIATION + i] *= keep[OWN + i]
    for i in range(n):
        for j in range(OWN if i < OWN else 0, n):
            p[i, j] = p[i, j] * keep[min(i, j)] * keep[max(i, j)]
    for b in range(OWN, n):
        p[b, b] += (1.0 - keep[b] * keep[b]) * config.variance[b - OWN]


@kernel
def _change(jacobian: Array, d: Array) -> Array:
    """What our offset adds to increment, rotation vector and velocity (12,) over the whole step."""
    change = np.zeros(12)
    for i in range(12):
        for j in range(24):
            change[i] += jacobian[i, j] * d[j]
    return change


@kernel
def propagate(x: Array, p: Array, motions: Motions, k: int, a0: float, a1: float, dt: float, config: Config) -> None:
    """State and covariance through the part ``a0..a1`` of motion ``k``, in place; ``dt`` [s] of that part.

    Increment, Jacobians and noise are interpolated linearly within the step, such that parts add up to the whole.
    """
    d = np.empty(24)
    share = _layer_share(-x[2], config)
    c, sn = _offsets(x, motions, k, a0, config.estimated, share, d)
    w, mean, jacobian = a1 - a0, motions.mean[k], motions.jacobian[k]
    change = _change(jacobian, d)
    if a0 > 0.0:  # our offset at the start of the step, so that parts add up to the whole
        for i in range(6):
            d[3 + i] -= a0 * (change[6 + i] - d[3 + i])
        change = _change(jacobian, d)
    s, phi = w * (mean[0:3] + change[0:3]), w * (mean[3:6] + change[3:6])
    r = rotation_of(x)
    turn = so3_exp(-a0 * mean[3:6])
    f = _transition(r, turn, s, phi, jacobian, w, c, sn)
    step = _apply(r, _apply(turn, s))
    for i in range(3):
        x[POSITION + i] += step[i]
    for i in range(6):
        x[X_VELOCITY + i] += w * (mean[12 + i] - mean[6 + i] + change[6 + i] - d[3 + i])
    set_rotation(x, product(r, so3_exp(phi)))
    near, g = _surface(x, f, share, config)
    _push(p, f, near, g)
    _add_noise(p, r, turn, phi, motions.noise[k], w)
    _age(x, p, dt, config)
