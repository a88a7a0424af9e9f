"""What the pictures show, as plain arrays: drawn by plotly for the screen and by matplotlib for paper."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pymap3d

from fbn_bringup.evaluation import errors as e
from fbn_bringup.evaluation.evaluate import ErrorTracks
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Innovations, Stamps, Track, every
from fbn_common import records as r
from fbn_common.types import NS, Array

PATH_PERIOD = NS  # ns between the points of a drawn path
MOST = 1500  # points of a drawn series


def minutes(run: Run, stamp_ns: Stamps) -> Array:
    """Minutes since the run's start (n,)."""
    return np.asarray((stamp_ns - run.start_ns) / (60 * NS))


def thinned(n: int, most: int = MOST) -> Stamps:
    """Indices of at most about ``most`` of n samples, evenly."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64)) if n else np.zeros(0, dtype=np.int64)


def ellipse(mean: Array, covariance: Array, sigmas: float = 1.0, points: int = 41) -> Array:
    """Outline (points, 2) of a Gaussian (2,), (2, 2) at so many standard deviations."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(mean + sigmas * (vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * circle)).T)


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Named points in the plane with their uncertainty."""

    labels: tuple[str, ...]
    xy: Array  # (n, 2) m
    covariance: Array  # (n, 2, 2) m^2

    def ellipses(self, sigmas: float = 1.0) -> list[Array]:
        """Outlines of all points."""
        return [ellipse(p, c, sigmas) for p, c in zip(self.xy, self.covariance, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class MapLayers:
    """All layers of the map, in the run's map [m, east and north]."""

    paths: dict[str, Track]  # by topic, thinned
    prior: Points | None
    estimated: Points | None
    true_features: Points | None
    target: Points | None  # as estimated
    gps: Array  # (n, 2)
    shift: Array | None  # (2,) m: map as believed less true features, at the end


def map_layers(run: Run, tracks: ErrorTracks) -> MapLayers:
    """The layers of a run's map."""
    maps = run.of("global/map", r.FeatureMap)
    shift = tracks.shift.shift[-1][:2] if tracks.shift is not None else None
    return MapLayers(
        {topic: _thin(t) for topic, t in _paths(run, tracks).items()},
        _points(maps[0], prior=True) if maps else None,
        _points(maps[-1]) if maps else None,
        _true_features(run),
        _points(maps[-1], target=True) if maps else None,
        gps_xy(run),
        shift,
    )


def _paths(run: Run, tracks: ErrorTracks) -> dict[str, Track]:
    topics = ("truth/odometry", "reference/odometry", "global/odometry")
    paths: dict[str, Track] = {t: run.tracks[t] for t in topics if t in run.tracks}
    if "deadreck/odometry" in tracks.series:
        return paths | {"deadreck/odometry": tracks.series["deadreck/odometry"].track}
    if deadreck := run.tracks.get("deadreck/odometry"):
        anchor = paths.get("reference/odometry") or paths.get("global/odometry")
        inside = deadreck.within(anchor) if anchor else deadreck
        if anchor and len(inside):
            deadreck = e.aligned(deadreck, anchor, int(inside.stamp_ns[0]))
        paths["deadreck/odometry"] = deadreck
    return paths


def _thin(t: Track) -> Track:
    return t.where(every(t.stamp_ns, PATH_PERIOD))


def _points(m: r.FeatureMap, prior: bool = False, target: bool = False) -> Points:
    chosen = [i for i, f in enumerate(m.features) if (f.prior or not prior) and (f.target or not target)]
    blocks = [m.covariance[3 * i : 3 * i + 2, 3 * i : 3 * i + 2] for i in chosen]
    return Points(
        tuple(m.features[i].name or str(m.features[i].id) for i in chosen),
        np.array([m.features[i].position[:2] for i in chosen]).reshape(-1, 2),
        np.array(blocks).reshape(-1, 2, 2),
    )


def _true_features(run: Run) -> Points | None:
    if run.truth is None:
        return None
    features = run.truth.features
    xy = np.array([f.position[:2] for f in features]).reshape(-1, 2)
    return Points(tuple(str(f.id) for f in features), xy, np.zeros((len(features), 2, 2)))


def gps_xy(run: Run) -> Array:
    """Fixes in the run's map (n, 2) [m]; none without a datum."""
    data = run.of("reference/datum", r.Datum)
    fixes = [f for f in run.of("gps/fix", r.NavSatFix) if f.status >= 0 and np.isfinite(f.latitude + f.longitude)]
    if not data or not fixes:
        return np.zeros((0, 2))
    d = data[-1]
    latitude, longitude = np.array([f.latitude for f in fixes]), np.array([f.longitude for f in fixes])
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, d.height, d.latitude, d.longitude, d.height)
    return np.stack([east, north], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """One error over time with three standard deviations, both in the unit named."""

    title: str
    unit: str
    minutes: Array
    error: Array
    three_sigma: Array
    topic: str  # whose look it has
    beside: dict[str, Array] = field(default_factory=dict)  # further errors at the same times


def error_bands(run: Run, tracks: ErrorTracks) -> list[Band]:
    """The errors that a reader wants: what each estimate answers for, with what it claims."""
    wanted = [
        ("deadreck/odometry", "Dead reckoning since the start", (0, 1)),
        ("reference/odometry", "Reference filter", (0, 1)),
        ("global/odometry", "Global filter", (0, 1)),
        ("deadreck/odometry", "Dead reckoning", (2, 5)),
    ]
    axes = {0: ("east", "m", 1.0), 1: ("north", "m", 1.0), 2: ("height", "m", 1.0), 5: ("yaw", "deg", 180.0 / np.pi)}
    bands = []
    for topic, title, rows in wanted:
        if topic in tracks.series and len(tracks.series[topic].track):
            bands += [_band(run, tracks, topic, f"{title}: {axes[i][0]}", i, *axes[i][1:]) for i in rows]
    return bands


def _band(run: Run, tracks: ErrorTracks, topic: str, title: str, row: int, unit: str, scale: float) -> Band:
    series = tracks.series[topic]
    some = thinned(len(series.track))
    errors = series.position[:, row] if row < 3 else series.rotation[:, row - 3]
    sigma = np.sqrt(np.maximum(series.track.covariance[some, row, row], 0.0))
    beside = {}
    if topic == "global/odometry" and "on the map" in tracks.series:
        beside["on the map"] = scale * tracks.series["on the map"].position[some, row]
    time = minutes(run, series.track.stamp_ns[some])
    return Band(title, unit, time, scale * errors[some], 3.0 * scale * sigma, topic, beside)


def component(table: Innovations, index: int) -> tuple[Array, Array, Stamps]:
    """One component of a sensor's innovations and its sigma (n,), and the indices (n,) of those that have it."""
    have = np.array(
        [i for i, x in enumerate(table.innovation) if len(x) > index and np.isfinite(x[index])], dtype=np.int64
    )
    values = np.array([table.innovation[i][index] for i in have])
    return values, np.array([table.sigma[i][index] for i in have]), have


def shown(table: Innovations, most: int = MOST) -> Stamps:
    """Indices of the innovations to draw: all that were not used (up to the limit), and a thinned rest."""
    refused = np.flatnonzero(table.verdict != r.Verdict.USED)
    used = np.flatnonzero(table.verdict == r.Verdict.USED)
    return np.sort(np.concatenate([refused[thinned(len(refused), most)], used[thinned(len(used), most)]]))


def innovation_limit(values: Array, sigma: Array) -> float:
    """Half the height of an axis that shows a sensor's innovations, but not the huge sigma before a first fix."""
    if not len(values):
        return 0.0
    return float(max(1.2 * np.quantile(np.abs(values), 0.995), 3.3 * np.quantile(sigma, 0.75)))


NIS_FLOOR = 1e-3  # drawn values; on a logarithmic axis zero has no place


def nis_to_draw(table: Innovations) -> Array:
    """NIS (n,) for a logarithmic axis: at least the floor, where refused data lie; NaN where nothing was tested."""
    nis = np.maximum(np.nan_to_num(table.nis, nan=NIS_FLOOR), NIS_FLOOR)
    untested = (table.dof == 0) & (table.verdict == r.Verdict.USED)
    return np.where(untested | ((table.nis == 0.0) & (table.verdict == r.Verdict.USED)), np.nan, nis)


def usual_dof(table: Innovations) -> int:
    """The degrees of freedom that most of a sensor's innovations have; 0 if none was tested."""
    tested = table.dof[table.dof > 0]
    return int(np.median(tested)) if len(tested) else 0


def extent(layers: MapLayers) -> tuple[float, float]:
    """Width and height [m] of all that the map shows."""
    points = [t.position[:, :2] for t in layers.paths.values()]
    points += [p.xy for p in (layers.prior, layers.estimated, layers.true_features) if p is not None]
    everything = np.concatenate([p for p in points if len(p)] or [np.zeros((1, 2))])
    width, height = np.ptp(everything, axis=0)
    return max(float(width), 1.0), max(float(height), 1.0)
