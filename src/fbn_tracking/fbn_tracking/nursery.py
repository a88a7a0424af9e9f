"""Infants: born of unmatched echoes, kept at their likeliest place, graduated on information, or dead after a while."""

from __future__ import annotations

from collections import Counter
from math import dist, log

import numpy as np

from fbn_common import chi_square
from fbn_common.types import NS, Mat2, Mat3
from fbn_tracking.infants import slack_covariance
from fbn_tracking.modes import Surroundings, find_modes
from fbn_tracking.motion_check import of_track
from fbn_tracking.parameters import TrackingParameters
from fbn_tracking.track import Detection, Track
from fbn_tracking.window import Window

_STALE = 0.05  # m, the range's own sigma: by how much the way since its first echo may have changed under an infant
_CERTAIN = 50.0  # score of what has graduated once
_SIZE = 0.05  # m, of a thing
_SAME_PLACE = float(chi_square.bound(0.99, 2))
_AGAIN = 4  # detections in a new window after which a known feature is in the graph again


class Nursery:
    """All tracks that are not in the graph."""

    def __init__(self, parameters: TrackingParameters) -> None:
        self.parameters = parameters
        self.infants: dict[int, Track] = {}
        self.counts: Counter[str] = Counter()
        self._next_key = 1

    def born(self, detection: Detection) -> None:
        """A new infant from one echo; beyond the limit the least likely infant makes room."""
        array = self.parameters.arrays[detection.look.array]
        score = log(array.detection_probability / (array.detection_probability + self.parameters.infant.clutter))
        key, stamp = self._next_key, detection.stamp_ns
        self._next_key += 1
        self.infants[key] = Track(key, stamp, stamp, 1, score, [detection])
        self.counts["infants_born"] += 1
        if len(self.infants) > self.parameters.infant.limit:
            worst = min(self.infants.values(), key=lambda t: (t.score, t.last_seen_ns, t.key))
            del self.infants[worst.key]
            self.counts["infants_over_limit"] += 1

    def take_back(self, track: Track) -> None:
        """A feature seen on both sides of a cut: found again by its memory, under its own key."""
        track.graduated, track.score = False, _CERTAIN
        self.infants[track.key] = track

    def clear(self) -> None:
        """Forget all infants: a new chain has nothing to do with them."""
        self.counts["infants_dropped"] += len(self.infants)
        self.infants.clear()

    def refresh(self, tracks: list[Track], around: Surroundings) -> None:
        """Move tracks to their likeliest places, given the poses; ask those that may graduate whether they move."""
        for track in tracks:
            track.modes, track.placed_drift = find_modes(track, around), around.drift
            if track.memory is None and len(track.detections) >= self.parameters.infant.detections_at_end:
                track.motion = of_track(track, around)

    def follow(self, window: Window, drift_covariance: Mat3) -> None:
        """Place infants anew whose way to here the smoother has changed since, as it learnt the drift."""
        drift, now_ns = window.drift().tolist(), window.pings[window.last].stamp_ns
        left = [t for t in self.infants.values() if _moved(t, drift, now_ns) > _STALE]
        if left:
            self.refresh(left, self.around(window, drift_covariance))

    def around(self, window: Window, drift_covariance: Mat3) -> Surroundings:
        """The poses as they now are."""
        return Surroundings(
            window.estimate.poses(),
            window.pings,
            slack(window, drift_covariance),
            self.parameters.feature,
            window.drift().tolist(),
        )

    def tend(self, window: Window, now_ns: int) -> None:
        """Graduate who is ready, delete who was not seen for long, retire features out of view."""
        for track in list(self.infants.values()):
            expired = (now_ns - track.last_seen_ns) / NS > self.parameters.infant.lifetime
            if self.ready(track, expired):
                self._graduate(window, track)
            elif expired:
                del self.infants[track.key]
                self.counts["infants_died"] += 1
        for track in window.features.values():
            track.retired |= (now_ns - track.last_seen_ns) / NS > self.parameters.retire

    def graduate_remaining(self, window: Window) -> None:
        """At the end of a chain: whoever could graduate does."""
        for track in list(self.infants.values()):
            if self.ready(track, True):
                self._graduate(window, track)

    def ready(self, track: Track, expired: bool) -> bool:
        """Whether a track has the information, the evidence and the steadiness of a feature."""
        par, n = self.parameters.infant, len(track.detections)
        if track.memory is not None:
            return n >= (1 if expired else _AGAIN)
        if n < (par.detections_at_end if expired else par.detections) or not track.modes or track.score < par.score:
            return False
        mode = track.modes[0]
        undecided = len(track.modes) > 1 and n < par.detections + par.patience and not expired
        return not undecided and self.informed(mode.given_poses) and self.static(mode.static, n) and self.still(track)

    def informed(self, covariance: Mat3) -> bool:
        """Whether the information in the three Cartesian directions suffices (IROS 2007, III)."""
        par = self.parameters.infant
        horizontal = float(np.linalg.eigvalsh(covariance[:2, :2])[1])
        return horizontal <= par.sigma_horizontal**2 and float(covariance[2, 2]) <= par.sigma_vertical**2

    def static(self, energy: float, n: int) -> bool:
        """Whether ``n`` detections of one static target may have this energy: chi-square with 2 n - 3 dof."""
        passed = energy <= float(chi_square.bound(self.parameters.infant.static_probability, 2 * n - 3))
        if not passed:
            self.counts["static_world_refusals"] += 1
        return passed

    def still(self, track: Track) -> bool:
        """Whether its echoes move as the vehicle's motion alone would move them."""
        moving = track.motion is not None and track.motion.moving(self.parameters.infant.still_probability)
        if moving:
            self.counts["motion_refusals"] += 1
        return not moving

    def take_out_moving(self, window: Window) -> None:
        """Take out of the graph the features that their later echoes show to move.

        A lone thing that moves steadily looks like an error of dead reckoning, and makes the smoother believe so: it is
        asked by dead reckoning's poses and the drift as it was known without any feature.
        """
        if not window.features:
            return
        around = Surroundings(
            window.dead_reckoned(),
            window.pings,
            slack(window, window.base.covariance[4:, 4:]),
            self.parameters.feature,
        )
        checks = {key: of_track(track, around) for key, track in window.features.items()}
        moving = [key for key, c in checks.items() if c and c.moving(self.parameters.infant.static_probability)]
        if moving:
            window.give_up(moving)
            window.update()
            self.counts["features_taken_out"] += len(moving)

    def twin(self, window: Window, track: Track) -> bool:
        """Whether a feature of the graph is the same thing: there within its errors, and never seen beside it.

        Two things a metre apart are two echoes of one look sooner or later.
        """
        mode, seen = track.modes[0], {(d.look.index, d.look.array) for d in track.detections}
        for other in window.features.values():
            beside = seen & {(d.look.index, d.look.array) for d in other.detections}
            apart = (mode.point - window.place(other))[:2]
            covariance = 2.0 * mode.given_poses[:2, :2] + _SIZE**2 * np.eye(2)
            if not beside and float(apart @ np.linalg.solve(covariance, apart)) < _SAME_PLACE:
                return True
        return False

    def _graduate(self, window: Window, track: Track) -> None:
        del self.infants[track.key]
        if track.memory is None and self.twin(window, track):
            self.counts["twins_dropped"] += 1
            return
        track.score = _CERTAIN
        window.add_feature(track, track.modes[0].x[:3].copy())
        self.counts["graduated_again" if track.memory is not None else "graduated"] += 1


def _moved(track: Track, drift: list[float], now_ns: int) -> float:
    """How far the way since a track's first echo of the window has moved under it, with the drift [m]."""
    since = track.detections[0].stamp_ns if track.detections else track.last_seen_ns
    return dist(drift, track.placed_drift) * (now_ns - since) / NS


def slack(window: Window, drift_covariance: Mat3) -> Mat2:
    """How far the drift may still be wrong, in the world's x and y [m^2/s^2]."""
    return slack_covariance(drift_covariance, window.T(window.last)[:2, 0])
