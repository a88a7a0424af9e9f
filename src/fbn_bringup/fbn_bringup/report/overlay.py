"""Matches as pictures show them: hypotheses over time, and tracked features laid on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Track
from fbn_bringup.report.layers import minutes
from fbn_common import records as r
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


def _line(run: Run, key: int, rows: list[tuple[int, float, float, int]]) -> HypothesisLine:
    stamps, posterior, score, pairs = zip(*rows, strict=True)
    return HypothesisLine(key, minutes(run, np.array(stamps)), np.array(posterior), np.array(score), np.array(pairs))


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """The map and the tracked features laid on it by the best hypothesis, at the end of one dive."""

    dive: int
    posterior: float
    map_xy: Array  # (n, 2) as then believed
    map_labels: tuple[str, ...]
    tracked_xy: Array  # (k, 2)
    pairs: tuple[tuple[int, int], ...]  # rows of map_xy and of tracked_xy
    path_xy: Array  # (m, 2) the dive's path on the map


def overlays(run: Run) -> list[Overlay]:
    """One overlay per dive that had an answer of the global filter."""
    made = [_overlay(run, leg) for leg in run.legs()]
    return [o for o in made if o is not None]


def _overlay(run: Run, leg: Dive) -> Overlay | None:
    answers = [h for h in run.of("global/hypotheses", r.MatchHypotheses) if leg.contains(h.stamp_ns) and h.hypotheses]
    path, odom = run.tracks.get("global/odometry"), run.tracks.get("deadreck/odometry")
    maps = [m for m in run.of("global/map", r.FeatureMap) if answers and m.stamp_ns <= answers[-1].stamp_ns]
    if not answers or path is None or odom is None or not maps:
        return None
    best, stamp = answers[-1].hypotheses[0], answers[-1].stamp_ns
    features = maps[-1].features
    tracked = _tracked(run, leg, stamp)
    xy = _on_map(np.array([p for _, p in tracked]).reshape(-1, 3), stamp, path, odom)
    rows, keys = {f.id: i for i, f in enumerate(features)}, {k: i for i, (k, _) in enumerate(tracked)}
    pairs = [
        (rows[m], keys[k]) for m, k in zip(best.map_ids, best.feature_keys, strict=True) if m in rows and k in keys
    ]
    return Overlay(
        leg.number,
        best.posterior,
        np.array([f.position[:2] for f in features]).reshape(-1, 2),
        tuple(f.name or str(f.id) for f in features),
        xy,
        tuple(pairs),
        path.between(leg.start_ns, leg.end_ns).position[::15, :2],
    )


def _tracked(run: Run, leg: Dive, until_ns: int) -> list[tuple[int, Array]]:
    """Key and position (3,) in odom of every feature seen in the dive until a stamp, as last told."""
    found: dict[int, Array] = {}
    for message in run.of("tracking/features", r.TrackedFeatures):
        if leg.start_ns <= message.stamp_ns <= until_ns:
            found |= {f.key: f.position for f in message.features if f.stage != r.Stage.INFANT}
    return sorted(found.items())


def _on_map(points: Array, stamp_ns: int, path: Track, odom: Track) -> Array:
    """Points (n, 3) of odom on the map (n, 2), by the pose at a stamp in both."""
    stamp = np.clip(
        np.array([stamp_ns]), max(path.stamp_ns[0], odom.stamp_ns[0]), min(path.stamp_ns[-1], odom.stamp_ns[-1])
    )
    a, b = path.at(stamp), odom.at(stamp)
    turn = a.rotation[0] * b.rotation[0].inv()
    return np.asarray(turn.apply(points - b.position[0]) + a.position[0]).reshape(-1, 3)[:, :2]
