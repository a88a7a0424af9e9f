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

NEAR = 40  # s before and after a leg from which fixes are taken


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
        before = [f for f in good if leg.start_ns - NEAR * NS <= f.stamp_ns <= leg.start_ns]
        after = [f for f in good if leg.end_ns <= f.stamp_ns <= leg.end_ns + NEAR * NS]
        if before and after:
            found.append(_surfacing(leg, before, after, deadreck))
    return tuple(found)


def _surfacing(leg: Dive, before: list[NavSatFix], after: list[NavSatFix], deadreck: Track) -> Surfacing:
    """Medians over the fixes near each end, as single ones may be far off."""
    offset = _offsets(before + after, deadreck)
    jump = np.median(offset[len(before) :], axis=0) - np.median(offset[: len(before)], axis=0)
    sigma = np.hypot(np.median([_sigma(f) for f in before]), np.median([_sigma(f) for f in after]))
    ends = [int(np.median([f.stamp_ns for f in fixes])) for fixes in (before, after)]
    distance = float(deadreck.between(*ends).distance()[-1])
    return Surfacing(leg.number, float(np.hypot(*jump)), float(sigma), distance)


def _offsets(fixes: list[NavSatFix], deadreck: Track) -> Array:
    """GPS less dead reckoning (n, 2) [m, east and north], but for a constant."""
    first = fixes[0]
    latitude, longitude = np.array([f.latitude for f in fixes]), np.array([f.longitude for f in fixes])
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, 0.0, first.latitude, first.longitude, 0.0)
    reckoned = deadreck.at(np.array([f.stamp_ns for f in fixes])).position[:, :2]
    return np.asarray(np.stack([east, north], axis=-1) - reckoned)


def _sigma(fix: NavSatFix) -> float:
    """Horizontal standard deviation [m]."""
    return float(np.sqrt(max(fix.position_covariance[0, 0] + fix.position_covariance[1, 1], 0.0) / 2))
