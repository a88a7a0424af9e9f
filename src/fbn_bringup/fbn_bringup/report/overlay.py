"""Matches as pictures show them: hypotheses over time, and tracked features laid on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Track
from fbn_bringup.report.layers import minutes
from fbn_bringup.report.sweep import Raster, missed, swept
from fbn_common import records as r
from fbn_common.types import Array

LIKELY = 0.01  # posterior from which a hypothesis that is not the best has an overlay of its own


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


def _line(run: Run, key: int, rows: list[tuple[int, float, float, int]]) -> HypothesisLine:
    stamps, posterior, score, pairs = zip(*rows, strict=True)
    return HypothesisLine(key, minutes(run, np.array(stamps)), np.array(posterior), np.array(score), np.array(pairs))


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """The map and the tracked features laid on it by one hypothesis, at the end of one dive; and what was swept."""

    dive: int
    hypothesis: int
    posterior: float
    log_score: float
    map_xy: Array  # (n, 2) where this hypothesis has it
    map_labels: tuple[str, ...]
    tracked_xy: Array  # (k, 2)
    pairs: tuple[tuple[int, int], ...]  # rows of map_xy and of tracked_xy
    path_xy: Array  # (m, 2) the dive's path on the map
    swept: Raster | None
    missed: tuple[int, ...]  # rows of map_xy scanned often enough, and not seen in this dive


def overlays(run: Run, most: int = 1) -> list[Overlay]:
    """Overlays of each dive that had an answer of the global filter: at most so many of its likely hypotheses."""
    return [o for leg in run.legs() for o in _overlays(run, leg, most)]


def _overlays(run: Run, leg: Dive, most: int) -> list[Overlay]:
    answers = [h for h in run.of("global/hypotheses", r.MatchHypotheses) if leg.contains(h.stamp_ns) and h.hypotheses]
    path, odom = run.tracks.get("global/odometry"), run.tracks.get("deadreck/odometry")
    maps = [m for m in run.of("global/map", r.FeatureMap) if answers and m.stamp_ns <= answers[-1].stamp_ns]
    if not answers or path is None or odom is None or not maps:
        return []
    best, *others = answers[-1].hypotheses
    likely = [best, *(h for h in others if h.map_ids and h.posterior >= LIKELY)][:most]
    return [_overlay(run, leg, h, answers[-1].stamp_ns, maps[-1], odom) for h in likely]


def _overlay(run: Run, leg: Dive, h: r.MatchHypothesis, stamp: int, believed: r.FeatureMap, odom: Track) -> Overlay:
    def on_map(points: Array) -> Array:
        return _carried(points, h.pose, odom, stamp)

    tracked = _tracked(run, leg, stamp)
    xy = on_map(np.array([p for _, p in tracked]).reshape(-1, 3))
    rows, keys = {f.id: i for i, f in enumerate(believed.features)}, {k: i for i, (k, _) in enumerate(tracked)}
    pairs = tuple((rows[m], keys[k]) for m, k in zip(h.map_ids, h.feature_keys, strict=True) if m in rows and k in keys)
    map_xy = np.array([f.position[:2] for f in believed.features]).reshape(-1, 2)
    map_xy = map_xy + _shift(map_xy, xy, pairs)
    composites = [c for c in run.of("tracking/composite", r.CompositeMeasurement) if leg.contains(c.stamp_ns)]
    sweep = swept([c for c in composites if c.stamp_ns <= stamp], on_map)
    dive_path = odom.between(leg.start_ns, leg.end_ns).position[::15]
    return Overlay(
        leg.number,
        h.id,
        h.posterior,
        h.log_score,
        map_xy,
        tuple(f.name or str(f.id) for f in believed.features),
        xy,
        pairs,
        on_map(dive_path),
        sweep,
        missed(sweep, map_xy, {row for row, _ in pairs} | _found(believed)),
    )


def _shift(map_xy: Array, tracked_xy: Array, pairs: tuple[tuple[int, int], ...]) -> Array:
    """How far (2,) a hypothesis has the map from where the leading one has it, by its pairs."""
    if not pairs:
        return np.zeros(2)
    ours, found = (np.array(rows) for rows in zip(*pairs, strict=True))
    return np.asarray((tracked_xy[found] - map_xy[ours]).mean(axis=0))


def _found(believed: r.FeatureMap) -> set[int]:
    """Rows of features that are no part of the prior map: nothing is expected of them."""
    return {row for row, f in enumerate(believed.features) if not f.prior}


def _tracked(run: Run, leg: Dive, until_ns: int) -> list[tuple[int, Array]]:
    """Key and position (3,) in odom of every feature seen in the dive until a stamp, as last told."""
    found: dict[int, Array] = {}
    for message in run.of("tracking/features", r.TrackedFeatures):
        if leg.start_ns <= message.stamp_ns <= until_ns:
            found |= {f.key: f.position for f in message.features if f.stage != r.Stage.INFANT}
    return sorted(found.items())


def _carried(points: Array, pose: r.Pose, odom: Track, stamp_ns: int) -> Array:
    """Points (n, 3) of odom on the map (n, 2), by the vehicle's pose at a stamp in both."""
    here = odom.at(np.clip(np.array([stamp_ns]), odom.stamp_ns[0], odom.stamp_ns[-1]))
    turn = Rotation.from_quat(pose.orientation) * here.rotation[0].inv()
    return np.asarray(turn.apply(points - here.position[0]) + pose.position).reshape(-1, 3)[:, :2]
