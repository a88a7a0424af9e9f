"""What a step does to the covariance: it is pushed through the transition, noise is added, and errors age."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    LAYER,
    OWN,
    ROTATION,
    STEADY,
    WATER,
    X_DEVIATION,
    X_PARAMETERS,
    X_SIZE,
    X_STEADY,
    Config,
)
from fbn_common.types import Array, Mat3

_MOVING: Final = 12  # position, rotation, velocity: the rows that a motion changes
_BY: Final = 24  # rotation 3, velocity 6, parameters 15: what it changes them by


class CovarianceScratch(NamedTuple):
    """Room to work in for one step after the other."""

    top: Array  # (12, size) of F P
    f_t: Array  # (24, 12) the transpose of F - I
    own: Array  # (12,)
    half: Array  # (6, 12)
    keep: Array  # (size,) what ageing leaves of each error ...
    aged: Array  # (1,) ... over this time [s]


@kernel
def new_covariance_scratch(size: int) -> CovarianceScratch:
    """Made once before a loop of steps; ``size`` of the error state."""
    return CovarianceScratch(
        np.empty((_MOVING, size)), np.empty((_BY, _MOVING)), np.empty(_MOVING),
        np.empty((6, 12)), np.ones(size), np.full(1, -1.0),
    )  # fmt: skip


@inner_kernel
def _add_rows(a: Array, rows: Array, first: int, out: Array) -> None:
    """``out += a rows[first : first + 24]``; four rows a round, as each round reads and writes ``out``."""
    for c in range(0, _BY, 4):
        k, a0, a1, a2, a3 = first + c, a[c], a[c + 1], a[c + 2], a[c + 3]
        for j in range(out.shape[0]):
            out[j] = out[j] + a0 * rows[k, j] + a1 * rows[k + 1, j] + a2 * rows[k + 2, j] + a3 * rows[k + 3, j]


@inner_kernel
def _add_own(a: Array, f_t: Array, own: Array) -> None:
    """``own += a f_t`` for the 12 rows that the motion changes."""
    for c in range(0, _BY, 4):
        a0, a1, a2, a3 = a[c], a[c + 1], a[c + 2], a[c + 3]
        for j in range(_MOVING):
            own[j] = own[j] + a0 * f_t[c, j] + a1 * f_t[c + 1, j] + a2 * f_t[c + 2, j] + a3 * f_t[c + 3, j]


@inner_kernel
def push(p: Array, f: Array, near: bool, g: Array, room: CovarianceScratch) -> None:
    """P <- F P F' for F = [I + f, and g where near the surface, on the first 12 rows; I], in place."""
    n, top, own = p.shape[0], room.top, room.own
    for i in range(_MOVING):
        for j in range(n):
            top[i, j] = p[i, j]
        for c in range(_BY):
            room.f_t[c, i] = f[i, c]
        _add_rows(f[i], p, ROTATION, top[i])
        if near:
            for c in range(3):
                for j in range(n):
                    top[i, j] += g[i, c] * p[LAYER + c, j]
    for i in range(_MOVING):
        for j in range(_MOVING, n):
            p[i, j] = top[i, j]
            p[j, i] = top[i, j]
        for j in range(_MOVING):
            own[j] = top[i, j]
        _add_own(top[i, ROTATION : ROTATION + _BY], room.f_t, own)
        if near:
            for c in range(3):
                for j in range(_MOVING):
                    own[j] += top[i, LAYER + c] * g[j, c]
        for j in range(i + 1):
            p[i, j] = own[j]
            p[j, i] = own[j]


@inner_kernel
def add_noise(p: Array, by_increment: Mat3, by_rotation: Mat3, noise: Array, w: float, room: CovarianceScratch) -> None:
    """P += w G Q G', with G taking (increment, rotation vector, velocity) to the error state."""
    half = room.half
    for i in range(3):
        for j in range(12):
            half[i, j] = (
                by_increment[i, 0] * noise[0, j] + by_increment[i, 1] * noise[1, j] + by_increment[i, 2] * noise[2, j]
            )
            half[3 + i, j] = (
                by_rotation[i, 0] * noise[3, j] + by_rotation[i, 1] * noise[4, j] + by_rotation[i, 2] * noise[5, j]
            )
    for i in range(6):
        for j in range(i + 1):
            if j < 3:
                g0, g1, g2, k = by_increment[j, 0], by_increment[j, 1], by_increment[j, 2], 0
            else:
                g0, g1, g2, k = by_rotation[j - 3, 0], by_rotation[j - 3, 1], by_rotation[j - 3, 2], 3
            total = half[i, k] * g0 + half[i, k + 1] * g1 + half[i, k + 2] * g2
            p[i, j] += w * total
            if i != j:
                p[j, i] += w * total
        for j in range(6, 12):
            p[i, j] += w * half[i, j]
            p[j, i] += w * half[i, j]
    for i in range(6, 12):
        for j in range(6, 12):
            p[i, j] += w * noise[i, j]


@inner_kernel
def wander(x: Array, p: Array, dt: float, config: Config) -> None:
    """The water's steady part walks, and the water with it; the water returns to it and wanders about it.  In place.

    With water w, steady part s and density of walk q: ``w <- s + k (w - s)``, ``k = exp(-dt / wander_time)``, plus
    variance ``(1 - k^2) wander E s^2``; then ``q dt`` on both as one.  Walk and wandering are the wider the faster
    the water is, of which the filter expects the mean square.
    """
    n, k, square = p.shape[0], np.exp(-dt / config.wander_time), 0.0
    for i in range(2):
        square += 0.5 * (x[X_STEADY + i] ** 2 + p[STEADY + i, STEADY + i])
    for i in range(2):
        w, s, water, steady = WATER + i, STEADY + i, X_PARAMETERS + 12 + i, X_STEADY + i
        x[water] = x[steady] + k * (x[water] - x[steady])
        for j in range(n):
            p[w, j] = k * p[w, j] + (1.0 - k) * p[s, j]
        p[w, w] = k * p[w, w] + (1.0 - k) * p[w, s] + (1.0 - k * k) * config.wander * square
        if p[s, s] < config.limit[12 + i]:
            walked = (config.walk[12 + i] + config.water_share * square) * dt
            p[s, s] += walked
            p[w, s] += walked
            p[w, w] += walked
        for j in range(n):
            p[j, w] = p[w, j]


@inner_kernel
def age(x: Array, p: Array, dt: float, config: Config, room: CovarianceScratch) -> None:
    """Random walks of the parameters and decorrelation of sensors' and surface's own errors, in place."""
    for i in range(15):
        if i != 12 and i != 13 and p[ACTUATION + i, ACTUATION + i] < config.limit[i]:
            p[ACTUATION + i, ACTUATION + i] += config.walk[i] * dt
    wander(x, p, dt, config)
    n, keep = p.shape[0], room.keep
    if room.aged[0] != dt:  # most steps are whole ones
        room.aged[0] = dt
        for b in range(OWN, n):
            keep[b] = np.exp(-dt / config.tau[b - OWN])
    for i in range(X_SIZE - X_DEVIATION):
        x[X_DEVIATION + i] *= keep[OWN + i]
    for b in range(OWN, n):
        for i in range(OWN):
            p[b, i] *= keep[b]
            p[i, b] = p[b, i]
        for i in range(OWN, b + 1):
            p[b, i] = p[b, i] * keep[i] * keep[b]
            p[i, b] = p[b, i]
        p[b, b] += (1.0 - keep[b] * keep[b]) * config.variance[b - OWN]
