"""Which found features are which features of the map: seeds by local patches, sets grown by likelihood.

``matchdata_ij = (r_ij, c_ij, a_ij)`` of two features is their distance, its variance and its direction (a compass is
on board).  Features whose distance is well known form a local patch: an anchor pair (found i, map j) is supported by
every other pair whose members lie the same way from i and from j.  From each anchor a set of pairs is grown: the
pair that raises the likelihood most, the joint Gaussian conditioned on it, and so on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common.kernels import kernel
from fbn_common.types import Array, Mat3
from fbn_global.jcbb import chi_square_99

Pairs = tuple[tuple[int, int], ...]
_LOG_2PI = float(np.log(2.0 * np.pi))


class Grown(NamedTuple):
    """A set of pairs (index of found, index of map), in the order found, and its log likelihood ratio."""

    pairs: Pairs
    log_ratio: float


@kernel
def inverse3(m: Mat3, out: Mat3) -> float:
    """Writes the inverse of a symmetric 3 x 3 matrix; gives its determinant."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    co0, co1, co2 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * co0 + b * co1 + c * co2
    out[0, 0], out[0, 1], out[0, 2] = co0 / det, co1 / det, co2 / det
    out[1, 0], out[1, 1], out[1, 2] = co1 / det, (a * f - c * c) / det, (b * c - a * e) / det
    out[2, 0], out[2, 1], out[2, 2] = co2 / det, (b * c - a * e) / det, (a * d - b * b) / det
    return float(det)


@kernel
def difference_covariance(p: Array, i: int, j: int, noise: Mat3, out: Mat3) -> None:
    """Writes the covariance of point i less point j of a joint (3 n, 3 n), plus noise."""
    for a in range(3):
        for b in range(3):
            out[a, b] = (
                p[3 * i + a, 3 * i + b]
                + p[3 * j + a, 3 * j + b]
                - p[3 * i + a, 3 * j + b]
                - p[3 * j + a, 3 * i + b]
                + noise[a, b]
            )


@kernel
def pair_fit(x: Array, p: Array, i: int, j: int, noise: Mat3, s: Mat3, inverse: Mat3) -> tuple[float, float]:
    """Squared Mahalanobis distance of points i and j of a joint Gaussian, and the log density of their difference."""
    difference_covariance(p, i, j, noise, s)
    det = inverse3(s, inverse)
    d2 = 0.0
    for a in range(3):
        for b in range(3):
            d2 += (x[3 * i + a] - x[3 * j + a]) * inverse[a, b] * (x[3 * i + b] - x[3 * j + b])
    return d2, -0.5 * (d2 + np.log(det) + 3.0 * 1.8378770664093453)


@kernel
def equate_points(x: Array, p: Array, i: int, j: int, inverse: Mat3) -> None:
    """Conditions the joint Gaussian, in place, on points i and j being one, by the inverse of their covariance."""
    n = x.shape[0]
    cross, gain = np.empty((n, 3)), np.empty((n, 3))
    r = np.empty(3)
    for a in range(3):
        r[a] = x[3 * j + a] - x[3 * i + a]
    for k in range(n):
        for a in range(3):
            cross[k, a] = p[k, 3 * i + a] - p[k, 3 * j + a]
    for k in range(n):
        for a in range(3):
            gain[k, a] = cross[k, 0] * inverse[0, a] + cross[k, 1] * inverse[1, a] + cross[k, 2] * inverse[2, a]
        x[k] += gain[k, 0] * r[0] + gain[k, 1] * r[1] + gain[k, 2] * r[2]
    for k in range(n):
        for m in range(k + 1):
            p[k, m] -= gain[k, 0] * cross[m, 0] + gain[k, 1] * cross[m, 1] + gain[k, 2] * cross[m, 2]
            p[m, k] = p[k, m]


@kernel
def grow_kernel(
    x: Array,
    p: Array,
    found: int,
    allowed: npt.NDArray[np.bool_],
    together: npt.NDArray[np.bool_],
    bonus: Array,
    surplus: Array,
    noise: Mat3,
    gate: float,
    anchor_i: int,
    anchor_j: int,
    pairs: npt.NDArray[np.int64],
) -> tuple[int, float]:
    """Grows a set of pairs in place of ``pairs`` (found, 2); gives their number and log ratio.

    ``x``, ``p``: joint of ``found`` found and then the map's features, overwritten.  ``allowed`` (found, map);
    ``together`` (found, found): seen at one time, so not one object.  ``bonus`` (map,): log of a feature's prior.
    ``surplus`` (found,): what the k-th pair gains by leaving one object fewer unexplained.  An anchor of -1: none.
    """
    maps = allowed.shape[1]
    free = allowed.copy()
    s, inverse = np.empty((3, 3)), np.empty((3, 3))
    total, count = 0.0, 0
    while count < found:
        best, best_i, best_j = 0.0, -1, -1
        if count == 0 and anchor_i >= 0:
            d2, density = pair_fit(x, p, anchor_i, found + anchor_j, noise, s, inverse)
            best, best_i, best_j = density + bonus[anchor_j] + surplus[0], anchor_i, anchor_j
        else:
            for i in range(found):
                for j in range(maps):
                    if free[i, j]:
                        d2, density = pair_fit(x, p, i, found + j, noise, s, inverse)
                        gain = density + bonus[j] + surplus[count]
                        if d2 < gate and gain > best:
                            best, best_i, best_j = gain, i, j
        if best_i < 0:
            break
        pair_fit(x, p, best_i, found + best_j, noise, s, inverse)
        equate_points(x, p, best_i, found + best_j, inverse)
        pairs[count, 0], pairs[count, 1] = best_i, best_j
        total += best
        count += 1
        free[best_i, :] = False
        for i in range(found):
            if together[i, best_i]:
                free[i, best_j] = False
    return count, total


@kernel
def support_kernel(
    x: Array, p: Array, found: int, allowed: npt.NDArray[np.bool_], noise: Mat3, tight: float, gate: float
) -> npt.NDArray[np.int64]:
    """Support (found, map) of every allowed pair: other pairs that lie the same way from it, within its local patch."""
    maps = allowed.shape[1]
    votes = np.zeros((found, maps), dtype=np.int64)
    patch = np.zeros((found, found), dtype=np.bool_)
    s = np.empty((3, 3))
    zero = np.zeros((3, 3))
    for i in range(found):
        for k in range(found):
            difference_covariance(p, i, k, zero, s)
            patch[i, k] = i != k and s[0, 0] + s[1, 1] < tight
    for i in range(found):
        for j in range(maps):
            if not allowed[i, j]:
                continue
            for k in range(found):
                if not patch[i, k]:
                    continue
                for m in range(maps):
                    if m != j and allowed[k, m] and same_way(x, p, i, found + j, k, found + m, noise, gate):
                        votes[i, j] += 1
                        break
    return votes


@kernel
def same_way(x: Array, p: Array, i: int, j: int, k: int, m: int, noise: Mat3, gate: float) -> bool:
    """Whether k lies from i, in distance and direction, as m does from j, within the gate (horizontal)."""
    dx = (x[3 * k] - x[3 * i]) - (x[3 * m] - x[3 * j])
    dy = (x[3 * k + 1] - x[3 * i + 1]) - (x[3 * m + 1] - x[3 * j + 1])
    vx, vy = 2.0 * noise[0, 0], 2.0 * noise[1, 1]
    for a, b in ((i, k), (j, m)):
        vx += p[3 * a, 3 * a] + p[3 * b, 3 * b] - 2.0 * p[3 * a, 3 * b]
        vy += p[3 * a + 1, 3 * a + 1] + p[3 * b + 1, 3 * b + 1] - 2.0 * p[3 * a + 1, 3 * b + 1]
    return bool(dx * dx / vx + dy * dy / vy < gate)


class Problem(NamedTuple):
    """Found features and the map's, jointly Gaussian, and what each pair is worth; see :func:`grow_kernel`."""

    x: Array  # (3 (found + map),)
    p: Array
    found: int
    allowed: npt.NDArray[np.bool_]  # (found, map)
    together: npt.NDArray[np.bool_]  # (found, found)
    bonus: Array  # (map,)
    surplus: Array  # (found,)
    noise: Mat3
    gate: float

    def grow(self, anchor: tuple[int, int] = (-1, -1)) -> Grown:
        """The set of pairs that grows from an anchor, or from the best pair there is."""
        pairs = np.zeros((self.found, 2), dtype=np.int64)
        count, ratio = grow_kernel(
            self.x.copy(), self.p.copy(), self.found, self.allowed, self.together, self.bonus, self.surplus,
            self.noise, self.gate, *anchor, pairs,
        )  # fmt: skip
        return Grown(tuple((int(i), int(j)) for i, j in pairs[:count]), float(ratio))

    def anchors(self, tight_sigma: float, most: int) -> list[tuple[int, int]]:
        """Allowed pairs within the gate, the best supported first, at most so many."""
        near = self.allowed & (self.distances() < self.gate)
        votes = support_kernel(self.x, self.p, self.found, near, self.noise, 2.0 * tight_sigma**2, chi_square_99(2))
        i, j = np.nonzero(near)
        order = np.lexsort((j, i, -votes[i, j]))[:most]
        return [(int(i[k]), int(j[k])) for k in order]

    def distances(self) -> Array:
        """Squared Mahalanobis distance (found, map) of every pair."""
        return pair_distances(self.x, self.p, self.found, self.allowed.shape[1], self.noise)


@kernel
def pair_distances(x: Array, p: Array, found: int, maps: int, noise: Mat3) -> Array:
    """Squared Mahalanobis distance (found, map) of each found feature to each of the map."""
    out = np.empty((found, maps))
    s, inverse = np.empty((3, 3)), np.empty((3, 3))
    for i in range(found):
        for j in range(maps):
            out[i, j], _ = pair_fit(x, p, i, found + j, noise, s, inverse)
    return out
