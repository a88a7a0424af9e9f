"""Joint compatibility branch and bound (Neira and Tardos): the most pairs that are jointly compatible, the nearest.

A set of pairs is compatible while its joint Mahalanobis distance ``d' S^-1 d`` (``S = C + J P J'``) stays below the
99 % point of chi-square.  The distance of a growing set is kept by extending one Cholesky factor row by row, so that
a node costs the square of its depth and not a solve.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common import chi_square
from fbn_common.kernels import kernel
from fbn_common.types import Array

Ints = npt.NDArray[np.int64]


class Joint(NamedTuple):
    """The best set: for each found feature the map's index or -1; its distance; nodes visited; all searched."""

    assigned: tuple[int, ...]
    distance: float
    nodes: int
    complete: bool


@cache
def chi_square_99(dof: int) -> float:
    """The 99 % point of chi-square."""
    return float(chi_square.bound(0.99, dof))


def jcbb(
    x: Array, p: Array, found: int, allowed: npt.NDArray[np.bool_], noise: Array, dims: int, most_nodes: int
) -> Joint:
    """The largest jointly compatible set, and of the largest the nearest.

    ``x`` (d n,), ``p`` (d n, d n): joint of found features, then the map's, each of ``dims`` coordinates.
    """
    limits = np.array([0.0] + [chi_square_99(dims * (k + 1)) for k in range(found)])
    assigned = np.full(found, -1, dtype=np.int64)
    distance, nodes, complete = jcbb_kernel(x, p, found, allowed, noise, dims, limits, most_nodes, assigned)
    return Joint(tuple(int(a) for a in assigned), float(distance), int(nodes), bool(complete))


@kernel
def jcbb_kernel(
    x: Array,
    p: Array,
    found: int,
    allowed: npt.NDArray[np.bool_],
    noise: Array,
    dims: int,
    limits: Array,
    most_nodes: int,
    best: Ints,
) -> tuple[float, int, bool]:
    """Depth-first search as a loop; fills ``best`` (found,) and gives distance, nodes, whether complete."""
    maps = allowed.shape[1]
    lower = np.zeros((found * dims, found * dims))
    solved = np.zeros(found * dims)
    choice = np.full(found + 1, -2, dtype=np.int64)  # per level: -2 untried, j a map feature, maps = none
    rows_i, rows_j = np.zeros(found, dtype=np.int64), np.zeros(found, dtype=np.int64)
    depth = np.zeros(found + 1, dtype=np.int64)  # pairs made above this level
    distance = np.zeros(found + 1)
    taken = np.zeros(maps, dtype=np.bool_)
    best_count, best_distance, nodes, level = 0, 0.0, 0, 0
    while level >= 0:
        if level == found:
            if depth[level] > best_count or (depth[level] == best_count and distance[level] < best_distance):
                best_count, best_distance = depth[level], distance[level]
                for i in range(found):
                    best[i] = choice[i] if choice[i] < maps else -1
            level -= 1
            continue
        previous = choice[level]
        if 0 <= previous < maps:
            taken[previous] = False
        if previous == maps or nodes >= most_nodes:
            choice[level] = -2
            level -= 1
            continue
        step = 0 if previous == -2 else previous + 1
        k = depth[level]
        while step < maps:
            if allowed[level, step] and not taken[step]:
                nodes += 1
                rows_i[k], rows_j[k] = level, found + step
                d2 = extend(x, p, rows_i, rows_j, k, noise, dims, lower, solved, distance[level])
                bound = k + 1 + found - level - 1
                hopeful = bound > best_count or (bound == best_count and d2 < best_distance)
                if d2 < limits[k + 1] and hopeful:
                    break
            step += 1
        choice[level] = step
        if step < maps:
            taken[step] = True
            depth[level + 1], distance[level + 1] = k + 1, d2
            level += 1
            if level < found:
                choice[level] = -2
        else:
            left = k + found - level - 1
            if left > best_count or (left == best_count and distance[level] < best_distance):
                depth[level + 1], distance[level + 1] = k, distance[level]
                level += 1
                if level < found:
                    choice[level] = -2
    return best_distance, nodes, nodes < most_nodes


@kernel
def extend(
    x: Array,
    p: Array,
    rows_i: Ints,
    rows_j: Ints,
    k: int,
    noise: Array,
    dims: int,
    lower: Array,
    solved: Array,
    so_far: float,
) -> float:
    """Adds the k-th pair's rows to the Cholesky factor; gives the squared joint distance of pairs 0..k."""
    i, j = rows_i[k], rows_j[k]
    distance = so_far
    for a in range(dims):
        row = k * dims + a
        value = x[dims * i + a] - x[dims * j + a]
        for column in range(row + 1):
            m, b = column // dims, column % dims
            oi, oj = rows_i[m], rows_j[m]
            s = (
                p[dims * i + a, dims * oi + b]
                + p[dims * j + a, dims * oj + b]
                - p[dims * i + a, dims * oj + b]
                - p[dims * j + a, dims * oi + b]
            )
            if m == k:
                s += noise[a, b]
            for q in range(column):
                s -= lower[row, q] * lower[column, q]
            if column < row:
                lower[row, column] = s / lower[column, column]
                value -= lower[row, column] * solved[column]
            else:
                lower[row, row] = np.sqrt(max(s, 1e-12))
        solved[row] = value / lower[row, row]
        distance += solved[row] ** 2
    return distance
