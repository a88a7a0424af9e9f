"""Joint compatibility branch and bound as a textbook has it, in numpy: what the compiled one is held against."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fbn_common.types import Array
from fbn_global.jcbb import chi_square_99

Bools = npt.NDArray[np.bool_]


class PlainJcbb:
    """One search; the joint distance of every node is solved from nothing."""

    def __init__(self, x: Array, p: Array, found: int, allowed: Bools, noise: Array, dims: int) -> None:
        self.x, self.p, self.found, self.allowed, self.noise, self.dims = x, p, found, allowed, noise, dims
        self.best: list[int] = [-1] * found
        self.count, self.distance, self.nodes = 0, 0.0, 0

    def search(self, chosen: list[int], count: int, distance: float) -> None:
        """All ways to go on from here that may still be better than the best so far."""
        level = len(chosen)
        if level == self.found:
            if count > self.count or (count == self.count and distance < self.distance):
                self.best, self.count, self.distance = list(chosen), count, distance
            return
        left = self.found - level - 1
        for j in np.flatnonzero(self.allowed[level]):
            if int(j) not in chosen:
                self.nodes += 1
                d2 = self.joint_distance([*chosen, int(j)])
                if d2 < chi_square_99(self.dims * (count + 1)) and self._hopeful(count + 1 + left, d2):
                    self.search([*chosen, int(j)], count + 1, d2)
        if self._hopeful(count + left, distance):
            self.search([*chosen, -1], count, distance)

    def _hopeful(self, most: int, distance: float) -> bool:
        return most > self.count or (most == self.count and distance < self.distance)

    def joint_distance(self, chosen: list[int]) -> float:
        """``d' S^-1 d`` of these pairs, ``S = C + J P J'``."""
        pairs = [(i, j) for i, j in enumerate(chosen) if j >= 0]
        axes = np.arange(self.dims)
        one = np.concatenate([self.dims * i + axes for i, _ in pairs])
        other = np.concatenate([self.dims * (self.found + j) + axes for _, j in pairs])
        cross = self.p[np.ix_(one, other)]
        s = self.p[np.ix_(one, one)] + self.p[np.ix_(other, other)] - cross - cross.T
        s += np.kron(np.eye(len(pairs)), self.noise)
        r = self.x[one] - self.x[other]
        return float(r @ np.linalg.solve(s, r))


def crossing(seed: int, found: int, maps: int, sigma: float) -> tuple[Array, Array, Bools]:
    """Found features upon map features at 1 in 100 m^2, their common error drawn with this sigma; joint and gate."""
    rng = np.random.default_rng(seed)
    side = 10.0 * np.sqrt(maps)
    places = rng.uniform(-side / 2, side / 2, (maps, 2))
    nearest = np.argsort((places**2).sum(axis=1))[:found]
    seen = places[nearest] + sigma * rng.standard_normal(2) + 0.3 * rng.standard_normal((found, 2))
    n = 2 * (found + maps)
    p = np.zeros((n, n))
    p[: 2 * found, : 2 * found] = np.kron(np.ones((found, found)), sigma**2 * np.eye(2)) + 0.09 * np.eye(2 * found)
    p[2 * found :, 2 * found :] = 0.25 * np.eye(2 * maps)
    away = ((seen[:, None] - places[None]) ** 2).sum(axis=2)
    gate = away / (sigma**2 + 0.09 + 0.25 + 0.25) < chi_square_99(2)
    return np.concatenate([seen.ravel(), places.ravel()]), p, gate
