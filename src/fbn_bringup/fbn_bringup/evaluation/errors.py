"""Errors of position against truth, in the terms that matter to navigation.

Definitions (docs/concepts.md, "What an error is"):

dead reckoning
    The frame ``odom`` drifts by design, so it is laid on truth at the start of each dive, by translation alone
    (its axes claim to be east and north: an error of heading counts).  The error is what has grown by the end
    of the dive, over the way covered.
absolute
    Estimated less true position in ``map``, whose datum is the run's own.
on the map
    The prior map itself is displaced against truth (metres), and map and vehicle move together when they are
    matched; what homing needs is where the map's features are *from the vehicle*.  With estimated position p,
    features m_j as the filter now believes them and true ones p', m'_j, the error is the mean over the matched
    features of ``(m_j - p) - (m'_j - p')``, horizontally.  A false match shows in it in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.series import Stamps, Track
from fbn_bringup.evaluation.truth import Truth
from fbn_common.records import FeatureMap, MatchHypotheses
from fbn_common.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSeries:
    """Errors over time: estimate less truth (n, 3) [m] in the axes of ``map``, rotation vectors (n, 3) [rad]."""

    track: Track  # the estimate
    position: Array
    rotation: Array  # about map axes: R_estimate = Exp(rotation) R_true

    @property
    def horizontal(self) -> Array:
        """Distance in the plane (n,) [m]."""
        return np.asarray(np.linalg.norm(self.position[:, :2], axis=1))


def against(estimate: Track, truth: Track) -> ErrorSeries:
    """Errors of an estimate where truth is known, at the stamps of the sparser of both, which is not interpolated."""
    kept, true = estimate.within(truth), truth.within(estimate)
    if len(kept) and len(true) < len(kept):
        kept = estimate.at(true.stamp_ns)
    true = truth.at(kept.stamp_ns)
    rotation = (kept.rotation * true.rotation.inv()).as_rotvec() if len(kept) else np.zeros((0, 3))
    return ErrorSeries(kept, kept.position - true.position, rotation)


@dataclass(frozen=True, slots=True)
class Drift:
    """Growth of dead reckoning's horizontal error over a leg."""

    error: float  # m, at the end
    distance: float  # m, true way

    @property
    def percent(self) -> float:
        """Error in % of distance; NaN for a leg that went nowhere."""
        return 100.0 * self.error / self.distance if self.distance > 0.0 else float("nan")


def drift(deadreck: Track, truth: Track, leg: Dive) -> Drift | None:
    """Dead reckoning's drift over one leg, laid on truth at its start; None where data is missing."""
    errors = against(deadreck.between(leg.start_ns, leg.end_ns), truth)
    if len(errors.track) < 2:
        return None
    grown = errors.position[-1] - errors.position[0]
    span = truth.between(int(errors.track.stamp_ns[0]), int(errors.track.stamp_ns[-1]))
    return Drift(float(np.hypot(grown[0], grown[1])), float(span.distance()[-1]))


def aligned(deadreck: Track, truth: Track, stamp_ns: int) -> Track:
    """Dead reckoning moved (translation alone) so that it meets truth at a stamp."""
    stamp = np.array([stamp_ns])
    return deadreck.shifted(truth.at(stamp).position[0] - deadreck.at(stamp).position[0])


@dataclass(frozen=True, slots=True, eq=False)
class MapShift:
    """How far the map as believed lies off the true features, step by step: (n, 3) [m] at stamps (n,)."""

    stamp_ns: Stamps
    shift: Array
    features: tuple[int, ...]  # how many features each value rests on

    def at(self, stamp_ns: Stamps) -> Array:
        """The shift (m, 3) in force at these stamps (m,); the first one before the first."""
        before = np.searchsorted(self.stamp_ns, stamp_ns, side="right") - 1
        return np.asarray(self.shift[np.clip(before, 0, len(self.shift) - 1)])


def map_shift(maps: Sequence[FeatureMap], hypotheses: Sequence[MatchHypotheses], truth: Truth) -> MapShift | None:
    """Shift of the matched features (all prior ones as long as none is matched); None where it cannot be known."""
    true, stamps, shifts, counts = truth.on_map(), [], [], []
    for m in maps:
        matched = _matched_ids(hypotheses, m.stamp_ns)
        known = [f for f in m.features if f.id in true]
        used = [f for f in known if f.id in matched] or [f for f in known if f.prior]
        if used:
            stamps.append(m.stamp_ns)
            shifts.append(np.mean([f.position - true[f.id].position for f in used], axis=0))
            counts.append(len(used))
    if not stamps:
        return None
    return MapShift(np.array(stamps, dtype=np.int64), np.array(shifts), tuple(counts))


def _matched_ids(hypotheses: Sequence[MatchHypotheses], stamp_ns: int) -> set[int]:
    """Map ids paired under the best hypothesis in force at a stamp."""
    current = [h for h in hypotheses if h.stamp_ns <= stamp_ns]
    return set(current[-1].hypotheses[0].map_ids) if current and current[-1].hypotheses else set()


def on_the_map(errors: ErrorSeries, shift: MapShift) -> ErrorSeries:
    """Errors relative to the map's features: absolute ones less the map's own shift."""
    return ErrorSeries(errors.track, errors.position - shift.at(errors.track.stamp_ns), errors.rotation)
