"""What the tracker shows: infants and features now, in odom."""

from __future__ import annotations

import numpy as np

from fbn_common.records import Stage, TrackedFeature, TrackedFeatures
from fbn_common.types import Array, Mat4, Vec3
from fbn_tracking.elevation import likelier_side
from fbn_tracking.gating import anchored_place
from fbn_tracking.geometry import anchored_point
from fbn_tracking.matching import Joint, feature_key, pose_key
from fbn_tracking.modes import Surroundings
from fbn_tracking.nursery import Nursery
from fbn_tracking.track import Track, pose_matrix
from fbn_tracking.window import Window

_SHOWN = 2  # detections from which an infant is worth showing


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


def _record(track: Track, stage: Stage, point: Array, covariance: Array, move: Mat4) -> TrackedFeature:
    R = move[:3, :3]
    return TrackedFeature(
        track.key,
        stage,
        track.seen,
        track.first_seen_ns,
        track.last_seen_ns,
        R @ point + move[:3, 3],
        R @ covariance @ R.T,
    )


def _infant(track: Track, move: Mat4) -> TrackedFeature:
    mode = track.modes[0]
    stage = Stage.FEATURE if track.memory is not None else Stage.INFANT
    return _record(track, stage, mode.point, mode.covariance[:3, :3], move)


def sided(window: Window, track: Track, around: Surroundings) -> Vec3:
    """A feature's r, phi, theta, on the likelier side where the smoother has swung off the one it graduated on.

    The system holds neither floor nor surface, so that nothing but ranges keeps it there; composites choose anew.
    """
    q = window.estimate.q(track.key)
    swung = bool(track.modes) and q[2] * track.modes[0].x[2] < 0.0
    return likelier_side(track, q, around) if swung and around.feature.elevation == "cubic" else q


def _feature(window: Window, track: Track, around: Surroundings, joint: Joint | None, move: Mat4) -> TrackedFeature:
    ka, kf = pose_key(track.anchor), feature_key(track.key)
    T_anchor, q, first = window.T(track.anchor), sided(window, track, around), track.detections[0]
    if joint is not None and ka in joint.offset and kf in joint.offset:
        at, a, c = joint.offset, first.z[4], first.z[5]
        point, covariance = anchored_place(T_anchor, first.look.mount, q, joint.covariance, at[ka], at[kf], a, c)
    else:
        point, _, _ = anchored_point(T_anchor, first.look.mount, q)
        covariance = track.modes[0].covariance[:3, :3] if track.modes else np.eye(3)
    return _record(track, Stage.RETIRED if track.retired else Stage.FEATURE, point, covariance, move)
