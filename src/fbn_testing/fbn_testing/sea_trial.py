"""Ranges of a sea trial (GOATS 2002, as gtsam carries it), and the whole trajectory fitted to them at once.

The files hold odometry as chained poses, beacons and ranges, no times and no truth.  In its place stands a computation
that shares nothing with the filters: robust least squares of all poses on all ranges.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from fbn_common.types import Array

DATA = Path(gtsam.__file__).parent / "Data"
WALK = 0.05  # m a root metre: odometry's random walk, of the size that the fit leaves over
RANGE_SIGMA = 0.75  # m, as the files state it


@dataclass(frozen=True)
class Trial:
    """Chained poses (n, 3) x, y, heading; beacons; ranges as (pose, beacon, metres)."""

    poses: Array
    beacons: dict[str, Array]
    ranges: list[tuple[int, str, float]]


def read(name: str) -> Trial:
    """The trial of that name, ``goats_15`` or ``goats_16``."""
    poses: list[list[float]] = []
    beacons: dict[str, Array] = {}
    ranges: list[tuple[int, str, float]] = []
    for line in (DATA / f"{name}.pyfg").read_text().splitlines():
        kind, *words = line.split()
        if kind == "VERTEX_SE2":
            poses.append([float(w) for w in words[2:5]])
        elif kind == "VERTEX_XY":
            beacons[words[0]] = np.array([float(w) for w in words[1:3]])
        elif kind == "EDGE_RANGE":
            ranges.append((int(words[1][1:]), words[2], float(words[3])))
    return Trial(np.array(poses), beacons, ranges)


@dataclass(frozen=True)
class Fit:
    """The whole trajectory by robust least squares: positions (n, 2), turn of the chain (n,), ranges less distances."""

    position: Array
    turn: Array
    residual: Array


def fit(trial: Trial) -> Fit:
    """First the chain as a rigid body, from many starts; then every pose, the chain's heading drifting."""
    chain, n = trial.poses[:, :2], len(trial.poses)
    at = np.array([k for k, _, _ in trial.ranges])
    beacon = np.array([trial.beacons[b] for _, b, _ in trial.ranges])
    measured = np.array([z for _, _, z in trial.ranges])
    steps = np.diff(chain, axis=0)
    length = np.maximum(np.hypot(*steps.T), 0.3)

    def turned(xy: Array, angle: Array) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]], axis=1)

    def misfit(position: Array) -> Array:
        return np.asarray(measured - np.hypot(*(position[at] - beacon).T))

    def rigid(p: Array) -> Array:
        return misfit(turned(chain, np.full(n, p[2])) + p[:2])

    grid = [(x, y, a) for x in (200.0, 600.0, 1000.0) for y in (-100.0, 200.0, 500.0) for a in (0.0, 1.6, 3.1, 4.7)]
    first = min((least_squares(rigid, g, loss="cauchy", f_scale=3.0) for g in grid), key=lambda s: s.cost).x

    def whole(p: Array) -> Array:
        position, turn = p[: 2 * n].reshape(n, 2), p[2 * n :]
        odometry = (np.diff(position, axis=0) - turned(steps, turn[:-1])) / (WALK * np.sqrt(length) + 0.02)[:, None]
        heading = np.diff(turn) / (0.01 * np.sqrt(length) + 0.002)
        scaled = misfit(position) / RANGE_SIGMA
        robust = np.sign(scaled) * 2.0 * np.sqrt(np.log1p((scaled / 2.0) ** 2))  # Cauchy
        return np.concatenate([odometry.ravel(), heading, robust])

    start = np.concatenate([(turned(chain, np.full(n, first[2])) + first[:2]).ravel(), np.full(n, first[2])])
    pattern = lil_matrix((len(whole(start)), 3 * n), dtype=int)
    for i in range(n - 1):
        for axis in (0, 1):
            pattern[2 * i + axis, [2 * i + axis, 2 * i + 2 + axis, 2 * n + i]] = 1
        pattern[2 * (n - 1) + i, [2 * n + i, 2 * n + i + 1]] = 1
    for row, k in enumerate(at):
        pattern[3 * (n - 1) + row, [2 * k, 2 * k + 1]] = 1
    best = least_squares(whole, start, jac_sparsity=pattern, x_scale="jac", max_nfev=100).x
    position = best[: 2 * n].reshape(n, 2)
    return Fit(position, best[2 * n :], misfit(position))
