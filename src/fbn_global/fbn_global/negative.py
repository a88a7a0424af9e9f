"""Negative information: the chance that nothing was promoted where a hypothesis says that something is.

A feature swept by ``N`` scans, each detecting it with probability ``v``, is missed with probability
``sum_{k<m} C(N, k) v^k (1 - v)^(N - k)``, ``m`` detections being needed for promotion (JOE 2013, eq. 24).  Where it
lies in the swept grid is uncertain: the chance is averaged over the Gaussian of its place relative to the sweep.  The
paper averages the scans instead and takes the chance of the mean, which is too sure when the edge of the sweep
passes through the ellipse: a feature that lies outside with probability one half is missed at least that often.

Consecutive composites that swept a feature make one *pass*; their scans add up, since promotion takes several.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fbn_common import chi_square
from fbn_common.kernels import kernel
from fbn_common.records import SweptArea
from fbn_common.types import Array

Bools = npt.NDArray[np.bool_]
_RINGS, _SPOKES = 4, 8
_LEAST_SCANS = 0.1  # a composite with fewer expected scans of a feature did not sweep it


def gaussian_points() -> Array:
    """Points (q, 2) of equal weight over the 95 % ellipse of a unit Gaussian: rings of equal probability."""
    probabilities = 0.95 * (np.arange(_RINGS) + 0.5) / _RINGS
    radii = np.sqrt(chi_square.bound(probabilities, 2))
    angles = 2 * np.pi * np.arange(_SPOKES) / _SPOKES
    points = [(r * np.cos(a + 0.4 * k), r * np.sin(a + 0.4 * k)) for k, r in enumerate(radii) for a in angles]
    return np.array(points)


_POINTS = gaussian_points()


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """The swept grids of several composites in one piece: scans one after the other, where each begins, its shape."""

    scans: Array
    begins: npt.NDArray[np.int64]  # (k,)
    shapes: npt.NDArray[np.int64]  # (k, 2) width, height
    corners: Array  # (k, 2) m, relative to the base
    cells: Array  # (k,) m


def gather(areas: tuple[SweptArea, ...]) -> Sweeps:
    """Several swept areas as arrays."""
    sizes = np.array([0, *(len(a.scans) for a in areas)], dtype=np.int64)
    return Sweeps(
        np.concatenate([np.asarray(a.scans, dtype=float) for a in areas]) if areas else np.zeros(0),
        np.cumsum(sizes)[: len(areas)],
        np.array([[a.width, a.height] for a in areas], dtype=np.int64).reshape(-1, 2),
        np.array([a.origin for a in areas], dtype=float).reshape(-1, 2),
        np.array([a.cell_size for a in areas], dtype=float),
    )


def scan_counts(relative: Array, covariance: Array, sweeps: Sweeps) -> Array:
    """Scans (features, sweeps, q) at the points of each feature's ellipse.

    ``relative`` (features, sweeps, 2): the feature's place less the sweep's base; ``covariance`` (.., 2, 2) of it.
    """
    return _counts(
        np.ascontiguousarray(relative), np.ascontiguousarray(covariance), _POINTS,
        sweeps.scans, sweeps.begins, sweeps.shapes, sweeps.corners, sweeps.cells,
    )  # fmt: skip


@kernel
def _counts(
    relative: Array,
    covariance: Array,
    points: Array,
    scans: Array,
    begins: npt.NDArray[np.int64],
    shapes: npt.NDArray[np.int64],
    corners: Array,
    cells: Array,
) -> Array:
    features, sweeps, q = relative.shape[0], relative.shape[1], points.shape[0]
    out = np.zeros((features, sweeps, q))
    for j in range(features):
        for k in range(sweeps):
            c = covariance[j, k]
            l00 = np.sqrt(max(c[0, 0], 0.0))
            l10 = c[1, 0] / l00 if l00 > 0.0 else 0.0
            l11 = np.sqrt(max(c[1, 1] - l10 * l10, 0.0))
            for i in range(q):
                x = relative[j, k, 0] + l00 * points[i, 0] - corners[k, 0]
                y = relative[j, k, 1] + l10 * points[i, 0] + l11 * points[i, 1] - corners[k, 1]
                column, row = int(np.floor(x / cells[k])), int(np.floor(y / cells[k]))
                if 0 <= column < shapes[k, 0] and 0 <= row < shapes[k, 1]:
                    out[j, k, i] = scans[begins[k] + row * shapes[k, 0] + column]
    return out


@kernel
def missed(scans: float, visibility: float, promotion: int) -> float:
    """Chance of fewer than ``promotion`` detections in so many scans; between whole numbers, linear."""
    low = int(np.floor(scans))
    part = scans - low
    chance = _missed_whole(low, visibility, promotion)
    return chance if part == 0.0 else (1.0 - part) * chance + part * _missed_whole(low + 1, visibility, promotion)


@kernel
def _missed_whole(scans: int, visibility: float, promotion: int) -> float:
    if scans < promotion:
        return 1.0
    term, total = (1.0 - visibility) ** scans, 0.0
    for k in range(promotion):
        total += term
        term *= (scans - k) / (k + 1.0) * visibility / (1.0 - visibility)
    return min(total, 1.0)


@kernel
def log_missed(
    counts: Array, detected: Bools, visibility: Array, existence: Array, promotion: int, floor: float
) -> Array:
    """Log chance (features,) of what was not seen of each feature.

    ``counts`` (features, sweeps, q); ``detected`` (features, sweeps): a feature matched to it was seen then;
    ``existence`` (features,): 1 for those matched.  A pass in which it was detected says nothing here.
    """
    features, sweeps, q = counts.shape
    out = np.zeros(features)
    scans = np.zeros(q)
    for j in range(features):
        log_chance = 0.0
        scans[:] = 0.0
        seen, swept = False, False
        for k in range(sweeps + 1):
            now = k < sweeps and counts[j, k].mean() > _LEAST_SCANS
            if now:
                swept = True
                seen = seen or detected[j, k]
                scans += counts[j, k]
            elif swept:
                if not seen:
                    chance = 0.0
                    for i in range(q):
                        chance += missed(scans[i], visibility[j], promotion) / q
                    log_chance += np.log(floor + (1.0 - floor) * chance)
                scans[:] = 0.0
                seen, swept = False, False
        out[j] = np.log(1.0 - existence[j] + existence[j] * np.exp(log_chance))
    return out
