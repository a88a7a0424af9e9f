"""What a log says of itself without truth: dead reckoning against GPS from surfacing to surfacing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pymap3d

from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.series import Track
from fbn_common.records import NavSatFix
from fbn_common.types import NS, Array

SETTLE = 20  # s after surfacing in which the best fix is sought: the first ones are poor


@dataclass(frozen=True, slots=True)
class Surfacing:
    """The jump found by GPS after a leg under water, against dead reckoning alone."""

    leg: int
    discrepancy: float  # m
    sigma: float  # m, of the two fixes
    distance: float  # m, as dead-reckoned

    @property
    def percent(self) -> float:
        """[% of distance]; NaN for a leg that went nowhere."""
        return 100.0 * self.discrepancy / self.distance if self.distance > 0.0 else float("nan")


def surfacings(fixes: Sequence[NavSatFix], deadreck: Track, legs: Sequence[Dive]) -> tuple[Surfacing, ...]:
    """Dead reckoning's error seen by GPS on every leg that has fixes before and after it."""
    good = [f for f in fixes if f.status >= 0 and np.isfinite([f.latitude, f.longitude]).all()]
    good = [f for f in good if len(deadreck) and deadreck.stamp_ns[0] <= f.stamp_ns <= deadreck.stamp_ns[-1]]
    found = []
    for leg in legs:
        before = [f for f in good if leg.start_ns - 2 * SETTLE * NS <= f.stamp_ns <= leg.start_ns]
        after = [f for f in good if leg.end_ns <= f.stamp_ns <= leg.end_ns + SETTLE * NS]
        if before and after:
            found.append(_surfacing(leg, min(before, key=_sigma), min(after, key=_sigma), deadreck))
    return tuple(found)


def _surfacing(leg: Dive, a: NavSatFix, b: NavSatFix, deadreck: Track) -> Surfacing:
    by_gps = _displacement(a, b)
    ends = deadreck.at(np.array([a.stamp_ns, b.stamp_ns]))
    by_reckoning = (ends.position[1] - ends.position[0])[:2]
    distance = float(deadreck.between(a.stamp_ns, b.stamp_ns).distance()[-1])
    discrepancy = float(np.linalg.norm(by_gps - by_reckoning))
    return Surfacing(leg.number, discrepancy, float(np.hypot(_sigma(a), _sigma(b))), distance)


def _displacement(a: NavSatFix, b: NavSatFix) -> Array:
    """East and north (2,) [m] from the first fix to the second."""
    east, north, _ = pymap3d.geodetic2enu(b.latitude, b.longitude, a.altitude, a.latitude, a.longitude, a.altitude)
    return np.array([float(east), float(north)])


def _sigma(fix: NavSatFix) -> float:
    """Horizontal standard deviation [m]."""
    return float(np.sqrt(max(fix.position_covariance[0, 0] + fix.position_covariance[1, 1], 0.0) / 2))
