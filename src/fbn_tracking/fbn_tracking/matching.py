"""Which echo belongs to whom: predictions of features and infants, energy gates, one joint assignment per scan."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi
from typing import NamedTuple

import numpy as np

from fbn_common.types import NS, Array
from fbn_tracking.assignment import assign
from fbn_tracking.gating import pair_costs, predict_anchored, predict_points
from fbn_tracking.modes import heading_bound
from fbn_tracking.track import Detection, Look, Track, array_pose
from fbn_tracking.window import Window

Key = tuple[str, int]
DRIFT: Key = ("drift", 0)


def pose_key(index: int) -> Key:
    """Name of the pose of ping ``index`` in a joint covariance."""
    return ("pose", index)


def feature_key(key: int) -> Key:
    """Name of a feature in a joint covariance."""
    return ("feature", key)


class Prediction(NamedTuple):
    """What a look should measure of one track (at one of its elevations): r, phi, u and their covariance."""

    track: Track
    z: Array  # (3,)
    S: Array  # (3, 3), without the echo's own noise


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """An echo given to a track, with its innovation in r and phi; ``evidence``: log likelihood ratio to clutter."""

    prediction: Prediction
    echo: int
    innovation: Array  # (2,)
    sigma: Array  # (2,)
    nis: float
    evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Joint covariance of a pose, its features and their anchors; offsets by key."""

    covariance: Array
    offset: dict[Key, int]

    @classmethod
    def of(cls, window: Window, index: int, tracks: list[Track]) -> Joint:
        """From the window's smoother, for ping ``index``; the drift comes along.

        A ping that the smoother has not taken in yet is propagated from the one before by its link.
        """
        fresh = not window.smoothed(index)
        anchors = dict.fromkeys([index - fresh, *(t.anchor for t in tracks)])
        keys = [*map(pose_key, anchors), DRIFT, *(feature_key(t.key) for t in tracks)]
        sizes = [6] * len(anchors) + [3] * (1 + len(tracks))
        starts = np.concatenate(([0], np.cumsum(sizes)[:-1]))
        covariance = window.joint(index - fresh, tracks)
        joint = cls(covariance, {k: int(s) for k, s in zip(keys, starts, strict=True)})
        return joint.propagated(window, index) if fresh else joint

    def propagated(self, window: Window, index: int) -> Joint:
        """With the pose of ping ``index`` appended, by its link to the one before."""
        F, B, Q = window.transition(index)
        n, x, b = len(self.covariance), self.offset[pose_key(index - 1)], self.offset[DRIFT]
        M = np.vstack((np.eye(n), np.zeros((6, n))))
        M[n:, x : x + 6], M[n:, b : b + 3] = F, B
        covariance = M @ self.covariance @ M.T
        covariance[n:, n:] += Q
        return Joint(covariance, {**self.offset, pose_key(index): n})

    def block(self, keys: list[Key], sizes: list[int]) -> Array:
        """Covariance of some of the variables, in this order."""
        at = np.array([self.offset[k] + i for k, n in zip(keys, sizes, strict=True) for i in range(n)])
        return np.asarray(self.covariance[at[:, None], at])


def predict_feature(window: Window, track: Track, look: Look, joint: Joint) -> Prediction:
    """A feature of the graph as a look should see it, with the full joint uncertainty."""
    first, at = track.detections[0], joint.offset
    z, S = predict_anchored(
        window.T(track.anchor), window.T(look.index), first.look.mount, look.mount, window.estimate.q(track.key),
        joint.covariance, at[pose_key(track.anchor)], at[pose_key(look.index)], at[feature_key(track.key)],
        look.limits[4], look.limits[5],
    )  # fmt: skip
    return Prediction(track, z, S)


def predict_infants(window: Window, tracks: list[Track], look: Look) -> list[Prediction]:
    """Infants as a look should see them: one prediction per elevation still possible."""
    pairs = [(track, mode) for track in tracks for mode in track.modes]
    if not pairs:
        return []
    pings, ping = window.pings, window.pings[look.index]
    since = [pings[reference(window, track)] for track, _ in pairs]
    t = (ping.stamp_ns - np.array([before.stamp_ns for before in since])) / NS
    extra = np.abs(ping.travelled - np.concatenate([before.travelled for before in since]).reshape(-1, 2))
    extra[:, 1] = np.minimum(extra[:, 1], heading_bound(ping))
    R, p = array_pose(window.T(look.index), look.mount)
    points = np.concatenate([m.point for _, m in pairs]).reshape(-1, 3)
    slack = np.concatenate([m.x[3:] for _, m in pairs]).reshape(-1, 2)
    covariance = np.concatenate([m.covariance for _, m in pairs]).reshape(-1, 5, 5)
    z, S = predict_points(points, slack, covariance, t, extra, R, p, look.limits[4], look.limits[5])
    return [Prediction(track, z[i], S[i]) for i, (track, _) in enumerate(pairs)]


def view_weights(predictions: list[Prediction], look: Look) -> list[float]:
    """How well a look should see what it predicts at r, phi, u: ``exp(-u^2 / 2)`` in its field of view, else 0."""
    if not predictions:
        return []
    r, phi, u = np.array([p.z for p in predictions]).T
    low, high, left, right = look.limits[:4]
    inside = (low <= r) & (r <= high) & (left <= phi) & (phi <= right)
    weights: list[float] = np.where(inside, np.exp(-0.5 * u**2), 0.0).tolist()
    return weights


def reference(window: Window, track: Track) -> int:
    """Index of the ping to which an infant's place refers."""
    return track.anchor if track.detections else window.first


def clutter_cost(look: Look, echo: Detection, clutter: float) -> float:
    """Twice the minus log density, in units of the echo's own noise, of ``clutter`` false echoes in the whole view."""
    low, high, left, right = look.limits[:4]
    density = clutter / ((high - low) * (right - left)) * echo.z[2] * echo.z[3]
    return -2.0 * log(2.0 * pi * max(density, 1e-12))


def match(
    predictions: list[Prediction], echoes: list[Detection], look: Look, gate: float, clutter: float
) -> list[Match]:
    """The best joint one-to-one assignment of a scan's echoes; ``gate`` on the energy increase."""
    if not predictions or not echoes:
        return []
    z, S = np.array([p.z for p in predictions]), np.array([p.S for p in predictions])
    energy, nis, volume = pair_costs(z, S, np.array([e.z for e in echoes]))
    existence = np.array([1.0 if p.track.graduated else p.track.existence for p in predictions])
    known = look.detection_probability * np.maximum(existence, 1e-3)
    costs = energy + volume - 2.0 * np.log(known)[:, None]
    costs[~(energy <= gate)] = np.inf
    starts = track_starts(predictions)
    best = np.minimum.reduceat(costs, starts, axis=0)
    new = clutter_cost(look, echoes[0], clutter)
    matches = []
    for j, i in assign(best, new).items():
        row = int(starts[i] + np.argmin(costs[starts[i] : starts[i + 1] if i + 1 < len(starts) else None, j]))
        e, R = echoes[j].z[:2] - z[row, :2], echoes[j].z[2:4] ** 2
        sigma = np.sqrt(np.diag(S[row])[:2] + R)
        evidence = 0.5 * (new - nis[row, j] - volume[row, j]) + log(look.detection_probability)
        matches.append(Match(predictions[row], j, e, sigma, float(nis[row, j]), float(evidence)))
    return sorted(matches, key=lambda m: m.echo)


def track_starts(predictions: list[Prediction]) -> list[int]:
    """The first row of each track: its elevations follow one another."""
    tracks = [p.track for p in predictions]
    return [i for i, track in enumerate(tracks) if i == 0 or track is not tracks[i - 1]]
