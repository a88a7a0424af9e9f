"""What one hypothesis of a match looks like: tracked features and sweeps laid on the map, what was missed on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbn_common import records as r
from fbn_common.lie import matrix_from_quaternion
from fbn_common.sweep import Raster, missed, swept
from fbn_common.types import Array, Vec3

LIKELY = 0.01  # posterior from which a hypothesis that is not the best is shown as well


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """The prior map as a hypothesis has it (n, 2), tracked features upon it (k, 2), and what was swept [m]."""

    features: tuple[r.MapFeature, ...]
    map_xy: Array
    tracked_xy: Array
    pairs: tuple[tuple[int, int], ...]  # rows of map_xy and of tracked_xy
    swept: Raster | None
    missed: tuple[int, ...]  # rows of map_xy scanned often enough, and not seen


def likely(answer: r.MatchHypotheses, most: int) -> list[r.MatchHypothesis]:
    """The best hypothesis, and others that match something and are not too unlikely; at most so many."""
    best, *others = answer.hypotheses
    return [best, *(h for h in others if h.map_ids and h.posterior >= LIKELY)][:most]


def lay(
    h: r.MatchHypothesis,
    pose_odom: r.Pose,
    believed: r.FeatureMap,
    tracked: Mapping[int, Vec3],
    composites: Sequence[r.CompositeMeasurement],
) -> Overlay:
    """A hypothesis's overlay of features (by key, in odom) and sweeps; the vehicle's pose in odom at its stamp."""
    xy = on_map(np.array(list(tracked.values())).reshape(-1, 3), h.pose, pose_odom)
    features = tuple(f for f in believed.features if f.prior)
    rows, keys = {f.id: i for i, f in enumerate(features)}, {k: i for i, k in enumerate(tracked)}
    pairs = tuple((rows[m], keys[k]) for m, k in zip(h.map_ids, h.feature_keys, strict=True) if m in rows and k in keys)
    map_xy = np.array([f.position[:2] for f in features]).reshape(-1, 2)
    map_xy = map_xy + _shift(map_xy, xy, pairs)
    sweep = swept(composites, lambda points: on_map(points, h.pose, pose_odom))
    return Overlay(features, map_xy, xy, pairs, sweep, missed(sweep, map_xy, {row for row, _ in pairs}))


def on_map(points: Array, pose_map: r.Pose, pose_odom: r.Pose) -> Array:
    """Points (n, 3) of odom on the map (n, 2), by the vehicle's pose at one time in both."""
    rotations = [matrix_from_quaternion(p.orientation) for p in (pose_map, pose_odom)]
    turn = rotations[0] @ rotations[1].T
    return np.asarray((points - pose_odom.position) @ turn.T + pose_map.position)[:, :2]


def _shift(map_xy: Array, tracked_xy: Array, pairs: tuple[tuple[int, int], ...]) -> Array:
    """How far (2,) a hypothesis has the map from where the leading one has it, by its pairs."""
    if not pairs:
        return np.zeros(2)
    ours, found = (np.array(rows) for rows in zip(*pairs, strict=True))
    return np.asarray((tracked_xy[found] - map_xy[ours]).mean(axis=0))
