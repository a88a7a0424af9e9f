"""One Gauss-Newton step of a window: linearise and eliminate pose by pose with Householder reflections; all compiled.

The whitened Jacobian is brought to its square root ``R`` by orthogonal transformations alone (square-root smoothing:
Dellaert and Kaess, 2006); no information matrix is formed.  Poses go in the order of time, so that each reflection
touches one pose, the next one, and the border: drift, features, their anchors, and whatever else is kept.  The
border's own triangle stands in the last corner of ``R`` and is the square root of their joint information.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fbn_common.kernels import kernel
from fbn_common.lie import so3_exp
from fbn_common.types import Array, Vec3
from fbn_tracking.factors import earth_kernel, link_kernel
from fbn_tracking.geometry import anchored_observation, brought, carried, u_from_theta

Whole = NDArray[np.int64]

# A ping's row: increment 3, its rotation 9, dt, link's whitener 36, earth 4, its whitener 16.
MOTION = 69
# A detection's row: mounts of the anchor's array and of its own 16 + 16, then r, phi, their sigmas, a, c.
LOOK = 38
# The base's: gauge x, y, then mean 7 and whitener 49.
BASE = 58
_POOL = 96  # rows of the border gathered before they are reduced


@kernel
def reduce_columns(A: Array, y: Array, top: int, rows: int, first: int, count: int, width: int) -> None:
    """Householder reflections that leave ``count`` columns from ``first`` on upper triangular, pivots from row ``top``.

    In place on ``A`` (rows, width) and the right side ``y``.  Rows without a share in a column are passed over.
    """
    w = np.empty(width)
    for i in range(count):
        p, c = top + i, first + i
        if p >= rows:
            return
        square = 0.0
        for r in range(p, rows):
            square += A[r, c] * A[r, c]
        if square == 0.0:
            continue
        length = np.sqrt(square)
        alpha = -length if A[p, c] > 0.0 else length
        A[p, c] -= alpha
        beta = -1.0 / (alpha * A[p, c])
        right, sums = 0.0, w[c + 1 : width]
        sums[:] = 0.0
        for r in range(p, rows):
            v = A[r, c]
            if v != 0.0:
                right += v * y[r]
                _add(sums, v, A[r, c + 1 : width])
        for r in range(p, rows):
            v = beta * A[r, c]
            if v != 0.0:
                y[r] -= v * right
                _add(A[r, c + 1 : width], -v, sums)
                A[r, c] = 0.0
        A[p, c] = alpha


@kernel
def _add(to: Array, factor: float, row: Array) -> None:
    for j in range(to.shape[0]):
        to[j] += factor * row[j]


@kernel
def eliminate(
    base: Array, motion: Array, looks: Array, at: Whole, starts: Whole, weak: float, weights: Array,
    T: Array, drift: Vec3, q: Array, column: Whole, feature_column: Whole, top: Whole, width: int,
) -> tuple[Array, Array, Array, float]:  # fmt: skip
    """Border's triangle (width, width), its right side, the poses' rows (n, 6, 13 + width), half the sum of squares.

    ``at`` (d, 4): rows of pose, anchor and feature, and whether it is the anchor's own detection, sorted by pose;
    ``starts`` (n + 1) of each pose's.  ``weights`` (m): information added along each feature's theta.  ``column`` (n)
    of the poses in the border, -1 of the others; ``top`` (n): columns in use once a pose has come.
    """
    n = T.shape[0]
    most = 0
    for k in range(n):
        most = max(most, starts[k + 1] - starts[k])
    A, y = np.zeros((25 + 5 * most, 12 + width)), np.zeros(25 + 5 * most)
    pool, rest = np.zeros((width + _POOL + 25 + 5 * most, width)), np.zeros(width + _POOL + 25 + 5 * most)
    chain = np.zeros((n, 6, 13 + width))
    held, passed, energy = 0, 0, 0.0
    for k in range(n):
        inner = column[k] < 0
        own = 0 if inner else 12 + column[k]
        rows = passed
        if k == 0:
            rows = _base_rows(A, y, rows, own, base, T[0], drift)
        rows = _earth_rows(A, y, rows, own, motion[k], T[k])
        for d in range(starts[k], starts[k + 1]):
            f, anchor = at[d, 2], at[d, 1]
            by_q = 12 + feature_column[f]
            if at[d, 3]:
                rows = _first_rows(A, y, rows, by_q, looks[d, 32:], q[f], weak, weights[f])
            else:
                rows = _look_rows(A, y, rows, own, 12 + column[anchor], by_q, looks[d], T[anchor], T[k], q[f])
        inner_next = k + 1 < n and column[k + 1] < 0
        if k + 1 < n:
            after = 6 if inner_next else 12 + column[k + 1]
            rows = _link_rows(A, y, rows, own, after, motion[k + 1], T[k], T[k + 1], drift)
        for r in range(passed, rows):
            energy += 0.5 * y[r] * y[r]
        active, done = 12 + top[min(k + 1, n - 1)], 0
        if inner:
            reduce_columns(A, y, 0, rows, 0, 6, active)
            done = min(6, rows)
            chain[k, :done, : 12 + width], chain[k, :done, 12 + width] = A[:done], y[:done]
        passed = 0
        if inner_next:
            reduce_columns(A, y, done, rows, 6, 6, active)
            passed = min(6, rows - done)
        held = _gather(pool, rest, held, A, y, done + passed, rows, active, width)
        _pass_on(A, y, done, passed, rows, active)
    reduce_columns(pool, rest, 0, held, 0, width, width)
    return pool[:width].copy(), rest[:width].copy(), chain, energy


@kernel
def _gather(
    pool: Array, rest: Array, held: int, A: Array, y: Array, begin: int, rows: int, active: int, width: int
) -> int:
    """Rows that speak of the border alone, into the pool, which is reduced when it is full; gives how many it holds."""
    for r in range(begin, rows):
        pool[held, : active - 12], rest[held] = A[r, 12:active], y[r]
        held += 1
    if held > width + _POOL:
        reduce_columns(pool, rest, 0, held, 0, active - 12, active - 12)
        for r in range(min(held, active - 12), held):
            pool[r], rest[r] = 0.0, 0.0
        held = min(held, active - 12)
    return held


@kernel
def _pass_on(A: Array, y: Array, done: int, passed: int, rows: int, active: int) -> None:
    """Rows that speak of the next pose, to the top and into its columns; all below is cleared."""
    for r in range(passed):
        y[r] = y[done + r]
        for j in range(6):
            A[r, j] = A[done + r, 6 + j]
            A[r, 6 + j] = 0.0
        A[r, 12:active] = A[done + r, 12:active]
    A[passed:rows], y[passed:rows] = 0.0, 0.0


@kernel
def _base_rows(A: Array, y: Array, r: int, own: int, base: Array, T: Array, drift: Vec3) -> int:
    """Gauge (x, y) and the prior on z, roll, pitch, yaw and drift."""
    W = base[9:].reshape(7, 7)
    e, H = earth_kernel(T, base[2:6], np.eye(4))
    error = np.empty(7)
    error[:4], error[4:] = e, drift - base[6:9]
    for i in range(2):
        y[r + i] = base[i] - T[i, 3]
        A[r + i, own + 3 : own + 6] = T[i, :3]
    r += 2
    for i in range(7):
        for k in range(7):
            y[r + i] -= W[i, k] * error[k]
        for j in range(6):
            for k in range(4):
                A[r + i, own + j] += W[i, k] * H[k, j]
        for j in range(3):
            A[r + i, 12 + j] = W[i, 4 + j]
    return r + 7


@kernel
def _earth_rows(A: Array, y: Array, r: int, own: int, motion: Array, T: Array) -> int:
    W = motion[53:69].reshape(4, 4)
    if not W.any():
        return r
    e, H = earth_kernel(T, motion[49:53], W)
    for i in range(4):
        y[r + i] = -e[i]
        A[r + i, own : own + 6] = H[i]
    return r + 4


@kernel
def _link_rows(
    A: Array, y: Array, r: int, own: int, after: int, motion: Array, T: Array, T_next: Array, drift: Vec3
) -> int:
    R_inc, W = motion[3:12].reshape(3, 3), motion[13:49].reshape(6, 6)
    e, H1, H2, Hb = link_kernel(T, T_next, drift, motion[:3], R_inc, motion[12], W)
    for i in range(6):
        y[r + i] = -e[i]
        A[r + i, own : own + 6] = H1[i]
        A[r + i, after : after + 6] = H2[i]
        A[r + i, 12:15] = Hb[i]
    return r + 6


@kernel
def _first_rows(A: Array, y: Array, r: int, by_q: int, z: Array, q: Vec3, weak: float, weight: float) -> int:
    """The anchor's own detection, exact in the feature's coordinates, with a loose bound on theta."""
    for i in range(2):
        y[r + i] = (z[i] - q[i]) / z[2 + i]
        A[r + i, by_q + i] = 1.0 / z[2 + i]
    y[r + 2] = -u_from_theta(q[2], z[4], z[5])
    A[r + 2, by_q + 2] = z[4] + 3.0 * z[5] * q[2] ** 2
    y[r + 3] = -q[2] / weak
    A[r + 3, by_q + 2] = 1.0 / weak
    A[r + 4, by_q + 2] = np.sqrt(weight)
    return r + 5


@kernel
def _look_rows(
    A: Array, y: Array, r: int, own: int, anchor: int, by_q: int, look: Array, T_anchor: Array, T: Array, q: Vec3
) -> int:
    z = look[32:]
    s, H_a, H_j, H_f = anchored_observation(T_anchor, T, look[:16].reshape(4, 4), look[16:32].reshape(4, 4), q)
    for i in range(3):
        scale = 1.0 / z[2 + i] if i < 2 else z[4] + 3.0 * z[5] * s[2] ** 2
        y[r + i] = (z[i] - s[i]) * scale if i < 2 else -u_from_theta(s[2], z[4], z[5])
        for j in range(6):  # the anchor may be the pose itself
            A[r + i, anchor + j] += scale * H_a[i, j]
            A[r + i, own + j] += scale * H_j[i, j]
        for j in range(3):
            A[r + i, by_q + j] = scale * H_f[i, j]
    return r + 3


@kernel
def back_substitute(corner: Array, right: Array, chain: Array, column: Whole) -> tuple[Array, Array]:
    """The step: of the border (width), and of all poses (n, 6) in their tangents."""
    n, width = chain.shape[0], corner.shape[0]
    border, poses = right.copy(), np.zeros((n, 6))
    for i in range(width - 1, -1, -1):
        for j in range(i + 1, width):
            border[i] -= corner[i, j] * border[j]
        border[i] /= corner[i, i]
    for k in range(n - 1, -1, -1):
        if column[k] >= 0:
            poses[k] = border[column[k] : column[k] + 6]
            continue
        for i in range(5, -1, -1):
            x = chain[k, i, 12 + width]
            for j in range(width):
                x -= chain[k, i, 12 + j] * border[j]
            if k + 1 < n and column[k + 1] < 0:
                for j in range(6):
                    x -= chain[k, i, 6 + j] * poses[k + 1, j]
            for j in range(i + 1, 6):
                x -= chain[k, i, j] * poses[k, j]
            poses[k, i] = x / chain[k, i, i]
    return border, poses


@kernel
def moved_poses(T: Array, steps: Array) -> Array:
    """Poses (n, 4, 4) after steps (n, 6): rotation vector, then translation, both in the body frame."""
    out = T.copy()
    for k in range(T.shape[0]):
        R = T[k, :3, :3].copy()
        out[k, :3, 3] += R @ steps[k, 3:].copy()
        out[k, :3, :3] = R @ so3_exp(steps[k, :3].copy())
    return out


@kernel
def missing_curvatures(looks: Array, at: Whole, T: Array, q: Array) -> Array:
    """What Gauss-Newton leaves out of the second derivative of the energy by each theta (m); 0 where negative.

    Poses fixed.  Residuals bend the energy as much as slopes do: ``u`` is cubic in theta, ranges are even in it.
    """
    step = 0.01
    E, p, e = np.zeros(q.shape[0]), np.empty(3), np.empty((3, 3))
    for d in range(at.shape[0]):
        f, z = at[d, 2], looks[d, 32:]
        for i in range(3):
            p[:] = q[f]
            p[2] += (i - 1) * step
            s = p if at[d, 3] else _seen(looks[d], T[at[d, 1]], T[at[d, 0]], p)
            e[i, 0], e[i, 1] = (s[0] - z[0]) / z[2], (s[1] - z[1]) / z[3]
            e[i, 2] = u_from_theta(s[2], z[4], z[5])
        for i in range(3):
            E[f] += 0.5 * (e[0, i] ** 2 - 2.0 * e[1, i] ** 2 + e[2, i] ** 2) / step**2
            E[f] -= (0.5 * (e[2, i] - e[0, i]) / step) ** 2
    return np.maximum(E, 0.0)


@kernel
def _seen(look: Array, T_anchor: Array, T: Array, q: Vec3) -> Vec3:
    """r, phi, theta alone, of an anchored feature from another pose."""
    c = np.array([q[0] * np.sin(q[1]) * np.cos(q[2]), q[0] * np.sin(q[1]) * np.sin(q[2]), q[0] * np.cos(q[1])])
    s = brought(look[16:32].reshape(4, 4), brought(T, carried(T_anchor, carried(look[:16].reshape(4, 4), c))))
    rho2 = s[0] ** 2 + s[1] ** 2
    return np.array([np.sqrt(rho2 + s[2] ** 2), np.arctan2(np.sqrt(rho2), s[2]), np.arctan2(s[1], s[0])])
