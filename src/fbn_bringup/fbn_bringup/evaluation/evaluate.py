"""All that is measured of a run, in one result: per dive, per estimator, per sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation import consistency as c
from fbn_bringup.evaluation import errors as e
from fbn_bringup.evaluation import matches as m
from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.internal import Surfacing, surfacings
from fbn_bringup.evaluation.run import Run, RunError
from fbn_bringup.evaluation.series import Track, every
from fbn_common import records as r
from fbn_common.types import NS, Array

SAMPLE = NS  # ns between the samples that statistics rest on
ANSWER = 5 * NS  # ns after a match at the very end of a dive in which its error is taken


@dataclass(frozen=True, slots=True)
class DiveResult:
    """One dive; a number that cannot be known is None."""

    number: int
    start_s: float
    duration_s: float
    distance_m: float | None
    deepest_m: float
    deadreck: e.Drift | None
    reference_m: float | None  # horizontal error at the end
    absolute_m: float | None  # of the global filter, at the end
    on_map_m: float | None  # median after the first match of the dive
    on_map_end_m: float | None
    matches: m.Matches
    stated: tuple[m.Statement, ...]


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Horizontal error of one estimate over the run [m]."""

    name: str
    median: float
    p95: float
    worst: float
    final: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What is known of a run's quality; without truth, only the inner consistency."""

    name: str
    has_truth: bool
    dives: tuple[DiveResult, ...]
    errors: tuple[ErrorSummary, ...]
    mission_drift: e.Drift | None
    nees: tuple[c.Consistency, ...]
    sensors: tuple[c.SensorReport, ...]
    surfacings: tuple[Surfacing, ...]

    @property
    def matched(self) -> int:
        """Dives with a declared match that is not false."""
        return sum(d.matches.declared and not d.matches.false for d in self.dives)

    @property
    def false_matches(self) -> int:
        """Dives with a false match declared."""
        return sum(d.matches.false for d in self.dives)

    @property
    def on_map_median(self) -> float | None:
        """Median over the matched dives of the error on the map [m]."""
        values = [d.on_map_m for d in self.dives if d.on_map_m is not None]
        return float(np.median(values)) if values else None

    @property
    def on_map_final(self) -> float | None:
        """Error on the map at the end of the last matched dive [m]."""
        return next((d.on_map_end_m for d in reversed(self.dives) if d.on_map_end_m is not None), None)

    @property
    def drift_percent(self) -> float | None:
        """Median over the dives of dead reckoning's error [% of distance]."""
        values = [d.deadreck.percent for d in self.dives if d.deadreck and d.deadreck.distance > 1.0]
        return float(np.median(values)) if values else None


@dataclass(frozen=True, slots=True, eq=False)
class ErrorTracks:
    """The error series that evaluation and report share; those that cannot be known are missing."""

    series: dict[str, e.ErrorSeries]  # by topic, and "on the map"
    shift: e.MapShift | None


def evaluate(run: Run) -> Evaluation:
    """Everything measurable of a run; raises RunError when no estimator left a track in it."""
    if not any(topic != "truth/odometry" for topic in run.tracks):
        raise RunError(f"{run.name}: holds no estimator's output; make a run first: fbn replay BAG -o RUN")
    tracks, legs = error_tracks(run), run.legs()
    identities = _identities(run)
    deadreck = run.tracks.get("deadreck/odometry")
    return Evaluation(
        run.name,
        run.true_track is not None,
        tuple(_dive(run, leg, tracks, identities) for leg in legs),
        tuple(_summary(name, s) for name, s in tracks.series.items() if len(s.track)),
        e.drift(deadreck, run.true_track, _mission(legs)) if deadreck and run.true_track and legs else None,
        tuple(_nees(run, tracks)),
        tuple(c.sensor_report(table) for table in run.innovations),
        surfacings(run.of("gps/fix", r.NavSatFix), deadreck, legs) if deadreck else (),
    )


def error_tracks(run: Run) -> ErrorTracks:
    """Error series of every estimate against truth, and of the global one on the map."""
    true = run.true_track
    if true is None:
        return ErrorTracks({}, None)
    series = {}
    if deadreck := run.tracks.get("deadreck/odometry"):
        kept = deadreck.within(true)
        if len(kept):
            series["deadreck/odometry"] = e.against(e.aligned(kept, true, int(kept.stamp_ns[0])), true)
    for topic in ("reference/odometry", "global/odometry"):
        if topic in run.tracks:
            series[topic] = e.against(run.tracks[topic], true)
    shift = None
    if run.truth is not None:
        hypotheses = run.of("global/hypotheses", r.MatchHypotheses)
        shift = e.map_shift(run.of("global/map", r.FeatureMap), hypotheses, run.truth)
    if shift is not None and "global/odometry" in series:
        series["on the map"] = e.on_the_map(series["global/odometry"], shift)
    return ErrorTracks(series, shift)


def _mission(legs: tuple[Dive, ...]) -> Dive:
    return Dive(0, legs[0].start_ns, legs[-1].end_ns)


def _identities(run: Run) -> dict[int, int | None]:
    deadreck, true = run.tracks.get("deadreck/odometry"), run.true_track
    if deadreck is None or true is None or run.truth is None:
        return {}
    return m.identities(run.of("tracking/features", r.TrackedFeatures), deadreck, true, run.truth)


def _dive(run: Run, leg: Dive, tracks: ErrorTracks, identities: dict[int, int | None]) -> DiveResult:
    answers = (
        run.of("global/status", r.LocalizationStatus),
        run.of("global/hypotheses", r.MatchHypotheses),
        run.of("tracking/composite", r.CompositeMeasurement),
        identities,
        run.truth,
        run.logged_ns("global/hypotheses"),
    )
    found = m.matches(leg, *answers)
    deadreck, true = run.tracks.get("deadreck/odometry"), run.true_track
    depth_track = (true or deadreck or next(iter(run.tracks.values()))).between(leg.start_ns, leg.end_ns)
    first = leg.start_ns + round((found.after_s or 0.0) * NS)
    last = leg.end_ns if first < leg.end_ns else first + ANSWER  # the last composite may be answered on the surface
    on_map = _horizontal(tracks, "on the map", first, last) if found.declared else np.zeros(0)
    return DiveResult(
        leg.number,
        (leg.start_ns - run.start_ns) / NS,
        leg.duration,
        float(depth_track.distance()[-1]) if len(depth_track) else None,
        float(-depth_track.position[:, 2].min()) if len(depth_track) else 0.0,
        e.drift(deadreck, true, leg) if deadreck and true else None,
        _last(_horizontal(tracks, "reference/odometry", leg.start_ns, leg.end_ns)),
        _last(_horizontal(tracks, "global/odometry", leg.start_ns, leg.end_ns)),
        float(np.median(on_map)) if len(on_map) else None,
        _last(on_map),
        found,
        m.statements(leg, *answers),
    )


def _horizontal(tracks: ErrorTracks, name: str, start_ns: int, end_ns: int) -> Array:
    series = tracks.series.get(name)
    if series is None:
        return np.zeros(0)
    inside = (series.track.stamp_ns >= start_ns) & (series.track.stamp_ns <= end_ns)
    return np.asarray(series.horizontal[inside])


def _last(values: Array) -> float | None:
    return float(values[-1]) if len(values) else None


def _summary(name: str, series: e.ErrorSeries) -> ErrorSummary:
    h = series.horizontal[every(series.track.stamp_ns, SAMPLE)]
    return ErrorSummary(name, float(np.median(h)), float(np.quantile(h, 0.95)), float(h.max()), float(h[-1]))


def _nees(run: Run, tracks: ErrorTracks) -> list[c.Consistency]:
    """NEES of what each estimate claims: depth and attitude where they are good, xy where they answer for it."""
    parts: list[tuple[str, str, slice, bool]] = [
        ("dead reckoning z", "deadreck/odometry", slice(2, 3), False),
        ("dead reckoning attitude", "deadreck/odometry", slice(3, 6), False),
        ("dead reckoning xy since start", "deadreck/odometry", slice(0, 2), True),
        ("reference xy", "reference/odometry", slice(0, 2), False),
        ("global xy", "global/odometry", slice(0, 2), False),
    ]
    found = [_nees_of(label, tracks.series.get(topic), rows, late) for label, topic, rows, late in parts]
    return [n for n in (*found, _target_nees(run)) if n]


def _nees_of(label: str, series: e.ErrorSeries | None, rows: slice, skip_start: bool) -> c.Consistency | None:
    if series is None or not len(series.track):
        return None
    some = every(series.track.stamp_ns, SAMPLE)
    if skip_start:  # aligned at the start: the error there is zero by construction
        some = some[series.track.stamp_ns[some] > series.track.stamp_ns[0] + 60 * NS]
    errors = np.concatenate([series.position, series.rotation], axis=1)[some][:, rows]
    covariance = series.track.covariance[some][:, rows, rows]
    return c.consistency(label, c.nees(errors, covariance), rows.stop - rows.start)


def target_errors(run: Run) -> tuple[Array, Array, Array]:
    """Stamps (n,), errors (n, 3) [m] in base_link and covariances (n, 3, 3) of the target from the vehicle."""
    true, truth = run.true_track, run.truth
    statuses = [s for s in run.of("global/status", r.LocalizationStatus) if s.matched and s.target_id >= 0]
    known = truth.on_map() if truth is not None else {}
    inside = [s for s in statuses if s.target_id in known and true is not None and _covers(true, s.stamp_ns)]
    if true is None or not inside:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3))
    stamps = np.array([s.stamp_ns for s in inside])
    poses = true.at(stamps)
    targets = np.array([known[s.target_id].position for s in inside])
    from_vehicle = poses.rotation.inv().apply(targets - poses.position)
    estimated = np.array([s.target_position_body for s in inside])
    return stamps, estimated - from_vehicle, np.array([s.target_covariance_body for s in inside])


def _covers(track: Track, stamp_ns: int) -> bool:
    return bool(track.stamp_ns[0] <= stamp_ns <= track.stamp_ns[-1])


def _target_nees(run: Run) -> c.Consistency | None:
    _, errors, covariances = target_errors(run)
    return c.consistency("target from the vehicle", c.nees(errors, covariances), 3) if len(errors) else None
