"""What the tracker shows: infants and features now, in odom."""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np

from fbn_common.records import Stage, TrackedFeature, TrackedFeatures
from fbn_common.types import Array, Mat4, Vec3
from fbn_tracking.elevation import both_sides, likelier_side
from fbn_tracking.gating import anchored_place
from fbn_tracking.geometry import anchored_point
from fbn_tracking.matching import Joint, feature_key, pose_key
from fbn_tracking.modes import SAME, Surroundings
from fbn_tracking.nursery import Nursery
from fbn_tracking.track import Track, pose_matrix
from fbn_tracking.window import Window

_SHOWN = 2  # detections from which an infant is worth showing
_FAR = 50.0  # of costs: less likely than this makes no difference


class Rival(NamedTuple):
    """The other elevation at which a track may lie; probability 0 where there is none."""

    probability: float = 0.0
    point: Vec3 = np.zeros(3)  # in the world

    @classmethod
    def of(cls, point: Vec3, cost: float, than: float) -> Rival:
        """By what it costs against the elevation that is shown (minus log posteriors)."""
        return cls(1.0 / (1.0 + exp(min(cost - than, _FAR))), point)


def tracked_features(
    window: Window, nursery: Nursery, joint: Joint | None, pings: int, frame_id: str
) -> TrackedFeatures:
    """All features of the window and the infants seen more than once, relative to the vehicle, carried to odom."""
    motion = window.pings[window.last].motion
    move = pose_matrix(motion.pose) @ np.linalg.inv(window.T(window.last))
    around = Surroundings(window.estimate.poses(), window.pings, np.zeros((2, 2)), nursery.parameters.feature)
    shown = [_feature(window, track, around, joint, move) for track in window.features.values()]
    young = sorted(nursery.infants.values(), key=lambda t: t.key)
    shown += [_infant(t, move) for t in young if t.modes and (t.seen >= _SHOWN or t.memory is not None)]
    return TrackedFeatures(motion.stamp_ns, frame_id, pings, tuple(shown))


def _record(track: Track, stage: Stage, point: Array, covariance: Array, rival: Rival, move: Mat4) -> TrackedFeature:
    R, t = move[:3, :3], move[:3, 3]
    return TrackedFeature(
        track.key,
        stage,
        track.seen,
        track.first_seen_ns,
        track.last_seen_ns,
        R @ point + t,
        R @ covariance @ R.T,
        rival.probability,
        R @ rival.point + t if rival.probability else np.zeros(3),
    )


def _infant(track: Track, move: Mat4) -> TrackedFeature:
    mode, others = track.modes[0], track.modes[1:]
    stage = Stage.FEATURE if track.memory is not None else Stage.INFANT
    rival = Rival.of(others[0].point, others[0].cost, mode.cost) if others else Rival()
    return _record(track, stage, mode.point, mode.covariance[:3, :3], rival, move)


def sided(window: Window, track: Track, around: Surroundings) -> Vec3:
    """A feature's r, phi, theta, on the likelier side where the smoother has swung off the one it graduated on.

    The system holds neither floor nor surface, so that nothing but ranges keeps it there; composites choose anew.
    """
    q = window.estimate.q(track.key)
    swung = bool(track.modes) and q[2] * track.modes[0].x[2] < 0.0
    return likelier_side(track, q, around) if swung and around.feature.elevation == "cubic" else q


def rival_of(track: Track, q: Vec3, around: Surroundings) -> Rival:
    """The other elevation of a feature that graduated with both, where it is still likely enough to be carried.

    ``q``: r, phi, theta as shown.  The poses stay as they are.
    """
    if len(track.modes) < 2 or 2.0 * abs(q[2]) <= SAME:
        return Rival()
    points, costs = both_sides(track, q, around)
    carried = costs[1] - costs[0] < around.feature.mode_gap
    return Rival.of(points[1], float(costs[1]), float(costs[0])) if carried else Rival()


def _feature(window: Window, track: Track, around: Surroundings, joint: Joint | None, move: Mat4) -> TrackedFeature:
    ka, kf = pose_key(track.anchor), feature_key(track.key)
    T_anchor, q, first = window.T(track.anchor), sided(window, track, around), track.detections[0]
    if joint is not None and ka in joint.offset and kf in joint.offset:
        at, a, c = joint.offset, first.z[4], first.z[5]
        point, covariance = anchored_place(T_anchor, first.look.mount, q, joint.covariance, at[ka], at[kf], a, c)
    else:
        point, _, _ = anchored_point(T_anchor, first.look.mount, q)
        covariance = track.modes[0].covariance[:3, :3] if track.modes else np.eye(3)
    stage = Stage.RETIRED if track.retired else Stage.FEATURE
    return _record(track, stage, point, covariance, rival_of(track, q, around), move)
