"""Matches as pictures show them: hypotheses over time, and tracked features laid on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Track
from fbn_bringup.report.layers import minutes
from fbn_common import records as r
from fbn_common.overlay import Overlay, lay, likely, on_map
from fbn_common.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class HypothesisLine:
    """One hypothesis over time; the null hypothesis has no pairs."""

    id: int
    minutes: Array
    posterior: Array
    log_score: Array
    pairs: Array

    @property
    def null(self) -> bool:
        """Does it say that nothing is matched?"""
        return not self.pairs.any()


def hypothesis_lines(run: Run, most: int = 8) -> list[HypothesisLine]:
    """The hypotheses of a run, those ever most probable first."""
    rows: dict[int, list[tuple[int, float, float, int]]] = {}
    for message in run.of("global/hypotheses", r.MatchHypotheses):
        for h in message.hypotheses:
            rows.setdefault(h.id, []).append((message.stamp_ns, h.posterior, h.log_score, len(h.map_ids)))
    ranked = sorted(rows, key=lambda k: -max(row[1] for row in rows[k]))[:most]
    return [_line(run, k, rows[k]) for k in ranked]


def stated_posterior(run: Run) -> tuple[Array, Array]:
    """Minutes (n,), and the posterior (n,) that the status gives to the place, over all accounts of features there."""
    told = run.of("global/status", r.LocalizationStatus)
    return minutes(run, np.array([s.stamp_ns for s in told])), np.array([s.posterior for s in told])


def _line(run: Run, key: int, rows: list[tuple[int, float, float, int]]) -> HypothesisLine:
    stamps, posterior, score, pairs = zip(*rows, strict=True)
    return HypothesisLine(key, minutes(run, np.array(stamps)), np.array(posterior), np.array(score), np.array(pairs))


@dataclass(frozen=True, slots=True, eq=False)
class DiveOverlay(Overlay):
    """What one hypothesis makes of a dive at its end."""

    dive: int
    hypothesis: int
    posterior: float
    log_score: float
    map_labels: tuple[str, ...]
    path_xy: Array  # (m, 2) the dive's path on the map


def overlays(run: Run, most: int = 1) -> list[DiveOverlay]:
    """Overlays of each dive that had an answer of the global filter: at most so many of its likely hypotheses."""
    return [o for leg in run.legs() for o in _overlays(run, leg, most)]


def _overlays(run: Run, leg: Dive, most: int) -> list[DiveOverlay]:
    answers = [h for h in run.of("global/hypotheses", r.MatchHypotheses) if leg.contains(h.stamp_ns) and h.hypotheses]
    odom = run.tracks.get("deadreck/odometry")
    maps = [m for m in run.of("global/map", r.FeatureMap) if answers and m.stamp_ns <= answers[-1].stamp_ns]
    if not answers or odom is None or not maps:
        return []
    return [_overlay(run, leg, h, answers[-1].stamp_ns, maps[-1], odom) for h in likely(answers[-1], most)]


def _overlay(run: Run, leg: Dive, h: r.MatchHypothesis, stamp: int, believed: r.FeatureMap, odom: Track) -> DiveOverlay:
    here = odom.at(np.clip(np.array([stamp]), odom.stamp_ns[0], odom.stamp_ns[-1]))
    pose_odom = r.Pose(here.position[0], here.rotation.as_quat()[0])
    composites = [c for c in run.of("tracking/composite", r.CompositeMeasurement) if leg.contains(c.stamp_ns)]
    laid = lay(h, pose_odom, believed, _tracked(run, leg, stamp), [c for c in composites if c.stamp_ns <= stamp])
    return DiveOverlay(
        laid.features,
        laid.map_xy,
        laid.tracked_xy,
        laid.pairs,
        laid.swept,
        laid.missed,
        leg.number,
        h.id,
        h.posterior,
        h.log_score,
        tuple(f.name or str(f.id) for f in laid.features),
        on_map(odom.between(leg.start_ns, leg.end_ns).position[::15], h.pose, pose_odom),
    )


def _tracked(run: Run, leg: Dive, until_ns: int) -> dict[int, Array]:
    """Position (3,) in odom by key of every feature seen in the dive until a stamp, as last told."""
    found: dict[int, Array] = {}
    for message in run.of("tracking/features", r.TrackedFeatures):
        if leg.start_ns <= message.stamp_ns <= until_ns:
            found |= {f.key: f.position for f in message.features if f.stage != r.Stage.INFANT}
    return dict(sorted(found.items()))
