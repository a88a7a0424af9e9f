"""Measurement models and the update: gated, Schmidt (considered states keep their covariance), symmetric.

Each model fills the innovation ``nu``, its noise ``noise`` and the Jacobian ``h`` by the error states listed in
``columns``; see docs/equations/deadreck.md and reference.md.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import product, so3_exp, so3_log
from fbn_common.motion_ekf.layout import (
    ALTITUDE,
    ALTITUDE_TIME,
    DEPTH,
    DEVIATION,
    GPS,
    POSITION,
    ROTATION,
    TILT,
    VELOCITY,
    X_DEVIATION,
    X_PARAMETERS,
    X_SIZE,
    X_VELOCITY,
    Config,
    IntArray,
    Kind,
)
from fbn_common.motion_ekf.propagate import rotation_of, set_rotation
from fbn_common.types import Array, Mat3

COLUMNS = 10
GRAVITY = 9.81  # m/s^2
_COMPASS, _DEPTH, _CLIMB = int(Kind.COMPASS), int(Kind.DEPTH), int(Kind.CLIMB)
_POSITION, _RANGE = int(Kind.POSITION), int(Kind.RANGE)


@kernel
def deviation_waves(r: Mat3) -> Array:
    """What the deviation's coefficients (5,) are multiplied with at this attitude: hard iron once, soft iron twice."""
    length = max(np.sqrt(r[0, 0] ** 2 + r[1, 0] ** 2), 1e-9)
    c, s = r[0, 0] / length, r[1, 0] / length
    return np.array([1.0, s, c, 2.0 * s * c, c * c - s * s])


@kernel
def _compass(
    x: Array, data: Array, config: Config, nu: Array, noise: Array, columns: IntArray, h: Array
) -> tuple[int, int]:
    """``R_measured = Rz(deviation(yaw)) R Exp(tilt + noise)``: 3 rows by rotation and the compass's own errors.

    Its accelerometers take the acceleration of turns and waves for gravity, and the dipping field leaks into yaw.
    """
    r, measured = rotation_of(x), data[0:9].reshape(3, 3)
    waves = deviation_waves(r)
    deviation = 0.0
    for c in range(5):
        deviation += waves[c] * x[X_DEVIATION + c]
    believed = product(so3_exp(np.array([0.0, 0.0, deviation])), r)
    nu[0:3] = so3_log(product(np.ascontiguousarray(believed.T), measured))
    for i in range(2):
        columns[3 + i], h[i, 3 + i] = TILT + i, 1.0
    for c in range(5):
        columns[5 + c] = DEVIATION + c
        for i in range(3):
            h[i, 5 + c] = r[2, i] * waves[c]
    for i in range(3):
        columns[i] = ROTATION + i
        h[i, i] = 1.0
        for j in range(3):
            noise[i, j] = 0.0
            for k in range(3):
                for m in range(3):
                    noise[i, j] += r[k, i] * data[9 + 3 * k + m] * r[m, j]
    v = X_VELOCITY
    turn = (x[v + 5] * x[v] - x[v + 3] * x[v + 2]) / GRAVITY
    wave = config.wave_acceleration / GRAVITY * np.exp(min(x[2], 0.0) / config.wave_depth)
    noise[0, 0] += turn**2 + wave**2
    noise[1, 1] += wave**2
    noise[2, 2] += np.tan(config.dip) ** 2 * (turn**2 + wave**2)
    return 3, 10


@kernel
def _lever_rows(x: Array, lever: Array, h: Array, row: int, axis: int, at: int) -> float:
    """World coordinate ``axis`` of the lever arm; its Jacobian by the rotation goes to columns ``at..at+2``."""
    r = rotation_of(x)
    h[row, at] = r[axis, 2] * lever[1] - r[axis, 1] * lever[2]
    h[row, at + 1] = r[axis, 0] * lever[2] - r[axis, 2] * lever[0]
    h[row, at + 2] = r[axis, 1] * lever[0] - r[axis, 0] * lever[1]
    return float(r[axis, 0] * lever[0] + r[axis, 1] * lever[1] + r[axis, 2] * lever[2])


@kernel
def _depth(
    x: Array, data: Array, config: Config, nu: Array, noise: Array, columns: IntArray, h: Array
) -> tuple[int, int]:
    """``z + (R lever)_z + bias``, the bias growing with depth as density is uncertain."""
    lever = config.lever[_DEPTH]
    offset = _lever_rows(x, lever, h, 0, 2, 1)
    nu[0], noise[0, 0] = data[0] - x[2] - offset, data[1]
    columns[0], columns[4], h[0, 0], h[0, 4] = (
        POSITION + 2,
        DEPTH,
        1.0,
        np.sqrt(1.0 + (config.depth_scale * data[0]) ** 2),
    )
    for i in range(3):
        columns[1 + i] = ROTATION + i
    return 1, 5


@kernel
def _climb(
    x: Array, data: Array, row: Array, dt: float, nu: Array, noise: Array, columns: IntArray, h: Array
) -> tuple[int, int]:
    """``(R v)_z``, measured by the altitude's change since the base ``dt`` ago, less what the bottom may do."""
    velocity = x[X_VELOCITY : X_VELOCITY + 3]
    r = rotation_of(x)
    nu[0] = (data[0] * r[2, 2] - row[ALTITUDE]) / dt - _lever_rows(x, velocity, h, 0, 2, 0)
    noise[0, 0] = 2.0 * data[1] / dt**2 + data[2] ** 2 * (velocity * velocity).sum()
    for i in range(3):
        columns[i], columns[3 + i] = ROTATION + i, VELOCITY + i
        h[0, 3 + i] = r[2, i]
    return 1, 6


@kernel
def _position(
    x: Array, data: Array, config: Config, nu: Array, noise: Array, columns: IntArray, h: Array
) -> tuple[int, int]:
    """``xy + (R lever)_xy + L bias``, ``L L'`` being the correlated part of the fix's covariance."""
    xx, xy, yy = data[2], data[3], data[4]
    correlated = min(1.0 - config.white, 2.0 * config.correlated / (xx + yy))
    for i in range(2):
        offset = _lever_rows(x, config.lever[_POSITION], h, i, i, 2)
        nu[i] = data[i] - x[i] - offset
        columns[i], h[i, i] = POSITION + i, 1.0
        columns[5 + i] = GPS + i
    for i in range(3):
        columns[2 + i] = ROTATION + i
    noise[0, 0], noise[0, 1], noise[1, 0], noise[1, 1] = xx, xy, xy, yy
    for i in range(2):
        for j in range(2):
            noise[i, j] *= 1.0 - correlated
    a = np.sqrt(xx)
    h[0, 5], h[1, 5] = np.sqrt(correlated) * a, np.sqrt(correlated) * xy / a
    h[1, 6] = np.sqrt(correlated * max(yy - xy * xy / xx, 0.0))
    return 2, 7


@kernel
def _range(
    x: Array, data: Array, lever: Array, nu: Array, noise: Array, columns: IntArray, h: Array
) -> tuple[int, int]:
    """``|p + R lever - beacon|``, linearised at the data's own x and y if they have one: the state may be far off."""
    offset, arm, beyond = np.empty(3), np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        offset[i] = x[i] + _lever_rows(x, lever, arm, i, i, 0) - data[i]
    if data[5] != 0.0:
        for i in range(2):
            beyond[i] = offset[i] - (data[6 + i] - data[i])
            offset[i] -= beyond[i]
    distance = max(np.sqrt((offset * offset).sum()), 1e-3)
    nu[0], noise[0, 0] = data[3] - distance - (offset * beyond).sum() / distance, data[4]
    for i in range(3):
        columns[i], columns[3 + i] = POSITION + i, ROTATION + i
        h[0, i] = offset[i] / distance
    for j in range(3):
        h[0, 3 + j] = h[0, 0] * arm[0, j] + h[0, 1] * arm[1, j] + h[0, 2] * arm[2, j]
    return 1, 6


@kernel
def model(
    kind: int,
    x: Array,
    data: Array,
    row: Array,
    time_s: float,
    config: Config,
    nu: Array,
    noise: Array,
    columns: IntArray,
    h: Array,
) -> tuple[int, int]:
    """The model of a kind of measurement; ``h`` comes zeroed.  Gives the numbers of rows and of columns."""
    if kind == _COMPASS:
        return _compass(x, data, config, nu, noise, columns, h)
    if kind == _DEPTH:
        return _depth(x, data, config, nu, noise, columns, h)
    if kind == _CLIMB:
        return _climb(x, data, row, time_s - row[ALTITUDE_TIME], nu, noise, columns, h)
    if kind == _POSITION:
        return _position(x, data, config, nu, noise, columns, h)
    return _range(x, data, config.lever[_RANGE], nu, noise, columns, h)


@kernel
def project(p: Array, columns: IntArray, h: Array, m: int, k: int) -> Array:
    """``H P`` (m, n)."""
    n = p.shape[0]
    hp = np.zeros((m, n))
    for i in range(m):
        for c in range(k):
            a = h[i, c]
            if a != 0.0:
                for j in range(n):
                    hp[i, j] += a * p[columns[c], j]
    return hp


@kernel
def innovation_covariance(hp: Array, columns: IntArray, h: Array, noise: Array, m: int, k: int) -> Array:
    """``S = H P H' + R`` (m, m), exactly symmetric."""
    s = np.empty((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = noise[i, j]
            for c in range(k):
                total += hp[i, columns[c]] * h[j, c]
            s[i, j] = total
            s[j, i] = total
    return s


@kernel
def cholesky(s: Array) -> bool:
    """Lower Cholesky factor in place (the upper triangle is left); False where it is not positive definite."""
    m = s.shape[0]
    for i in range(m):
        for j in range(i + 1):
            total = s[i, j]
            for k in range(j):
                total -= s[i, k] * s[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                s[i, i] = np.sqrt(total)
            else:
                s[i, j] = total / s[j, j]
    return True


@kernel
def whiten(factor: Array, rows: Array) -> None:
    """``rows <- L^-1 rows`` in place, for (m, n) rows."""
    m, n = rows.shape
    for i in range(m):
        for k in range(i):
            a = factor[i, k]
            for j in range(n):
                rows[i, j] -= a * rows[k, j]
        a = 1.0 / factor[i, i]
        for j in range(n):
            rows[i, j] *= a


@kernel
def correct(x: Array, p: Array, gain: Array, white: Array, first: int, estimated: int) -> None:
    """Apply the update: ``gain`` is ``L^-1 H P`` (m, n), ``white`` the whitened innovation (m,).

    States ``first:estimated`` are corrected.  The downdate ``P -= gain' gain`` leaves out the block of all others,
    which are considered (Schmidt 1966).  Against the
    optimal posterior that adds a positive semidefinite block: P stays positive definite.
    """
    m, n = gain.shape
    dx = np.zeros(estimated)
    for i in range(m):
        for j in range(first, estimated):
            dx[j] += gain[i, j] * white[i]
    for i in range(first, estimated):
        for k in range(m):
            a = gain[k, i]
            for j in range(first):
                p[i, j] -= a * gain[k, j]
            for j in range(i, n):
                p[i, j] -= a * gain[k, j]
        for j in range(first):
            p[j, i] = p[i, j]
        for j in range(i + 1, n):
            p[j, i] = p[i, j]
    apply_error(x, dx)


@kernel
def apply_error(x: Array, dx: Array) -> None:
    """``x <- x (+) dx``: all add but the rotation, which is perturbed on the right."""
    r, turn = rotation_of(x), so3_exp(dx[ROTATION : ROTATION + 3])
    out = np.zeros((3, 3))
    for i in range(3):
        x[i] += dx[i]
        for j in range(3):
            for k in range(3):
                out[i, j] += r[i, k] * turn[k, j]
    set_rotation(x, out)
    for i in range(6):
        x[X_VELOCITY + i] += dx[VELOCITY + i]
    for i in range(min(dx.shape[0] - 12, X_SIZE - X_PARAMETERS)):
        x[X_PARAMETERS + i] += dx[12 + i]
