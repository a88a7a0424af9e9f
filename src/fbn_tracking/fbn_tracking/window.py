"""One window of the tracking graph: a chain of poses, the drift, the features seen; smoothed with gtsam's ISAM2.

Everything the graph holds is also kept here as plain records, so that it can be built anew: for the cut, for a
re-linearisation, and after any numerical failure.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gtsam
import numpy as np

from fbn_common.records import PingMotion
from fbn_common.types import Array, Mat3, Vec3
from fbn_tracking import factors
from fbn_tracking.factors import DRIFT, feature_key, pose_key
from fbn_tracking.infants import missing_curvature
from fbn_tracking.solver import solve
from fbn_tracking.track import Detection, Ping, Track, array_pose

_LEAST_DRIFT = 1e-8  # m^2/s^2


@dataclass(frozen=True, slots=True, eq=False)
class Base:
    """What is put in from outside at a window's first pose: z, roll, pitch, yaw and drift (7), and its covariance.

    ``fresh``: the first of a chain, whose own earth measurement belongs to the window too.  ``deviation``: variance
    of yaw's error that stays [rad^2]; the covariance is that given this error.
    """

    pose: gtsam.Pose3
    mean: Array
    covariance: Array
    fresh: bool
    deviation: float = 0.0


@dataclass(slots=True, eq=False)
class Window:
    """Poses, features and estimate of one window; ``pings`` by index, in order."""

    base: Base
    pings: dict[int, Ping]
    weak_theta_sigma: float
    features: dict[int, Track] = field(default_factory=dict)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    failures: int = 0
    _isam: Any = None
    _new_factors: Any = field(default_factory=gtsam.NonlinearFactorGraph)
    _new_values: gtsam.Values = field(default_factory=gtsam.Values)

    @property
    def first(self) -> int:
        """Index of the base's ping."""
        return next(iter(self.pings))

    @property
    def last(self) -> int:
        """Index of the latest ping."""
        return next(reversed(self.pings))

    def pose(self, index: int) -> gtsam.Pose3:
        """The estimate of a pose."""
        return self.values.atPose3(pose_key(index))

    def drift(self) -> Vec3:
        """The estimate of the drift (3) [m/s]."""
        return np.asarray(self.values.atPoint3(DRIFT))

    def poses(self) -> dict[int, gtsam.Pose3]:
        """All poses by index."""
        return {index: self.pose(index) for index in self.pings}

    def start(self, values: gtsam.Values | None = None) -> None:
        """Begin with all poses of ``pings``; initial values by dead reckoning where none are given."""
        self.values = values or dead_reckoned(self.base, list(self.pings.values()))
        self._isam = None

    def add_ping(self, ping: Ping) -> None:
        """Append a pose with its link and earth measurement."""
        pose = propagate(self.pose(self.last), self.drift(), ping)
        self.pings[ping.index] = ping
        self._introduce(pose_key(ping.index), pose)
        for factor in ping_factors(ping):
            self._new_factors.add(factor)

    def add_feature(self, track: Track, q: Vec3) -> None:
        """Bring in a feature at ``q`` with all its detections."""
        track.graduated = True
        self.features[track.key] = track
        self._introduce(feature_key(track.key), q)
        for detection in track.detections:
            self._new_factors.add(detection_factor(track, detection, self.weak_theta_sigma, True))

    def add_detection(self, track: Track, detection: Detection) -> None:
        """One more detection of a feature of this window."""
        track.detections.append(detection)
        self._new_factors.add(detection_factor(track, detection, self.weak_theta_sigma, True))

    def update(self) -> None:
        """Smooth; a numerical failure rebuilds the window from its records, and is counted."""
        try:
            if self._isam is None:
                self._rebuild()
            else:
                self._isam.update(self._new_factors, self._new_values)  # the next ping's re-linearises what still moves
                self._accept(self._isam.calculateEstimate())
        except RuntimeError:
            self.failures += 1
            self._isam = None
            self._recover()
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def smoothed(self, index: int) -> bool:
        """Whether the smoother has taken in this ping."""
        return self._isam is not None and not self._new_values.exists(pose_key(index))

    def transition(self, index: int) -> tuple[Array, Array, Array]:
        """How a pose follows from the one before and the drift: Jacobians (6, 6), (6, 3), noise (6, 6)."""
        ping, before, here = self.pings[index], self.pose(index - 1).matrix(), self.pose(index).matrix()
        _, H1, H2, Hb = factors.link_kernel(
            before, here, self.drift(), ping.increment, ping.R_increment, ping.dt, ping.link_whitener
        )
        inverse = np.linalg.inv(H2)
        return -inverse @ H1, -inverse @ Hb, inverse @ inverse.T

    def joint(self, keys: list[int]) -> Array:
        """Joint covariance of some variables, in their order (poses 6 in gtsam's tangent, others 3)."""
        if self._isam is None:
            self.update()
        covariance = np.array(self._isam.jointMarginalCovariance(keys).fullMatrix())
        if not np.isfinite(covariance).all():
            raise RuntimeError("joint marginal is not finite")
        return covariance

    def graph(self, last: int, curved: bool = True) -> Any:
        """All factors of pings and detections up to ping ``last``, from the records."""
        return build_graph(self.base, self.pings.values(), self.features.values(), last, self.weak_theta_sigma, curved)

    def _introduce(self, key: int, value: Any) -> None:
        self.values.insert(key, value)
        if self._isam is not None:
            self._new_values.insert(key, value)

    def _accept(self, values: gtsam.Values) -> None:
        if not np.isfinite(values.atPose3(pose_key(self.last)).matrix()).all():
            raise RuntimeError("estimate is not finite")
        self.values = values

    def _rebuild(self) -> None:
        plain = self.graph(self.last, curved=False)
        start = solve(plain, self.values, partial(theta_curvature, list(self.features.values()))).values
        self._isam = new_isam()
        self._isam.update(self.graph(self.last), start)
        self._accept(self._isam.calculateEstimate())

    def _recover(self) -> None:
        """Build anew; if even that fails, go on with the motion alone, which cannot fail."""
        try:
            self._rebuild()
        except RuntimeError:
            self.failures += 1
            for track in self.features.values():
                track.retired = True
            self.features.clear()
            self.values = dead_reckoned(self.base, list(self.pings.values()))
            self._isam = new_isam()
            self._isam.update(self.graph(self.last), self.values)
            self._accept(self._isam.calculateEstimate())


def drift_prior(motion: PingMotion) -> Mat3:
    """Covariance (3, 3) [m^2/s^2] of the drift at a window's start: what dead reckoning states, kept invertible."""
    return np.asarray(motion.drift_covariance + _LEAST_DRIFT * np.eye(3))


def new_isam() -> Any:
    """An ISAM2 that re-linearises each kind of variable at its own threshold."""
    thresholds = gtsam.ISAM2ThresholdMap()
    thresholds.insert(("x", np.array([0.05] * 3 + [0.5] * 3)))
    thresholds.insert(("f", np.array([0.5, 0.03, 0.02])))
    thresholds.insert(("b", np.full(3, 0.5)))
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = 1
    return gtsam.ISAM2(parameters)


def propagate(pose: gtsam.Pose3, drift: Vec3, ping: Ping) -> gtsam.Pose3:
    """The pose at ``ping`` from that at the ping before, by increment and drift."""
    current = pose.rotation().matrix().T @ np.array([drift[0], drift[1], 0.0]) + np.array([drift[2], 0.0, 0.0])
    step = gtsam.Pose3(gtsam.Rot3(ping.R_increment), ping.increment + current * ping.dt)
    return pose.compose(step)


def dead_reckoned(base: Base, pings: list[Ping]) -> gtsam.Values:
    """Initial values of a chain: base, drift, and every pose by its link."""
    values, pose = gtsam.Values(), base.pose
    values.insert(DRIFT, base.mean[4:].copy())
    for number, ping in enumerate(pings):
        pose = propagate(pose, base.mean[4:], ping) if number else pose
        values.insert(pose_key(ping.index), pose)
    return values


def ping_factors(ping: Ping) -> list[Any]:
    """Link to the ping before, and the earth measurement where there is one."""
    link = factors.link_factor(
        ping.index - 1, ping.index, ping.increment, ping.R_increment, ping.dt, ping.link_whitener
    )
    return [link, *earth_factors(ping)]


def earth_factors(ping: Ping) -> list[Any]:
    """The earth measurement, none where nothing was learnt."""
    return [factors.earth_factor(ping.index, ping.earth_mean, ping.earth_whitener)] if ping.earth_whitener.any() else []


def detection_factor(track: Track, detection: Detection, weak_theta_sigma: float, curved: bool) -> Any:
    """The factor of one of a track's detections."""
    first = track.detections[0]
    if detection is first:
        return factors.first_detection_factor(track.key, detection.z, weak_theta_sigma, curved)
    return factors.detection_factor(
        first.index, detection.index, track.key, first.look.mount, detection.look.mount, detection.z, curved
    )


def theta_curvature(tracks: list[Track], values: gtsam.Values) -> dict[int, float]:
    """By feature: second derivative of the energy by theta, poses fixed, less what Gauss-Newton has of it."""
    missing, arrays = {}, {}
    for track in tracks:
        looks = [d.look for d in track.detections]
        for look in looks:
            if (look.index, look.array) not in arrays:
                arrays[look.index, look.array] = array_pose(values.atPose3(pose_key(look.index)), look.mount)
        R, p = (np.array([arrays[look.index, look.array][i] for look in looks]) for i in (0, 1))
        q, z = values.atPoint3(feature_key(track.key)), np.array([d.z for d in track.detections])
        missing[feature_key(track.key)] = missing_curvature(q, R, p, z)
    return missing


def build_graph(
    base: Base, pings: Iterable[Ping], tracks: Iterable[Track], last: int, weak_theta_sigma: float, curved: bool
) -> Any:
    """The graph of a window up to ping ``last``: gauge, prior at the base, links, earth, detections."""
    graph = gtsam.NonlinearFactorGraph()
    chain = [ping for ping in pings if ping.index <= last]
    first = chain[0]
    graph.add(factors.gauge_factor(first.index, base.pose.translation()[:2].copy()))
    graph.add(factors.base_factor(first.index, base.mean, factors.whitener(factors.inverse(base.covariance))))
    for factor in earth_factors(first) if base.fresh else []:
        graph.add(factor)
    for ping in chain[1:]:
        for factor in ping_factors(ping):
            graph.add(factor)
    for track in tracks:
        for detection in track.detections:
            if detection.index <= last:
                graph.add(detection_factor(track, detection, weak_theta_sigma, curved))
    return graph
