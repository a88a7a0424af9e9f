"""What the data of a run along like rows can tell at all: the posterior of an ideal observer.

The observer is told what the filter has to find out: which feature each track is and where it truly lies, where every
sweep went, how the sonar detects, and that the map fits at one of its places.  For the rest it has the filter's own
likelihoods: the map's error and the fix's as they are stated, and how many features may be missing or off the map.
Left to it are the two questions that rows pose: by how many columns and rows the map lies off, and whether it is of
this place at all.  By Bayes' rule, over all such shifts ``k`` and the null, in which all that was found is off the map:

    log P(k | data) = log N(found less map; 0, map + fix + drift + size)      of all pairs that k makes, at once
                    + log Gamma-Poisson(objects that k leaves off the map)
                    + sum of log p over pairs + sum of log(1 - p + p P(missed)) over the map's others + log prior odds

Who knows less can rarely decide more; what it leaves undecided, hardly any filter with these assumptions can decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import bdtr
from scipy.stats import multivariate_normal

from fbn_common.records import CompositeMeasurement, SweptArea
from fbn_common.types import Array, seconds
from fbn_global.naps import surplus_log
from fbn_global.parameters import GlobalParameters, VerdictParameters
from fbn_testing.composite_world import Run, Settings
from fbn_testing.matching_worlds import COLUMNS, ROWS, SPACING

Shift = tuple[int, int]  # columns, rows
TRUTH: Shift = (0, 0)
_SHIFTS = [(a, b) for a in range(1 - COLUMNS, COLUMNS) for b in range(1 - ROWS, ROWS)]


@dataclass(frozen=True, slots=True)
class Belief:
    """What the ideal observer makes of a run: the probability of each shift of the map, and of the null."""

    shifts: dict[Shift, float]
    null: float

    def verdict(self, p: VerdictParameters) -> bool | None:
        """By the filter's own rule: whether the match that it would declare is right; None: undecided."""
        best = max(self.shifts, key=lambda k: self.shifts[k])
        sure = self.shifts[best] >= p.match_posterior and self.null <= p.null_posterior
        return best == TRUTH if sure else None


def believe(s: Settings, run: Run, parameters: GlobalParameters) -> Belief:
    """The ideal observer's posterior."""
    observer = Observer(s, run, parameters)
    scores = np.array([observer.null(), *(observer.score(shift) for shift in _SHIFTS)])
    weights = np.exp(scores - scores.max())
    null, *shifts = (weights / weights.sum()).tolist()
    return Belief(dict(zip(_SHIFTS, shifts, strict=True)), null)


class Observer:
    """All that the observer is told of one run."""

    def __init__(self, s: Settings, run: Run, parameters: GlobalParameters) -> None:
        self.s, self.p = s, parameters
        self.composites = [r for _, r in run.entries if isinstance(r, CompositeMeasurement)]
        self.bases = [run.truth[c.start_ns][:2] for c in self.composites]
        self.found = sorted({i for i in run.key_feature.values() if i >= 0})
        self.clutter = sum(i < 0 for i in run.key_feature.values())
        self.stated = run.prior.positions(run.datum)[:, :2]
        self.area = sum(float((c.swept.scans > 0).mean()) * _size(c.swept) for c in self.composites) / 2.0  # overlap
        first = next((c for c in self.composites if c.features), self.composites[-1])
        drift = s.drift_sigma * seconds(first.stamp_ns - self.composites[0].start_ns)
        self.common = s.fix_sigma**2 + drift**2

    def null(self) -> float:
        """Log probability of the data and of a map of another place, but for a constant."""
        prior = log(1.0 - self.p.scoring.prior_match)
        return surplus_log(len(self.found) + self.clutter, self.area, self.p.scoring) + prior

    def score(self, shift: Shift) -> float:
        """Log probability of the data and of a shift, but for the same constant."""
        pairs = [(i, j) for i in self.found if (j := _moved(i, shift)) is not None]
        rows = {j for _, j in pairs}
        p = self.p.prior.existence
        fit = self._fit(pairs) + len(pairs) * log(p) + log(self.p.scoring.prior_match)
        fit += surplus_log(len(self.found) - len(pairs) + self.clutter, self.area, self.p.scoring)
        offset = self._offset(shift)
        others = [self.stated[j] + offset for j in range(COLUMNS * ROWS) if j not in rows]
        return fit + sum(log(1.0 - p + p * self._missed(xy)) for xy in others)

    def _fit(self, pairs: list[tuple[int, int]]) -> float:
        """Log density of the differences of all pairs at once, horizontally; heights tell nothing of a shift."""
        if not pairs:
            return 0.0
        found, stated = (np.array(rows) for rows in zip(*pairs, strict=True))
        difference = self.s.features[found, :2] - self.stated[stated]
        apart = cdist(self.stated[stated], self.stated[stated])
        own = self.s.feature_sigma**2 + self.s.map_own**2 + self.p.matching.object_sigma**2
        covariance = self.s.map_sigma**2 / (1.0 + apart / self.s.map_length) + self.common + own * np.eye(len(pairs))
        density = multivariate_normal(np.zeros(len(pairs)), covariance)
        height = -len(pairs) * 0.5 * log(2.0 * np.pi * np.e * (2.0 + self.p.prior.up_common**2))
        return float(density.logpdf(difference[:, 0]) + density.logpdf(difference[:, 1])) + height

    def _offset(self, shift: Shift) -> Array:
        """What takes a place of the map to where a shift says that it is (2,) [m]."""
        truly = (self.s.features[:, :2] - self.stated).mean(axis=0)
        return np.asarray(truly - SPACING * np.array(shift))

    def _missed(self, xy: Array) -> float:
        """Chance that an object there is promoted in no sweep."""
        scans = np.array([_scans(c.swept, xy - base) for c, base in zip(self.composites, self.bases, strict=True)])
        enough = np.maximum(scans, self.s.promotion).astype(np.int64)
        return float(
            np.where(scans < self.s.promotion, 1.0, bdtr(self.s.promotion - 1, enough, self.s.visibility)).prod()
        )


def _moved(feature: int, shift: Shift) -> int | None:
    """The feature that lies a shift away in the grid."""
    row, column = divmod(feature, COLUMNS)
    column, row = column + shift[0], row + shift[1]
    return row * COLUMNS + column if 0 <= column < COLUMNS and 0 <= row < ROWS else None


def _size(area: SweptArea) -> float:
    """All cells of a grid [m^2]."""
    return area.width * area.height * area.cell_size**2


def _scans(area: SweptArea, xy: Array) -> float:
    """Scans at a place (2,) relative to the sweep's base."""
    column, row = (int(v) for v in np.floor((xy - area.origin) / area.cell_size))
    inside = 0 <= column < area.width and 0 <= row < area.height
    return float(area.scans[row * area.width + column]) if inside else 0.0
