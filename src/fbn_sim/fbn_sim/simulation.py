"""A whole mission, made from a scenario and a seed."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.geodesy import GeodeticPoint, geodetic_from_enu
from fbn_common.graph import GRAPH, SIMULATOR_TOPICS
from fbn_common.prior_map import PriorFeature, PriorMap
from fbn_common.records import Odometry, Pose, Vector3Stamped
from fbn_common.types import NS, Array
from fbn_sim import faults
from fbn_sim.autopilot import PERIOD_S, PilotTable, Surroundings
from fbn_sim.motion import Motion, fly, interpolate
from fbn_sim.randomness import generator
from fbn_sim.scenario import Scenario, Truth
from fbn_sim.sea import draw_sea
from fbn_sim.sensors.actuation import actuator_records
from fbn_sim.sensors.clutter import Scatterers, draw_scatterers
from fbn_sim.sensors.compass import compass_records, draw_deviation, draw_drift
from fbn_sim.sensors.depth import altitude_records, pressure_records
from fbn_sim.sensors.position import draw_gps_error, gps_records, lbl_records
from fbn_sim.sensors.sample import Entry, Flight
from fbn_sim.sensors.sonar import sonar_records
from fbn_sim.vehicle import draw_body
from fbn_sim.world import Features, MappedFeature, draw_bed, draw_features, draw_prior_map

DIVE_SECONDS = 20.0  # s under water make a dive
_ORDER = {name: i for i, name in enumerate((*GRAPH.topics, *(t.name for t in SIMULATOR_TOPICS)))}


class Dive(NamedTuple):
    """From the antenna's going under to its coming up."""

    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """What really was: the motion, the features, and all that echoes."""

    start_ns: int
    motion: Motion
    features: Features
    scatterers: Scatterers
    deviation: Array  # (5,) of the compass, see fbn_sim.autopilot.deviation
    gps_error: Array  # (n, 3) m, at each whole second

    def at(self, stamp_ns: int) -> Motion:
        """The motion at a stamp: one row of each."""
        return interpolate(self.motion, np.array([(stamp_ns - self.start_ns) / NS]))


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A mission: its log in the order of logging, its truth, its map."""

    scenario: Scenario
    seed: int
    truth: GroundTruth
    prior_map: PriorMap
    entries: tuple[Entry, ...]

    def records(self) -> Iterator[Entry]:
        """All records as ``(log_time_ns, topic, record)``, by time of logging."""
        return iter(self.entries)

    @property
    def dives(self) -> tuple[Dive, ...]:
        """When the vehicle was under water for longer than a wave."""
        motion, found = self.truth.motion, []
        under = motion.surface > 0.3
        edges = np.flatnonzero(np.diff(np.concatenate([[False], under, [False]]).astype(np.int8)))
        for first, last in edges.reshape(-1, 2):
            begin, end = motion.time_s[first], motion.time_s[last - 1]
            if end - begin > DIVE_SECONDS:
                found.append(Dive(*(self.truth.start_ns + round(t * NS) for t in (begin, end))))
        return tuple(found)


def simulate(scenario: Scenario, seed: int | None = None) -> Simulation:
    """The mission of this scenario; the same seed gives the same mission, bit for bit."""
    seed = scenario.seed if seed is None else seed
    bed = draw_bed(scenario.world, seed)
    features = draw_features(scenario.world, bed, seed)
    truth = _truth(scenario, bed, features, seed)
    mapped = draw_prior_map(scenario.world, scenario.prior_map, features, seed)
    return Simulation(scenario, seed, truth, _prior_map(scenario, mapped), tuple(_log(scenario, truth, seed)))


def _truth(scenario: Scenario, bed: Array, features: Features, seed: int) -> GroundTruth:
    mission, sensors = scenario.mission, scenario.sensors
    deviation = draw_deviation(sensors.compass, seed)
    gps_error = draw_gps_error(sensors.gps, _seconds(scenario), seed)
    around = Surroundings(
        body=draw_body(scenario.vehicle, seed),
        sea=draw_sea(scenario.sea, scenario.world.depth, mission.limit, seed),
        bed=bed,
        pilot=_pilot(scenario, deviation, np.ascontiguousarray(gps_error[:, :2]), seed),
    )
    motion = fly(mission.start, mission.heading, scenario.time_step, mission.limit, around)
    scatterers = draw_scatterers(sensors.sonar.clutter, features, bed, motion, seed)
    return GroundTruth(scenario.start_time * NS, motion, features, scatterers, deviation, gps_error)


def _seconds(scenario: Scenario) -> int:
    """Whole seconds for which slow errors are drawn."""
    return int(scenario.mission.limit) + 3


def _pilot(scenario: Scenario, deviation: Array, gps_error: Array, seed: int) -> PilotTable:
    mission, speed_per_rate = scenario.mission, scenario.vehicle.speed_per_rate
    shape = (int(mission.limit / PERIOD_S) + 10, 3)
    return PilotTable(
        legs=mission.table(speed_per_rate),
        gains=np.array(dataclasses.astuple(mission.autopilot)),
        speed_per_rate=speed_per_rate,
        deviation=deviation,
        drift=draw_drift(scenario.sensors.compass, _seconds(scenario), seed),
        noise=generator(seed, "pilot").standard_normal(shape) * np.array([0.005, 0.003, 0.01]),
        gps=gps_error,
    )


def _log(scenario: Scenario, truth: GroundTruth, seed: int) -> list[Entry]:
    """All sensors' records, faults applied, by time of logging."""
    sensors, flight = scenario.sensors, Flight(truth.motion, truth.start_ns, seed)
    drift = draw_drift(sensors.compass, _seconds(scenario), seed)
    antenna = np.array(scenario.vehicle.antenna)
    entries = [
        *actuator_records(sensors.actuators, scenario.vehicle.steering, flight),
        *compass_records(sensors.compass, truth.deviation, drift, flight),
        *pressure_records(sensors.pressure, scenario.sea.density, flight),
        *altitude_records(sensors.altimeter, flight),
        *gps_records(sensors.gps, truth.gps_error, antenna, scenario.world.datum, flight),
        *lbl_records(sensors.lbl, flight),
        *sonar_records(sensors.sonar, truth.scatterers, flight),
        *_truth_records(sensors.truth, truth),
    ]
    entries.sort(key=_log_order)
    for name, fault in scenario.faults.items():
        entries = faults.apply(entries, name, fault, truth.start_ns, seed)
    entries.sort(key=_log_order)
    return entries


def _log_order(entry: Entry) -> tuple[int, int, int, str]:
    return entry.log_time_ns, _ORDER[entry.topic], entry.record.stamp_ns, getattr(entry.record, "frame_id", "")


def _truth_records(rates: Truth, truth: GroundTruth) -> Iterator[Entry]:
    return itertools.chain(_truth_odometry(rates, truth), _truth_water(rates, truth))


def _regular(rate: float, truth: GroundTruth) -> tuple[Motion, list[int]]:
    times = np.arange(0.0, truth.motion.time_s[-1], 1.0 / rate) if rate > 0.0 else np.empty(0)
    return interpolate(truth.motion, times), [truth.start_ns + round(float(t) * NS) for t in times]


def _truth_odometry(rates: Truth, truth: GroundTruth) -> Iterator[Entry]:
    motion, stamps = _regular(rates.odometry_rate, truth)
    exact = np.zeros((6, 6))
    for i, stamp in enumerate(stamps):
        pose = Pose(motion.position[i], motion.orientation[i])
        record = Odometry(stamp, "map", "base_link", pose, motion.velocity[i], exact, exact)
        yield Entry(stamp, "truth/odometry", record)


def _truth_water(rates: Truth, truth: GroundTruth) -> Iterator[Entry]:
    motion, stamps = _regular(rates.water_rate, truth)
    for stamp, water in zip(stamps, motion.current, strict=True):
        yield Entry(stamp, "truth/water", Vector3Stamped(stamp, "map", water))


def _prior_map(scenario: Scenario, mapped: tuple[MappedFeature, ...]) -> PriorMap:
    return PriorMap(tuple(_prior_feature(f, scenario.world.datum) for f in mapped))


def _prior_feature(f: MappedFeature, datum: GeodeticPoint) -> PriorFeature:
    point = geodetic_from_enu(np.array([f.position[0], f.position[1], 0.0]), datum)
    place = (point.latitude, point.longitude, float(f.position[2]))
    return PriorFeature(f.id, *place, f.name, f.sigma, f.visibility, target=f.target)
