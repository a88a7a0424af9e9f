"""Records of what the filter knows."""

from __future__ import annotations

import numpy as np

from fbn_common.geodesy import GeodeticPoint
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.records import (
    FeatureMap,
    LocalizationStatus,
    MapFeature,
    MatchHypotheses,
    MatchHypothesis,
    Odometry,
    Pose,
    PoseWithCovarianceStamped,
)
from fbn_common.types import Array, Mat6, Vec6, seconds
from fbn_global.bank import Bank
from fbn_global.field import Field, Rows
from fbn_global.hypotheses import Hypothesis
from fbn_global.memory import Memory
from fbn_global.naps import existences, visibility
from fbn_global.parameters import ScoringParameters
from fbn_global.state import POSE, Block, Indices, Kind, State
from fbn_global.target import Target, rpy_inverse
from fbn_global.verdict import Verdict

WHOLE_MAP = 200  # features of the map up to which global/map tells of all: their covariance has (3 n)^2 numbers
FOUND_IDS = 1_000_000  # ids of found features in global/map: their key above this


def pose_record(pose: Array) -> Pose:
    """A pose of x, y, z, roll, pitch, yaw (6,)."""
    rotation = matrix_from_rpy(np.ascontiguousarray(pose[3:]))
    return Pose(pose[:3].copy(), quaternion_from_matrix(rotation))


def fixed_axes(pose: Array, covariance: Mat6) -> Mat6:
    """Covariance by (xyz, roll, pitch, yaw) in ROS order: xyz and rotations about the fixed axes."""
    turn = np.eye(6)
    turn[3:, 3:] = matrix_from_rpy(np.ascontiguousarray(pose[3:])) @ rpy_inverse(pose[3:])
    full = turn @ covariance @ turn.T
    return np.asarray(0.5 * (full + full.T))


def pose_message(stamp_ns: int, pose: Array, covariance: Mat6) -> PoseWithCovarianceStamped:
    return PoseWithCovarianceStamped(stamp_ns, "map", pose_record(pose), fixed_axes(pose, covariance))


def odometry_message(source: Odometry, pose: Array, covariance: Mat6) -> Odometry:
    """Dead reckoning's odometry with its pose carried onto the map; the body velocity stays."""
    twist: Vec6 = source.twist.copy()
    return Odometry(
        source.stamp_ns, "map", source.child_frame_id, pose_record(pose), twist, fixed_axes(pose, covariance),
        source.twist_covariance.copy(),
    )  # fmt: skip


def hypotheses_message(stamp_ns: int, bank: Bank, field: Field | None) -> MatchHypotheses:
    """The bank, best first; map features by their ids in the file."""
    order = sorted(bank.all, key=lambda h: (-h.score.posterior, h.id))
    return MatchHypotheses(stamp_ns, "map", tuple(_hypothesis(h, field) for h in order))


def _hypothesis(h: Hypothesis, field: Field | None) -> MatchHypothesis:
    pose, score = h.state.mean[POSE], h.score
    told = sorted(pair for pair in h.account if pair[0] >= 0)  # below 0: of a tracker before its restart
    return MatchHypothesis(
        h.id,
        max(h.parent, 0),
        score.log_ratio,
        score.posterior,
        score.positive + score.prior,
        score.negative,
        tuple(field.features[row].id for _, row in told) if field else (),
        tuple(key for key, _ in told),
        pose_record(pose),
        fixed_axes(pose, h.state.covariance[POSE, POSE]),
    )


def map_message(
    stamp_ns: int, h: Hypothesis, field: Field | None, memory: Memory, datum: GeodeticPoint, p: ScoringParameters
) -> FeatureMap:
    """The map as a hypothesis has it: the file's features, those in its state where they now lie, then those found."""
    features, positions, columns = _prior_features(h, field, memory, p) if field else ([], [], [])
    for key in h.unexplained():
        block = Block(Kind.FOUND, key)
        position = h.state.mean[h.state.span(block)].copy()
        features.append(MapFeature(FOUND_IDS + key, f"found {key}", False, 1.0, 0.0, False, position))
        columns.append(h.state.columns(block))
        positions.append(position)
    rows = _told(h.state, field) if field else np.zeros(0, dtype=np.int64)
    covariance = _map_covariance(h.state, field, rows, columns)
    return FeatureMap(stamp_ns, "map", datum.latitude, datum.longitude, datum.height, tuple(features), covariance)


def _prior_features(
    h: Hypothesis, field: Field, memory: Memory, p: ScoringParameters
) -> tuple[list[MapFeature], list[Array], list[Indices | None]]:
    rows = _told(h.state, field)
    visible = visibility(h, rows, field, memory, p)
    there = existences(h, field, memory, p)
    features: list[MapFeature] = []
    columns: list[Indices | None] = []
    for n, row in enumerate(rows.tolist()):
        f, block = field.features[row], Block(Kind.MAP, row)
        held = block in h.state
        position = h.state.mean[h.state.span(block)].copy() if held else field.position[row].copy()
        existence = there.get(row, float(field.existence[row]))
        features.append(MapFeature(f.id, f.name, True, existence, float(visible[n]), f.target, position))
        columns.append(h.state.columns(block) if held else None)
    return features, [f.position for f in features], columns


def _told(state: State, field: Field) -> Rows:
    """Rows of the map's features worth telling of: all, or of a large map those in the state and the target."""
    if len(field.features) <= WHOLE_MAP:
        return np.arange(len(field.features), dtype=np.int64)
    targets = [row for row, f in enumerate(field.features) if f.target]
    return np.array(sorted({*state.ids(Kind.MAP), *targets}), dtype=np.int64)


def _map_covariance(state: State, field: Field | None, rows: Rows, columns: list[Indices | None]) -> Array:
    """Covariance (3 n, 3 n): the state's where the feature is in it, else the prior's own block."""
    full = np.zeros((3 * len(columns), 3 * len(columns)))
    held = [k for k, c in enumerate(columns) if c is not None]
    if held:
        to = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in held])
        at = np.concatenate([c for c in columns if c is not None])
        full[np.ix_(to, to)] = state.covariance[np.ix_(at, at)]
    for k, c in enumerate(columns):
        if c is None and field is not None:
            row = rows[k : k + 1]
            full[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = field.covariance(row, row)
    return full


def status_message(stamp_ns: int, verdict: Verdict, h: Hypothesis, target: Target | None) -> LocalizationStatus:
    """The verdict and the target; without a target, or without a pose, an unknown one (id -1)."""
    unknown = 1e8 * np.eye(3)  # m^2
    t = target or Target(-1, np.zeros(3), unknown, np.zeros(3), unknown)
    since = -1.0 if verdict.since_ns is None else seconds(stamp_ns - verdict.since_ns)
    return LocalizationStatus(
        stamp_ns,
        "map",
        verdict.matched,
        verdict.state,
        verdict.posterior,
        len(h.rows),
        t.id,
        float(np.sqrt(t.body @ t.body)),
        float(np.arctan2(t.body[1], t.body[0])) if target else 0.0,
        since,
        verdict.reason,
        t.position,
        t.covariance,
        t.body,
        t.body_covariance,
    )
