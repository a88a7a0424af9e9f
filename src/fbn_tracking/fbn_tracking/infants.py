"""Where an infant most likely is while the poses stay as they are, and what each echo would cost it.

An infant's unknowns are ``(r, phi, theta)`` in the frame of the array that saw it first, and two numbers of slack:
how far the window's drift (world x, y [m/s]) may still be wrong.  The slack carries the prior that the smoother has
of its drift, so that a pose error common to all pings is not taken for the target's motion; the poses themselves
are never moved.  Levenberg-Marquardt, all by hand: five unknowns, microseconds.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import product_into
from fbn_common.types import Array, Mat2, Mat3, Vec2, Vec3
from fbn_tracking.geometry import elevation_scale, observe_into, see_into, u_from_theta, world_point

_ITERATIONS = 20
_PROFILE_ITERATIONS = 3  # nearly linear in all but theta, and from one angle to the next
_CONVERGED = 1e-5  # of the energy
_EXACT = 1e9  # s^2/m^2: information that holds the drift's slack at rest


@kernel
def cholesky_solve(H: Array, g: Array) -> Array:
    """``H^-1 g`` for a small positive definite H (n, n); NaN where it is not."""
    n = g.shape[0]
    L, x = np.zeros((n, n)), g.copy()
    for i in range(n):
        for j in range(i + 1):
            s = H[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = (np.sqrt(s) if s > 0.0 else np.nan) if i == j else s / L[j, j]
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x


@kernel
def symmetric_inverse(H: Array) -> Array:
    """Inverse of a small positive definite matrix (n, n), column by column."""
    n = H.shape[0]
    out = np.empty((n, n))
    for i in range(n):
        unit = np.zeros(n)
        unit[i] = 1.0
        out[:, i] = cholesky_solve(H, unit)
    return 0.5 * (out + out.T)


@inner_kernel
def whitened(row: int, s: Vec3, z: Array) -> tuple[float, float]:
    """Derivative by the coordinate itself, and residual, of r, phi or u (row 0, 1, 2) in units of its noise."""
    if row < 2:
        return 1.0 / z[2 + row], (s[row] - z[row]) / z[2 + row]
    return z[4] + 3.0 * z[5] * s[2] ** 2, u_from_theta(s[2], z[4], z[5])


@kernel
def normal_equations(
    x: Array, R: Array, p: Array, t: Array, z: Array, drift_information: Mat2, memory: Vec3, memory_information: Mat3
) -> tuple[Array, Array, float, float]:
    """Information (5, 5), gradient (5), energy, and the part of the energy that speaks of a static target.

    ``x`` is r, phi, theta, slack x, y.  ``R`` (n, 3, 3), ``p`` (n, 3): the arrays in the world; ``t`` (n) [s] since
    the first; ``z`` (n, 6): r, phi, their sigmas, elevation shape a, c.  ``memory``: a world point known from before.
    """
    H, g = np.zeros((5, 5)), np.zeros(5)
    point, d_q = world_point(R[0], p[0], x[:3].copy())
    energy, static = _add_looks(x, R, p, t, z, point, d_q, H, g, np.empty((3, 3, 3)), np.empty((3, 5)))
    for k in range(5):
        for m in range(k):
            H[m, k] = H[k, m]
    v, w = x[3:].copy(), drift_information @ x[3:].copy()
    H[3:, 3:] += drift_information
    g[3:] -= w
    prior = float(v @ w)
    energy, static = energy + prior, static + prior
    if not memory_information.any():
        return H, g, energy, static
    gap = point - memory
    pull = memory_information @ gap
    H[:3, :3] += d_q.T @ (memory_information @ d_q)
    g[:3] -= d_q.T @ pull
    return H, g, float(energy + gap @ pull), float(static)


@inner_kernel
def _add_looks(
    x: Array, R: Array, p: Array, t: Array, z: Array, point: Vec3, d_q: Mat3, H: Array, g: Array, by: Array, rows: Array
) -> tuple[float, float]:
    """Add what the looks say to the lower half of ``H`` and to ``g``; gives their energy, and that of r and phi alone.

    ``by`` (3, 3, 3) and ``rows`` (3, 5) are written over.
    """
    energy, static, at, s, J = 0.0, 0.0, rows[0], rows[1], rows[2]
    for i in range(t.shape[0]):
        drifted_into(x, p[i], t[i], at)
        observe_into(R[i], at, point, s, by[0], by[1])
        product_into(by[0], d_q, by[2])
        for row in range(3):
            scale, e = whitened(row, s, z[i])
            if row < 2:
                static += e * e
            for k in range(3):
                J[k] = scale * by[2, row, k]
            J[3], J[4] = -scale * by[0, row, 0] * t[i], -scale * by[0, row, 1] * t[i]
            energy += e * e
            for k in range(5):
                g[k] -= J[k] * e
                for m in range(k + 1):
                    H[k, m] += J[k] * J[m]
    return energy, static


@inner_kernel
def looks_energy(x: Array, R: Array, p: Array, t: Array, z: Array, point: Vec3, at: Vec3, s: Vec3) -> float:
    """The looks' energy alone, at a fraction of the cost; ``at`` and ``s`` (3) are written over."""
    energy = 0.0
    for i in range(t.shape[0]):
        drifted_into(x, p[i], t[i], at)
        see_into(R[i], at, point, s)
        for row in range(3):
            _, e = whitened(row, s, z[i])
            energy += e * e
    return energy


@inner_kernel
def drifted_into(x: Array, p: Vec3, t: float, out: Vec3) -> None:
    """Where an array was, the slack of ``x`` having acted for ``t`` [s]."""
    out[0], out[1], out[2] = p[0] + x[3] * t, p[1] + x[4] * t, p[2]


@kernel
def profile(
    thetas: Array, x0: Array, R: Array, p: Array, t: Array, z: Array, drift_information: Mat2
) -> tuple[Array, Array]:
    """Energy (m) and world point (m, 3) of the likeliest place at each of the given ``thetas`` (m) [rad]."""
    energies, points = np.empty(thetas.shape[0]), np.empty((thetas.shape[0], 3))
    free, none, at, s = np.array([0, 1, 3, 4]), np.zeros((3, 3)), np.empty(3), np.empty(3)
    x = x0.copy()
    for i in range(thetas.shape[0]):
        x[2] = thetas[i]  # all else starts where the angle before left it
        for _ in range(_PROFILE_ITERATIONS if i else _ITERATIONS):
            H, g, _, _ = normal_equations(x, R, p, t, z, drift_information, np.zeros(3), none)
            step = cholesky_solve(H[free][:, free], g[free])
            for k in range(4):
                x[free[k]] += step[k]
        points[i], _ = world_point(R[0], p[0], x[:3].copy())
        slack = x[3:].copy()
        energies[i] = looks_energy(x, R, p, t, z, points[i], at, s) + slack @ (drift_information @ slack)
    return energies, points


@kernel
def fit(
    q0: Vec3,
    R: Array,
    p: Array,
    t: Array,
    z: Array,
    drift_information: Mat2,
    memory: Vec3,
    memory_information: Mat3,
) -> tuple[Array, Array, float, float]:
    """Most likely unknowns (5) near the start ``q0``, their information (5, 5), energy and static-world energy."""
    x = np.zeros(5)
    x[:3] = q0
    H, g, energy, static = normal_equations(x, R, p, t, z, drift_information, memory, memory_information)
    damping = 1e-2
    for _ in range(_ITERATIONS):
        damped = H.copy()
        for i in range(5):
            damped[i, i] += damping * H[i, i] + 1e-12
        step = cholesky_solve(damped, g)
        y = x + step
        y[0], y[2] = max(y[0], 0.1), min(max(y[2], -1.2), 1.2)
        y[1] = min(max(y[1], 0.02), np.pi - 0.02)
        H2, g2, energy2, static2 = normal_equations(y, R, p, t, z, drift_information, memory, memory_information)
        if energy2 <= energy:  # false for NaN too
            done = energy - energy2 < _CONVERGED * (1.0 + energy)
            x, H, g, energy, static, damping = y, H2, g2, energy2, static2, damping * 0.2
            if done:
                break
        else:
            damping *= 8.0
            if damping > 1e8:
                break
    return x, H, energy, static


@kernel
def spread(x: Array, H: Array, R: Mat3, p: Vec3, a: float, c: float) -> tuple[Vec3, Array]:
    """World point and covariance (5, 5) of (point, slack), the elevation's slope taken over one sigma of u."""
    point, d_q = world_point(R, p, x[:3].copy())
    bounded = H.copy()
    bounded[2, 2] += 1e-6
    P = symmetric_inverse(bounded)
    J = np.zeros((5, 5))
    J[:3, :3], J[3, 3], J[4, 4] = d_q, 1.0, 1.0
    J[:3, 2] *= elevation_scale(x[2], np.sqrt(max(P[2, 2], 0.0)), a, c)
    return point, J @ P @ J.T


@kernel
def settled(
    q0: Vec3, R: Array, p: Array, t: Array, z: Array, raw: Array, drift_information: Mat2,
    memory: Vec3, memory_information: Mat3,
) -> tuple[Array, Vec3, Array, Mat3, float, float]:  # fmt: skip
    """Most likely unknowns near ``q0``, their world point and covariance (5, 5) of point and slack, energies as `fit`.

    In between, the point's covariance (3, 3) were the poses and the drift exact: of the echoes as they are (``raw``).
    """
    R0, p0, a, c = R[0].copy(), p[0].copy(), z[0, 4], z[0, 5]
    x, H, energy, static = fit(q0, R, p, t, z, drift_information, memory, memory_information)
    point, covariance = spread(x, H, R0, p0, a, c)
    exact, _, _, _ = normal_equations(x, R, p, t, raw, _EXACT * np.eye(2), memory, memory_information)
    _, given_poses = spread(x, exact, R0, p0, a, c)
    return x, point, covariance, given_poses[:3, :3].copy(), energy, static


def slack_covariance(drift_covariance: Mat3, heading: Vec2) -> Mat2:
    """World xy covariance [m^2/s^2] of the drift (world x, y, body forward), heading along ``heading``."""
    G = np.array([[1.0, 0.0, heading[0]], [0.0, 1.0, heading[1]]])
    return np.asarray(G @ drift_covariance @ G.T + 1e-8 * np.eye(2))
