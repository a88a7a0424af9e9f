"""One Gauss-Newton step of a window: linearise and eliminate pose by pose with Householder reflections; all compiled.

The whitened Jacobian is brought to its square root ``R`` by orthogonal transformations alone (square-root smoothing:
Dellaert and Kaess, 2006); no information matrix is formed.  Poses go in the order of time, so that each reflection
touches one pose, the next one, and the border: drift, features, their anchors, and whatever else is kept.  The
border's own triangle stands in the last corner of ``R`` and is the square root of their joint information.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import so3_exp
from fbn_common.types import Array, Vec3
from fbn_tracking.factors import earth_kernel, link_kernel
from fbn_tracking.geometry import bring_into, carry_into, observe_anchored_into, u_from_theta

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

    In place on ``A`` (rows, width) and the right side ``y``.  Rows without a share in a column are passed over.  The
    products of a column with all that follow are gathered while the reflection before it passes over the rows.
    """
    _reduce(A, y, top, rows, first, count, width, np.zeros(width), np.zeros(width))


@inner_kernel
def _reduce(
    A: Array, y: Array, top: int, rows: int, first: int, count: int, width: int, sums: Array, ahead: Array
) -> None:
    right, known = 0.0, False
    for i in range(count):
        p, c = top + i, first + i
        if p >= rows:
            return
        if not known:
            right = _products(A, y, p, rows, c, sums[c:width])
        known = sums[c] != 0.0  # true for NaN too, which has to come out
        if not known:
            continue
        length = np.sqrt(sums[c])
        alpha = -length if A[p, c] > 0.0 else length
        right -= alpha * y[p]  # of the reflection's own vector: the column with its pivot less alpha
        _add(sums[c:width], -alpha, A[p, c:width])
        beta = -1.0 / (alpha * (A[p, c] - alpha))
        v = beta * (A[p, c] - alpha)
        y[p] -= v * right
        _add(A[p, c + 1 : width], -v, sums[c + 1 : width])
        A[p, c] = alpha
        right = _reflect(A, y, p + 1, rows, c, beta, right, sums[c + 1 : width], ahead[c + 1 : width])
        sums, ahead = ahead, sums


@inner_kernel
def _products(A: Array, y: Array, begin: int, rows: int, c: int, sums: Array) -> float:
    """Column ``c``, from row ``begin`` on, times itself and the columns after it (``sums``), and times ``y``."""
    right = 0.0
    sums[:] = 0.0
    for r in range(begin, rows):
        if A[r, c] != 0.0:
            right += A[r, c] * y[r]
            _add(sums, A[r, c], A[r, c : c + sums.shape[0]])
    return right


@inner_kernel
def _reflect(
    A: Array, y: Array, begin: int, rows: int, c: int, beta: float, right: float, sums: Array, ahead: Array
) -> float:
    """Reflect the rows from ``begin`` on; gives the next column's products as :func:`_products` would."""
    n, next_right = sums.shape[0], 0.0
    ahead[:] = 0.0
    for r in range(begin, rows):
        v, row = beta * A[r, c], A[r, c + 1 : c + 1 + n]
        if v != 0.0:
            y[r] -= v * right
            A[r, c] = 0.0
        if n == 0:
            continue
        u = row[0] - v * sums[0]
        if u != 0.0:
            next_right += u * y[r]
        if v != 0.0 and u != 0.0:
            for j in range(n):
                row[j] -= v * sums[j]
                ahead[j] += u * row[j]
        elif v != 0.0:
            _add(row, -v, sums)
        elif u != 0.0:
            _add(ahead, u, row)
    return next_right


@inner_kernel
def _add(to: Array, factor: float, row: Array) -> None:
    for j in range(to.shape[0]):
        to[j] += factor * row[j]


@kernel
def eliminate(
    base: Array, motion: Array, looks: Array, at: Whole, starts: Whole, weak: float,
    T: Array, drift: Vec3, q: Array, column: Whole, feature_column: Whole, top: Whole, width: int,
) -> tuple[Array, Array, Array, float]:  # fmt: skip
    """Border's triangle (width, width), its right side, the poses' rows (n, 6, 13 + width), half the sum of squares.

    ``at`` (d, 4): rows of pose, anchor and feature, and whether it is the anchor's own detection, sorted by pose;
    ``starts`` (n + 1) of each pose's.  ``column`` (n) of the poses in the border, -1 of the others; ``top`` (n):
    columns in use once a pose has come.
    """
    n, most = T.shape[0], _most_rows(starts)
    A, y = np.zeros((most, 12 + width)), np.zeros(most)
    pool, rest = np.zeros((width + _POOL + most, width)), np.zeros(width + _POOL + most)
    chain = np.zeros((n, 6, 13 + width))
    held, passed, energy = 0, 0, 0.0
    for k in range(n):
        inner, inner_next = column[k] < 0, k + 1 < n and column[k + 1] < 0
        own = 0 if inner else 12 + column[k]
        after = 6 if inner_next or k + 1 == n else 12 + column[k + 1]
        rows = _rows_of_pose(
            A, y, passed, k, own, after, base, motion, looks, at, starts, weak, T, drift, q, column, feature_column
        )
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
def _most_rows(starts: Whole) -> int:
    """An upper bound on the rows of one pose with those passed on to it."""
    most = 0
    for k in range(len(starts) - 1):
        most = max(most, starts[k + 1] - starts[k])
    return 25 + 4 * most


@kernel
def _rows_of_pose(
    A: Array, y: Array, r: int, k: int, own: int, after: int,
    base: Array, motion: Array, looks: Array, at: Whole, starts: Whole, weak: float,
    T: Array, drift: Vec3, q: Array, column: Whole, feature_column: Whole,
) -> int:  # fmt: skip
    """Whitened rows of all that pose ``k`` measures and of the link to the next, from row ``r`` on; gives their end.

    ``own``, ``after``: columns of this pose and the next.
    """
    if k == 0:
        r = _base_rows(A, y, r, own, base, T[0], drift)
    r = _earth_rows(A, y, r, own, motion[k], T[k])
    z, by, room = np.empty(3), np.empty((3, 3, 6)), np.empty((6, 3, 3))
    for d in range(starts[k], starts[k + 1]):
        f, anchor = at[d, 2], at[d, 1]
        by_q = 12 + feature_column[f]
        if at[d, 3]:
            r = _first_rows(A, y, r, by_q, looks[d, 32:], q[f], weak)
        else:
            r = _look_rows(A, y, r, own, 12 + column[anchor], by_q, looks[d], T[anchor], T[k], q[f], z, by, room)
    if k + 1 < len(T):
        r = _link_rows(A, y, r, own, after, motion[k + 1], T[k], T[k + 1], drift)
    return r


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
def _first_rows(A: Array, y: Array, r: int, by_q: int, z: Array, q: Vec3, weak: float) -> int:
    """The anchor's own detection, exact in the feature's coordinates, with a loose bound on theta."""
    for i in range(2):
        y[r + i] = (z[i] - q[i]) / z[2 + i]
        A[r + i, by_q + i] = 1.0 / z[2 + i]
    y[r + 2] = -u_from_theta(q[2], z[4], z[5])
    A[r + 2, by_q + 2] = z[4] + 3.0 * z[5] * q[2] ** 2
    y[r + 3] = -q[2] / weak
    A[r + 3, by_q + 2] = 1.0 / weak
    return r + 4


@inner_kernel
def _look_rows(
    A: Array, y: Array, r: int, own: int, anchor: int, by_q: int, look: Array, T_anchor: Array, T: Array, q: Vec3,
    s: Vec3, by: Array, room: Array,
) -> int:  # fmt: skip
    """``s`` (3), ``by`` (3, 3, 6) and ``room`` (6, 3, 3) are written over."""
    z, H_a, H_j, H_f = look[32:], by[0], by[1], by[2]
    mount_anchor, mount = look[:16].reshape(4, 4), look[16:32].reshape(4, 4)
    observe_anchored_into(T_anchor, T, mount_anchor, mount, q, s, H_a, H_j, H_f, room)
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
def strengthened(corner: Array, right: Array, column: Whole, weights: Array) -> tuple[Array, Array]:
    """The border's triangle and right side with information ``weights`` (m) added along columns (m), at no residual."""
    width, held = corner.shape[0], corner.shape[0]
    A, y = np.zeros((width + len(weights), width)), np.zeros(width + len(weights))
    A[:width], y[:width] = corner, right
    first = width
    for f in range(len(weights)):
        if weights[f] > 0.0:
            A[held, column[f]] = np.sqrt(weights[f])
            held, first = held + 1, min(first, column[f])
    reduce_columns(A, y, first, held, first, width - first, width)
    return A[:width].copy(), y[:width].copy()


@kernel
def energy_of(
    base: Array, motion: Array, looks: Array, at: Whole, starts: Whole, weak: float, T: Array, drift: Vec3, q: Array
) -> float:
    """Half the sum of squares of what :func:`eliminate` would linearise here, at a fraction of its cost."""
    A, y = np.zeros((_most_rows(starts), 18)), np.zeros(_most_rows(starts))
    nowhere, total = np.zeros(max(len(T), len(q)), np.int64), 0.0  # columns, whose slopes nobody reads
    for k in range(len(T)):
        y[:] = 0.0
        rows = _rows_of_pose(A, y, 0, k, 0, 0, base, motion, looks, at, starts, weak, T, drift, q, nowhere, nowhere)
        for r in range(rows):
            total += 0.5 * y[r] * y[r]
    return total


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
    E, p, s, e = np.zeros(q.shape[0]), np.empty(3), np.empty(3), np.empty((3, 3))
    for d in range(at.shape[0]):
        f, z = at[d, 2], looks[d, 32:]
        for i in range(3):
            p[:] = q[f]
            p[2] += (i - 1) * step
            s[:] = p
            if not at[d, 3]:
                _see(looks[d], T[at[d, 1]], T[at[d, 0]], s)
            e[i, 0], e[i, 1] = (s[0] - z[0]) / z[2], (s[1] - z[1]) / z[3]
            e[i, 2] = u_from_theta(s[2], z[4], z[5])
        for i in range(3):
            E[f] += 0.5 * (e[0, i] ** 2 - 2.0 * e[1, i] ** 2 + e[2, i] ** 2) / step**2
            E[f] -= (0.5 * (e[2, i] - e[0, i]) / step) ** 2
    return np.maximum(E, 0.0)


@inner_kernel
def _see(look: Array, T_anchor: Array, T: Array, s: Vec3) -> None:
    """An anchored feature's r, phi, theta become those from another pose."""
    r, sp, cp, st, ct = s[0], np.sin(s[1]), np.cos(s[1]), np.sin(s[2]), np.cos(s[2])
    s[0], s[1], s[2] = r * sp * ct, r * sp * st, r * cp
    carry_into(look[:16].reshape(4, 4), s, s)
    carry_into(T_anchor, s, s)
    bring_into(T, s, s)
    bring_into(look[16:32].reshape(4, 4), s, s)
    x, y, along = s[0], s[1], s[2]
    rho2 = x**2 + y**2
    s[0], s[1], s[2] = np.sqrt(rho2 + along**2), np.arctan2(np.sqrt(rho2), along), np.arctan2(y, x)
