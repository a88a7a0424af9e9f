"""A window's old part as one Gaussian: the composite measurement.

The part is optimised once more by itself, linearised, reduced by QR to the variables that matter, and expressed in
Cartesian coordinates relative to the base (IROS 2007, V).  The base is shared with the window before: what is
known of it from there enters as a stated prior, to be divided out again by who holds that knowledge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbn_common.lie import rpy_from_matrix, rpy_jacobian
from fbn_common.records import CompositeFeature, CompositeMeasurement
from fbn_common.types import Array, Vec2
from fbn_tracking.elevation import Elevation, elevation_posterior, told
from fbn_tracking.gating import beam_weights
from fbn_tracking.geometry import anchored_point, elevation_scale
from fbn_tracking.heading import turned, turned_prior
from fbn_tracking.modes import Surroundings, find_modes
from fbn_tracking.parameters import FeatureParameters
from fbn_tracking.solver import Solution, solve
from fbn_tracking.swept import swept_area
from fbn_tracking.system import Estimate, State, System
from fbn_tracking.track import Look, Ping, Track, stack_poses
from fbn_tracking.window import Window

_FLIPPED = 0.05  # rad: elevations that differ less are the same


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The old part of a window after its own optimisation; ``root @ root.T`` is the covariance of its outputs.

    Outputs in order: base z, roll, pitch, yaw | P2 x, y, z, roll, pitch, yaw | features xyz | drift; x and y
    relative to the base.
    """

    window: Window
    pings: dict[int, Ping]
    tracks: list[Track]  # with a detection in this part
    estimate: Estimate
    mean: Array
    covariance: Array

    @property
    def base_xy(self) -> Vec2:
        """Of the window's own world [m]."""
        return np.asarray(self.estimate.T(self.window.first)[:2, 3])


def marginalise(window: Window, last: int, slack: Array, feature: FeatureParameters) -> Part:
    """Optimise the part up to ping ``last`` by itself and reduce it to base, P2, features, drift.

    Raises RuntimeError where the system is indeterminate.
    """
    pings = {index: ping for index, ping in window.pings.items() if index <= last}
    system, rows = window.system.part(len(pings))
    features = list(window.features.values())
    tracks = [old_part(features[row], last) for row in rows]
    whole = window.estimate.state
    state = State(whole.T[: len(pings)], whole.drift, whole.q[rows])
    names = {track.key: row for row, track in enumerate(tracks)}
    start = flip_unlikely(Estimate(state, window.first, names), tracks, pings, slack, feature)
    solution, estimate = _solve(system, start)
    swung = [t for t in tracks if abs(estimate.q(t.key)[2] - start.q(t.key)[2]) > _FLIPPED]
    again = flip_unlikely(estimate, swung, pings, slack, feature)
    if again is not estimate:
        solution, estimate = _solve(system, again)
    poses = estimate.poses()
    around = Surroundings(poses, pings, slack, feature)
    cubic = [t for t in tracks if feature.elevation == "cubic"]  # the linear model's is the Gaussian that it says
    elevations = [elevation_posterior(t, float(estimate.q(t.key)[2]), around) for t in cubic]
    mean, covariance = reduce(solution, estimate, last, tracks, elevations)
    return Part(window, pings, tracks, estimate, mean, covariance)


def old_part(track: Track, last: int) -> Track:
    """The track as the pings up to ``last`` know it."""
    detections = [d for d in track.detections if d.index <= last]
    misses = [look for look in track.misses if look.index <= last]
    return Track(
        track.key, detections[0].stamp_ns, detections[-1].stamp_ns, len(detections), track.score, detections, misses
    )


def _solve(system: System, start: Estimate) -> tuple[Solution, Estimate]:
    solution = solve(system, start.state, (0, system.motion.size - 1), exact=True)
    return solution, replace(start, state=solution.state)


def flip_unlikely(
    estimate: Estimate, tracks: list[Track], pings: dict[int, Ping], slack: Array, feature: FeatureParameters
) -> Estimate:
    """With features moved to the likelier elevation, given these poses; the same estimate if there are none."""
    around, q = Surroundings(estimate.poses(), pings, slack, feature), estimate.state.q.copy()
    for track in tracks:
        row, likeliest = estimate.rows[track.key], find_modes(track, around)[0].x[2]
        if q[row, 2] * likeliest < 0.0 and abs(q[row, 2] - likeliest) >= _FLIPPED:
            q[row, 2] = likeliest
    moved = bool((q != estimate.state.q).any())
    return replace(estimate, state=estimate.state._replace(q=q)) if moved else estimate


def reduce(
    solution: Solution, estimate: Estimate, last: int, tracks: list[Track], elevations: Sequence[Elevation | None] = ()
) -> tuple[Array, Array]:
    """Mean and covariance of a part's outputs, by the square root of the joint of the variables behind them.

    ``elevations``: of each track, where its place over all elevations is known better than the graph holds it.
    """
    first = estimate.first
    indices = list(dict.fromkeys([first, last, *(t.anchor for t in tracks)]))
    root = solution.root(solution.layout.columns([i - first for i in indices], range(len(tracks))))
    offset = {index: 6 * n for n, index in enumerate(indices)}
    n_drift = 6 * len(indices)
    poses = {index: estimate.T(index) for index in indices}
    mean, J = np.empty(13 + 3 * len(tracks)), np.zeros((13 + 3 * len(tracks), len(root)))
    base, p2 = offset[first], offset[last]
    mean[0], mean[1:4] = poses[first][2, 3], rpy_from_matrix(np.ascontiguousarray(poses[first][:3, :3]))
    J[:4, base : base + 6] = pose_rows(poses[first])[2:]
    mean[4:7], mean[7:10] = poses[last][:3, 3], rpy_from_matrix(np.ascontiguousarray(poses[last][:3, :3]))
    J[4:10, p2 : p2 + 6] = pose_rows(poses[last])
    for n, track in enumerate(tracks):
        rows, at, f = slice(10 + 3 * n, 13 + 3 * n), offset[track.anchor], n_drift + 3 + 3 * n
        q, seen = estimate.q(track.key), track.detections[0]
        mean[rows], J[rows, at : at + 6], by_q = anchored_point(poses[track.anchor], seen.look.mount, q)
        by_q[:, 2] *= elevation_scale(q[2], float(np.sqrt((root[f + 2] ** 2).sum())), *seen.z[4:])
        J[rows, f : f + 3] = by_q
    mean[-3:], J[-3:, n_drift : n_drift + 3] = estimate.state.drift, np.eye(3)
    for row in [4, 5, *(10 + 3 * n + axis for n in range(len(tracks)) for axis in (0, 1))]:
        axis = (row - 4) % 3 if row < 10 else (row - 10) % 3
        mean[row] -= poses[first][axis, 3]
        J[row, base + 3 : base + 6] -= poses[first][axis, :3]
    columns, beyond = [], np.zeros((len(mean), len(mean)))
    for n, known in enumerate(elevations):
        if known is not None:
            rows = slice(10 + 3 * n, 13 + 3 * n)
            mean[rows] += known.shift
            root, column, beyond[rows, rows] = told(root, J, n_drift + 5 + 3 * n, rows, known.spread)
            columns.append(column)
    S = np.column_stack((J @ root, *columns))
    return mean, S @ S.T + beyond


def pose_rows(T: Array) -> Array:
    """Derivative (6, 6) of x, y, z, roll, pitch, yaw by the pose's tangent (rotation, translation, in the body)."""
    rows = np.zeros((6, 6))
    rows[:3, 3:] = T[:3, :3]
    rows[3:, :3] = rpy_jacobian(rpy_from_matrix(np.ascontiguousarray(T[:3, :3])))
    return rows


def compose(part: Part, sequence: int, cell_size: float, frame_id: str) -> CompositeMeasurement:
    """The composite measurement of a part."""
    pings = list(part.pings.values())
    first, last = pings[0], pings[-1]
    base = part.window.base
    looks = [look for ping in pings if ping is not first or base.fresh for look in ping.looks]
    R, p = stack_poses(looks, part.estimate.poses())
    mean, covariance = turned(part.mean, 0.5 * (part.covariance + part.covariance.T), base)
    limits = [look.limits for look in looks]
    return CompositeMeasurement(
        stamp_ns=last.stamp_ns,
        frame_id=frame_id,
        sequence=sequence,
        start_ns=first.stamp_ns,
        first=base.fresh,
        pings=len(pings),
        distance_travelled=travelled(part.estimate.state.T),
        drift_time_constant=last.motion.drift_time_constant,
        features=tuple(_feature(track, part, looks, R, p) for track in part.tracks),
        swept=swept_area(list(zip(R, p, limits, strict=True)), part.base_xy, cell_size),
        mean=mean,
        covariance=covariance,
        prior_mean=base.mean,
        prior_covariance=turned_prior(base),
        base_odom=first.motion.pose,
        p2_odom=last.motion.pose,
    )


def travelled(T: Array) -> float:
    """Length of the path along poses (n, 4, 4) [m]."""
    return float(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum())


def _feature(track: Track, part: Part, looks: list[Look], R: Array, p: Array) -> CompositeFeature:
    number = part.tracks.index(track)
    point = part.mean[10 + 3 * number : 13 + 3 * number] + np.array([*part.base_xy, 0.0])
    expected = beam_weights(point, R, p, np.array([look.limits for look in looks])).sum() if looks else 0.0
    return CompositeFeature(track.key, track.seen, float(expected), track.first_seen_ns, track.last_seen_ns)
