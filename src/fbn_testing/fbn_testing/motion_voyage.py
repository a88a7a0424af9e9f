"""The front half alone on a simulated transit: predict, dead reckoning, reference, without sonar, judged by truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fbn_bringup.configuration import load_parameters
from fbn_bringup.evaluation.consistency import nees
from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.errors import ErrorSeries, against, drift
from fbn_bringup.evaluation.series import Stamps, Track, track
from fbn_common.estimator import Estimator
from fbn_common.geodesy import GeodeticPoint
from fbn_common.graph import GRAPH
from fbn_common.motion_ekf.lockstep import Arrival, play
from fbn_common.records import Innovation, Odometry, VehicleParameters, Verdict
from fbn_common.types import NS, Array
from fbn_deadreck.estimator import Deadreck
from fbn_predict.estimator import Predict
from fbn_reference.estimator import Reference
from fbn_sim.motion import interpolate
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import Simulation, simulate

WATER = slice(12, 14)  # east and north within the 15 parameters
WATER_SPAN_S = 120.0  # of the dive's beginning, over which true water is averaged: an eddy is passed in 80 s
NEAR_SURFACE = 1.0  # m
NIS_GROUPS = ("compass near the surface", "compass under water", "depth", "gps")


@dataclass
class Kept:
    """What is kept of a voyage: poses each second, parameters, and answers to measurements."""

    odometry: dict[str, list[Odometry]] = field(default_factory=lambda: {"deadreck": [], "reference": []})
    parameters: list[VehicleParameters] = field(default_factory=list)
    answers: dict[tuple[str, str], list[tuple[int, float, int]]] = field(default_factory=dict)

    def take(self, topic: str, record: object) -> None:
        """Keep what is wanted of one output."""
        node = topic.partition("/")[0]
        if isinstance(record, Odometry) and topic == f"{node}/odometry":
            lines = self.odometry[node]
            if not lines or record.stamp_ns >= lines[-1].stamp_ns + NS:
                lines.append(record)
        elif isinstance(record, VehicleParameters) and topic == "reference/parameters":
            self.parameters.append(record)
        elif isinstance(record, Innovation) and record.verdict is Verdict.USED and record.dof:
            answer = (record.stamp_ns, record.nis, record.dof)
            self.answers.setdefault((node, record.sensor), []).append(answer)


def transit(current: float, seed: int, overrides: Mapping[str, Any] | None = None) -> Simulation:
    """``no_map_transit`` without sonar, the deep current's mean speed as given [m/s]."""
    chosen = {
        "sensors.sonar.timing.rate": 0.0,
        "sensors.truth.odometry_rate": 5.0,
        "sea.current_speed_min": current,
        "sea.current_speed_max": current,
    }
    return simulate(load_scenario("no_map_transit", chosen | dict(overrides or {})), seed)


def in_map(datum: GeodeticPoint) -> dict[str, Any]:
    """Settings that lay the reference filter's ``map`` on truth's."""
    place = {"latitude": datum.latitude, "longitude": datum.longitude, "height": datum.height}
    return {f"reference.map.datum.{name}": value for name, value in place.items()} | {"reference.map.datum_given": True}


def front_half(settings: Mapping[str, Any] | None = None) -> dict[str, Estimator]:
    """The three estimators, with ``node.parameter`` settings over the defaults."""
    parameters = load_parameters(GRAPH, (), settings)
    return {
        "fbn_predict": Predict(parameters["fbn_predict"]),
        "fbn_deadreck": Deadreck(parameters["fbn_deadreck"]),
        "fbn_reference": Reference(parameters["fbn_reference"]),
    }


def navigate(estimators: Mapping[str, Estimator], records: Iterable[Arrival], shared: bool = True) -> Kept:
    """Run the estimators over a log; ``shared`` false keeps the reference filter's parameters from predict."""
    kept, withheld = Kept(), frozenset() if shared else frozenset({"reference/parameters"})
    for made in play(estimators, records, withheld=withheld):
        for topic, record in made:
            kept.take(topic, record)
    return kept


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A voyage's last dive against truth."""

    values: dict[str, float]  # name: number, see MEASURES and NEES of the study
    nis: dict[str, tuple[float, int]]  # sensor: sum of NIS, of degrees of freedom
    distance: Array  # (n,) m, true way since the dive's start
    drift: Array  # (n,) m, dead reckoning's horizontal error grown since then
    sigma: Array  # (n,) m, what dead reckoning's covariance of x and y says, root of the larger eigenvalue


def judge(simulation: Simulation, kept: Kept) -> Judged:
    """Errors, and whether they were announced, over the transit: the mission's longest dive."""
    dive = max(simulation.dives, key=lambda d: d.end_ns - d.start_ns)
    leg = Dive(1, dive.start_ns, dive.end_ns)
    true = true_track(simulation)
    deadreck, reference = track(kept.odometry["deadreck"]), track(kept.odometry["reference"])
    first = true.at(deadreck.stamp_ns[:1]).position[0] - deadreck.position[0]
    own = against(deadreck.shifted(first), true)
    absolute = against(reference, true)
    within, at_end = _rows(own, leg), int(np.searchsorted(absolute.track.stamp_ns, leg.end_ns)) - 1
    grown = own.position[within, :2] - own.position[within[0], :2]
    way = true.between(leg.start_ns, leg.end_ns)
    distance = np.interp(own.track.stamp_ns[within], way.stamp_ns, way.distance())
    gone = drift(deadreck, true, leg)
    assert gone is not None
    values = {
        "drift_percent": gone.percent,
        "reference_percent": 100.0 * float(absolute.horizontal[at_end]) / gone.distance,
        "yaw_deg": float(np.degrees(np.sqrt(np.mean(own.rotation[within, 2] ** 2)))),
        "nees_ten_minutes": nees_of(own, within[_after(own, within, 600.0)], slice(0, 2)),
        "nees_drift_xy": nees_of(own, within[-1:], slice(0, 2)),
        "nees_reference_xy": nees_of(absolute, np.array([at_end]), slice(0, 2)),
        "nees_z": nees_of(own, within[::60], slice(2, 3)),
        "nees_tilt": nees_of(own, within[::60], slice(3, 5)),
        "nees_yaw": nees_of(own, within[::60], slice(5, 6)),
    }
    values |= _water(simulation, kept, leg)
    sigma = np.sqrt(np.linalg.eigvalsh(own.track.covariance[within][:, :2, :2])[:, -1])
    return Judged(values, nis_by_sensor(simulation, kept), distance, np.asarray(np.linalg.norm(grown, axis=1)), sigma)


def true_track(simulation: Simulation) -> Track:
    """The true way, as it was logged."""
    return track(
        [e.record for e in simulation.entries if e.topic == "truth/odometry" and isinstance(e.record, Odometry)]
    )


def true_depth(simulation: Simulation, stamp_ns: Stamps) -> Array:
    """The vehicle's true depth [m] at these stamps (n,)."""
    motion, start_ns = simulation.truth.motion, simulation.truth.start_ns
    return np.asarray(-np.interp((stamp_ns - start_ns) / NS, motion.time_s, motion.position[:, 2]))


def _rows(errors: ErrorSeries, leg: Dive) -> Stamps:
    stamps = errors.track.stamp_ns
    return np.flatnonzero((stamps >= leg.start_ns) & (stamps <= leg.end_ns)).astype(np.int64)


def _after(errors: ErrorSeries, rows: Stamps, seconds: float) -> slice:
    """Place within some rows of an error series of the last one no later than this after the first."""
    stamps = errors.track.stamp_ns[rows]
    last = int(np.searchsorted(stamps, stamps[0] + int(seconds * NS), side="right")) - 1
    return slice(last, last + 1)


def nees_of(errors: ErrorSeries, rows: Stamps, part: slice) -> float:
    """Mean NEES over its degrees of freedom of some rows of an error series."""
    all_errors = np.concatenate([errors.position, errors.rotation], axis=1)[rows][:, part]
    covariance = errors.track.covariance[rows][:, part, part]
    return float(np.mean(nees(all_errors, covariance))) / (part.stop - part.start)


def _water(simulation: Simulation, kept: Kept, leg: Dive) -> dict[str, float]:
    """Error of the current as known when the dive begins, against the water that the vehicle then meets."""
    known = [p for p in kept.parameters if p.stamp_ns <= leg.start_ns][-1]
    times = (leg.start_ns - simulation.truth.start_ns) / NS + np.arange(0.0, WATER_SPAN_S)
    error = known.mean[WATER] - interpolate(simulation.truth.motion, times).current[:, :2].mean(axis=0)
    covariance = known.covariance[WATER, WATER]
    return {
        "current_error": float(np.hypot(*error)),
        "current_sigma": float(np.sqrt(np.trace(covariance) / 2.0)),
        "nees_current": float(error @ np.linalg.solve(covariance, error)) / 2.0,
    }


def nis_by_sensor(simulation: Simulation, kept: Kept) -> dict[str, tuple[float, int]]:
    """NIS of dead reckoning's sensors and of the reference filter's fixes, the compass's by depth."""
    found = dict.fromkeys(NIS_GROUPS, (0.0, 0))
    for (node, sensor), answers in kept.answers.items():
        if (node == "reference") != (sensor == "gps"):
            continue
        stamps, squares, dof = (np.array(column) for column in zip(*answers, strict=True))
        depth = true_depth(simulation, stamps)
        for name in NIS_GROUPS:
            if not name.startswith(sensor):
                continue
            part = np.ones(len(stamps), bool)
            if sensor == "compass":
                part = depth < NEAR_SURFACE if name.endswith("surface") else depth >= NEAR_SURFACE
            found[name] = (float(squares[part].sum()), int(dof[part].sum()))
    return found


__all__ = [
    "Judged",
    "Kept",
    "Track",
    "front_half",
    "in_map",
    "judge",
    "navigate",
    "nees_of",
    "nis_by_sensor",
    "transit",
    "true_depth",
    "true_track",
]
