"""Composite measurements straight from a drawn world, for tests of the global filter without the four before it.

A vehicle runs legs through a field of point features.  Dead reckoning errs by a drift that wanders slowly and by
white noise; each window of the path becomes one composite: the exact Gaussian of what was measured in it (depth and
attitude at both ends, the path, features from near the base and from near P2), with the prior handed over from
window to window as the record's docstring says.  Features appear once enough scans in a pass detected them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import exp

import numpy as np
from scipy.spatial.distance import cdist

from fbn_common.geodesy import GeodeticPoint, geodetic_from_enu
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.prior_map import PriorFeature, PriorMap
from fbn_common.records import (
    CompositeFeature,
    CompositeMeasurement,
    Datum,
    Odometry,
    Pose,
    Record,
    ReferenceFix,
    SweptArea,
)
from fbn_common.types import NS, Array, nanoseconds

DATUM = GeodeticPoint(42.3572, -71.0853, 0.0)
_CELL = 2.0  # m


@dataclass(frozen=True)
class Settings:
    """A world and a run through it; all drawn from one seed."""

    features: Array  # (n, 3) m, as they are
    legs: tuple[tuple[float, float], ...]  # m, way points
    seed: int = 0
    speed: float = 0.8  # m/s
    depth: float = 3.0  # m
    window_s: float = 12.0
    ping_s: float = 0.5
    view: float = 0.785  # rad
    range_min: float = 4.0
    range_max: float = 40.0
    visibility: float = 0.67
    promotion: int = 7
    clutter: float = 5e-5  # false features per m^2 newly seen and scan window
    drift_sigma: float = 0.05  # m/s
    drift_time: float = 600.0  # s
    white: float = 0.005  # m^2/s
    feature_sigma: float = 0.3  # m
    fix_sigma: float = 2.0  # m, one slowly varying error all along
    fix_every: int = 0  # windows; 0: only before the first
    map_sigma: float = 5.0  # as the map states it
    map_error: float = 5.0  # as it is drawn
    map_length: float = 1000.0
    map_own: float = 0.5
    missing: float = 0.0  # fraction of features that the map lacks
    surplus: float = 0.0  # fraction more on the map that are not there
    map_shift: tuple[float, float] = (0.0, 0.0)


@dataclass
class Run:
    """What was drawn: log entries in time, the map, and the truth."""

    entries: list[tuple[str, Record]] = field(default_factory=list)
    prior: PriorMap = field(default_factory=lambda: PriorMap(()))
    truth: dict[int, Array] = field(default_factory=dict)  # stamp -> true pose (6,) at start and composites' ends
    key_feature: dict[int, int] = field(default_factory=dict)  # key -> true feature's number; -1 clutter
    datum: GeodeticPoint = DATUM


def draw_map(s: Settings, rng: np.random.Generator) -> tuple[PriorMap, Array]:
    """A prior map with correlated errors; ids are true feature numbers, from 1000 on those that are not there."""
    kept = np.flatnonzero(rng.random(len(s.features)) >= s.missing)
    low, high = s.features[:, :2].min(axis=0) - 10, s.features[:, :2].max(axis=0) + 10
    extra = round(s.surplus * len(s.features))
    places = np.vstack([s.features[kept], np.column_stack([rng.uniform(low, high, (extra, 2)), np.full(extra, -4.0)])])
    ids = [*kept.tolist(), *(1000 + k for k in range(extra))]
    distance = cdist(places[:, :2], places[:, :2])
    root = np.linalg.cholesky(s.map_error**2 / (1 + distance / s.map_length) + s.map_own**2 * np.eye(len(ids)))
    stated = places.copy()
    stated[:, :2] += root @ rng.standard_normal((len(ids), 2)) + np.array(s.map_shift)
    stated[:, 2] += 0.5 * rng.standard_normal(len(ids))
    features = []
    for k, (x, y, z) in zip(ids, stated, strict=True):
        g = geodetic_from_enu(np.array([x, y, 0.0]), DATUM)
        features.append(
            PriorFeature(k, g.latitude, g.longitude, float(z), f"f{k}", s.map_sigma, 0.67, target=k == ids[0])
        )
    return PriorMap(tuple(features)), stated


class World:
    """Draws one run window by window."""

    def __init__(self, settings: Settings) -> None:
        self.s = settings
        self.rng = np.random.default_rng(settings.seed)
        self.run = Run()
        self.run.prior, _ = draw_map(settings, self.rng)
        self.fix_error = settings.fix_sigma * self.rng.standard_normal(2)
        self.true_drift = settings.drift_sigma * self.rng.standard_normal(3)
        self.stationary = settings.drift_sigma**2 * np.eye(3)
        self.next_key = 1
        self.live: dict[int, tuple[int, int]] = {}  # feature -> (key, last window seen)

    def make(self) -> Run:
        """The whole run."""
        s, rng = self.s, self.rng
        positions, yaws = self._path()
        per = round(s.window_s / s.ping_s)
        base = np.array([*positions[0], -s.depth, 0.0, 0.0, yaws[0]])
        odom_xy = np.zeros(2)
        prior_mean = np.array(
            [-s.depth + 0.05 * rng.standard_normal(), 0.0, 0.0, yaws[0] + 0.03 * rng.standard_normal(), 0, 0, 0]
        )
        prior_cov = np.diag([0.05**2, 0.01**2, 0.01**2, 0.03**2, *np.diag(self.stationary)])
        t0 = 100 * NS
        self._emit("reference/datum", Datum(t0, "map", DATUM.latitude, DATUM.longitude, DATUM.height))
        self.run.truth[t0] = base
        self._odometry(t0, odom_xy, base)
        self._fix(t0, base[:2])
        for w in range((len(positions) - 1) // per):
            now = t0 + nanoseconds((w + 1) * s.window_s)
            track, heading = positions[w * per : (w + 1) * per + 1], yaws[w * per : (w + 1) * per + 1]
            end = np.array([*track[-1], -s.depth, 0.0, 0.0, heading[-1]])
            bow = (np.column_stack([np.cos(heading), np.sin(heading)])[:-1]).sum(axis=0) * s.ping_s
            by_drift = np.column_stack([s.window_s * np.eye(2), bow])
            moved = (
                end[:2] - base[:2] - by_drift @ self.true_drift - np.sqrt(s.white * s.window_s) * rng.standard_normal(2)
            )
            odom_before, odom_xy = odom_xy, odom_xy + moved
            seen, scans, corner, size = self._scan(w, track, heading)
            composite, prior_mean, prior_cov = self._composite(
                w,
                now,
                base,
                end,
                moved,
                by_drift,
                seen,
                (scans, corner, size),
                prior_mean,
                prior_cov,
                odom_before,
                odom_xy,
            )
            self._interpolate(now - nanoseconds(s.window_s), now, odom_before, odom_xy, heading)
            self._emit("tracking/composite", composite)
            if s.fix_every and (w + 1) % s.fix_every == 0:
                self._fix(now, end[:2])
            self.run.truth[now] = end
            decay = exp(-s.window_s / s.drift_time)
            step = s.drift_sigma * np.sqrt(1 - decay**2) * rng.standard_normal(3)
            self.true_drift = decay * self.true_drift + step
            base = end
        return self.run

    def _path(self) -> tuple[Array, Array]:
        points, step, xy, yaw = [np.array(p, dtype=float) for p in self.s.legs], self.s.speed * self.s.ping_s, [], []
        for a, b in pairwise(points):
            n = max(int(np.hypot(*(b - a)) / step), 1)
            xy += [a + (b - a) * k / n for k in range(n)]
            yaw += [float(np.arctan2(*(b - a)[::-1]))] * n
        return np.array(xy), np.array(yaw)

    def _emit(self, topic: str, record: Record) -> None:
        self.run.entries.append((topic, record))

    def _pose(self, odom_xy: Array, pose: Array) -> Pose:
        rotation = matrix_from_rpy(np.ascontiguousarray(pose[3:]))
        return Pose(np.array([*odom_xy, pose[2]]), quaternion_from_matrix(rotation))

    def _odometry(self, stamp: int, odom_xy: Array, pose: Array) -> None:
        covariance = np.diag([1.0, 1.0, 0.05**2, 0.01**2, 0.01**2, 0.03**2])
        twist = np.array([self.s.speed, 0, 0, 0, 0, 0])
        record = Odometry(stamp, "odom", "base_link", self._pose(odom_xy, pose), twist, covariance, 0.01 * np.eye(6))
        self._emit("deadreck/odometry", record)

    def _interpolate(self, start: int, end: int, a: Array, b: Array, heading: Array) -> None:
        n = len(heading) - 1
        for k in range(1, n + 1):
            pose = np.array([0, 0, -self.s.depth, 0, 0, heading[k]])
            self._odometry(start + (end - start) * k // n, a + (b - a) * k / n, pose)

    def _fix(self, stamp: int, xy: Array) -> None:
        covariance = self.s.fix_sigma**2 * np.eye(2)
        self._emit("reference/fix", ReferenceFix(stamp, "map", xy + self.fix_error, covariance, covariance))

    def _scan(
        self, w: int, track: Array, heading: Array
    ) -> tuple[list[tuple[int, int, int, float, Array]], Array, Array, Array]:
        """Features seen (key, number, detections, scans, position), and the swept grid relative to the base."""
        s, rng = self.s, self.rng
        low = np.floor((track.min(axis=0) - s.range_max - track[0]) / _CELL) * _CELL
        high = np.ceil((track.max(axis=0) + s.range_max - track[0]) / _CELL) * _CELL
        size = np.round((high - low) / _CELL).astype(int)
        gx, gy = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        cells = track[0] + low + (np.stack([gx, gy], axis=-1).reshape(-1, 2) + 0.5) * _CELL
        scans = np.zeros(len(cells))
        hits = np.zeros(len(s.features))
        for xy, yaw in zip(track[:-1], heading[:-1], strict=True):
            scans += self._in_view(cells, xy, yaw)
            hits += self._in_view(s.features[:, :2], xy, yaw)
        seen = []
        for i in np.flatnonzero(hits > 0):
            detections = int(rng.binomial(int(hits[i]), s.visibility))
            key, last = self.live.get(int(i), (0, -9))
            if last == w - 1 and detections:
                seen.append((key, int(i), detections, float(hits[i]), s.features[i]))
                self.live[int(i)] = (key, w)
            elif detections >= s.promotion:
                seen.append((self.next_key, int(i), detections, float(hits[i]), s.features[i]))
                self.live[int(i)] = (self.next_key, w)
                self.run.key_feature[self.next_key] = int(i)
                self.next_key += 1
        swept = np.flatnonzero(scans >= s.promotion)
        for _ in range(rng.poisson(s.clutter * len(swept) * _CELL**2 * s.window_s / 40.0)):
            place = np.array([*(cells[rng.choice(swept)] + rng.uniform(-1, 1, 2)), rng.uniform(-6, -1)])
            seen.append((self.next_key, -1, s.promotion, 2.0 * s.promotion, place))
            self.run.key_feature[self.next_key] = -1
            self.next_key += 1
        return seen, scans, low, size

    def _in_view(self, points: Array, xy: Array, yaw: float) -> Array:
        d = points - xy
        r = np.hypot(d[:, 0], d[:, 1])
        bearing = (np.arctan2(d[:, 1], d[:, 0]) - yaw + np.pi) % (2 * np.pi) - np.pi
        return ((r > self.s.range_min) & (r < self.s.range_max) & (np.abs(bearing) < self.s.view / 2)).astype(float)

    def _composite(
        self, w: int, now: int, base: Array, end: Array, moved: Array, by_drift: Array,
        seen: list[tuple[int, int, int, float, Array]], swept: tuple[Array, Array, Array],
        prior_mean: Array, prior_cov: Array, odom_before: Array, odom_after: Array,
    ) -> tuple[CompositeMeasurement, Array, Array]:  # fmt: skip
        """The Gaussian of the window's measurements, by information; unknowns in the record's order."""
        s, n = self.s, len(seen)
        size = 13 + 3 * n
        information, pull = np.zeros((size, size)), np.zeros(size)
        drift = np.arange(size - 3, size)

        def measure(columns: list[int], h: Array, z: Array, covariance: Array) -> None:
            weight = np.linalg.inv(covariance)
            information[np.ix_(columns, columns)] += h.T @ weight @ h
            pull[columns] += h.T @ weight @ z

        measure([0, 1, 2, 3, *drift], np.eye(7), prior_mean, prior_cov)
        h = np.hstack([np.eye(2), -by_drift])  # P2 - by_drift drift = dead reckoning
        measure([4, 5, *drift], h, moved, s.white * s.window_s * np.eye(2))
        attitude = np.diag([0.05**2, 0.01**2, 0.01**2, 0.03**2])

        def noise(c: Array) -> Array:
            return np.asarray(np.linalg.cholesky(c) @ self.rng.standard_normal(len(c)))

        measure([6, 7, 8, 9], np.eye(4), end[2:] + noise(attitude), attitude)
        for k, (_, _, _, _, place) in enumerate(seen):
            at = [10 + 3 * k, 11 + 3 * k, 12 + 3 * k]
            near = np.diag([s.feature_sigma**2] * 2 + [1.0])
            relative = place - np.array([*base[:2], 0.0])
            far = np.diag([4 * s.feature_sigma**2] * 2 + [4.0])
            measure(at, np.eye(3), relative + noise(far), far)
            of_p2 = place - np.array([*end[:2], 0.0])
            h = np.zeros((3, 5))
            h[:, :3], h[:2, 3:] = np.eye(3), -np.eye(2)
            measure([*at, 4, 5], h, of_p2 + noise(near), near)
        covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
        mean = covariance @ pull
        scans, corner, cells = swept
        features = tuple(
            CompositeFeature(key, detections, expected, now - nanoseconds(s.window_s), now)
            for key, _, detections, expected, _ in seen
        )
        composite = CompositeMeasurement(
            now, "odom", w, now - nanoseconds(s.window_s), w == 0, round(s.window_s / s.ping_s), s.speed * s.window_s,
            s.drift_time, features, SweptArea(_CELL, int(cells[0]), int(cells[1]), corner, scans),
            mean, covariance, prior_mean, prior_cov, self._pose(odom_before, base), self._pose(odom_after, end),
        )  # fmt: skip
        at_end = [6, 7, 8, 9, *drift]
        decay = exp(-s.window_s / s.drift_time)
        scale = np.array([1.0] * 4 + [decay] * 3)
        handed = covariance[np.ix_(at_end, at_end)] * np.outer(scale, scale)
        handed[4:, 4:] += (1 - decay**2) * self.stationary
        return composite, mean[at_end] * scale, handed


def charles_river(seed: int) -> Array:
    """Twelve features (12, 3) in rows of 5, 2 and 5, about 20 m apart."""
    rng = np.random.default_rng(seed + 10_000)
    rows = [(x, 0.0) for x in range(0, 100, 20)] + [(20.0, 20.0), (60.0, 20.0)] + [(x, 40.0) for x in range(0, 100, 20)]
    xy = np.array(rows, dtype=float) + 0.7 * rng.standard_normal((12, 2))
    return np.column_stack([xy, np.full(12, -4.0)])
