"""What the data of a run along like rows can tell at all: the posterior of an ideal observer.

The observer is told what the filter has to find out: the true identity of everything found, where every sweep went,
how the sonar detects, and that the map fits in one of its places; it knows the map's and the fix's errors as they are
stated, and that features may be missing, as the filter's parameters say.  Left to it is the one question that rows
pose: by how many rows and columns the map lies off.  By Bayes' rule, over all such shifts ``k``:

    log P(k | data) = log N(displacement; 0, map^2 + fix^2 + drift^2)
                    + sum over places with an object under k:  log p + gain, if found;  log(1 - p + p P(missed)), if not

``gain`` is what an object on the map is likelier than one off it.  Who knows less cannot decide more often, so what the
observer leaves undecided is beyond any filter that makes these assumptions.
"""

from __future__ import annotations

from math import log, pi

import numpy as np
from scipy.stats import binom

from fbn_common.records import CompositeMeasurement, SweptArea
from fbn_common.types import Array, seconds
from fbn_global.parameters import GlobalParameters
from fbn_testing.composite_world import Run, Settings
from fbn_testing.matching_worlds import COLUMNS, ROWS, SPACING

Place = tuple[int, int]  # column and row of the grid
_SHIFTS = [(a, b) for a in range(-4, 5) for b in range(-2, 3)]


def posterior(s: Settings, run: Run, parameters: GlobalParameters) -> dict[Place, float]:
    """Probability of each shift (columns, rows) of the map; (0, 0) is the truth."""
    composites = [r for _, r in run.entries if isinstance(r, CompositeMeasurement)]
    found = {divmod(i, COLUMNS)[::-1] for i in run.key_feature.values() if i >= 0}
    missed = _chances_to_miss(s, run, composites)
    gain = _gain(s, run, composites, parameters)
    begin_s = _first_found_s(composites)
    scores = np.array([_score(s, k, found, missed, gain, begin_s, parameters) for k in _SHIFTS])
    weights = np.exp(scores - scores.max())
    return dict(zip(_SHIFTS, (weights / weights.sum()).tolist(), strict=True))


def _score(
    s: Settings, shift: Place, found: set[Place], missed: dict[Place, float], gain: float, begin_s: float,
    parameters: GlobalParameters,
) -> float:  # fmt: skip
    p = parameters.prior.existence
    displacement = np.array(s.map_shift) + SPACING * np.array(shift)
    variance = s.map_sigma**2 + s.fix_sigma**2 + (s.drift_sigma * begin_s) ** 2
    score = -0.5 * float(displacement @ displacement) / variance
    for column in range(COLUMNS):
        for row in range(ROWS):
            place = (column - shift[0], row - shift[1])
            score += log(p) + gain if place in found else log(1.0 - p + p * missed.get(place, 1.0))
    return score


def _chances_to_miss(s: Settings, run: Run, composites: list[CompositeMeasurement]) -> dict[Place, float]:
    """Chance that an object at each place is never promoted in all sweeps."""
    places = [(c, r) for c in range(-6, COLUMNS + 6) for r in range(-3, ROWS + 3)]
    chances = {}
    for place in places:
        xy = SPACING * np.array(place, dtype=float)
        scans = [_scans(c.swept, xy - run.truth[c.start_ns][:2]) for c in composites]
        chances[place] = float(np.prod([binom.cdf(s.promotion - 1, round(n), s.visibility) for n in scans]))
    return chances


def _scans(area: SweptArea, xy: Array) -> float:
    """Scans at a place (2,) relative to the sweep's base."""
    column, row = (int(v) for v in np.floor((xy - area.origin) / area.cell_size))
    inside = 0 <= column < area.width and 0 <= row < area.height
    return float(area.scans[row * area.width + column]) if inside else 0.0


def _gain(s: Settings, run: Run, composites: list[CompositeMeasurement], parameters: GlobalParameters) -> float:
    """Log of how much likelier a found object is on the map than off it: peaked density against that of surplus."""
    m, q = parameters.matching, parameters.scoring
    horizontal = s.feature_sigma**2 + s.map_own**2 + m.object_sigma**2
    vertical = 1.0 + parameters.prior.up_sigma**2 + m.object_up_sigma**2
    peak = -1.5 * (log(2.0 * pi) + 1.0) - log(horizontal) - 0.5 * log(vertical)  # a residual of one sigma on each axis
    area = max(float((c.swept.scans > 0).sum()) * c.swept.cell_size**2 for c in composites)
    return peak + log((q.surplus_area + area) * q.height_span / (q.surplus_count + len(run.key_feature)))


def _first_found_s(composites: list[CompositeMeasurement]) -> float:
    """Time from the first fix until something was found [s]."""
    first = next((c for c in composites if c.features), composites[-1])
    return seconds(first.stamp_ns - composites[0].start_ns)
