"""Scenarios: world, map and its errors, vehicle, sea, sensors and their faults, mission, seed, in one YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import yaml

from fbn_common.graph import GRAPH
from fbn_common.named_file import file_names, read_named
from fbn_common.parameters import ParameterError, dotted, group, load, param
from fbn_common.sonar_file import beside
from fbn_sim.faults import Fault
from fbn_sim.mission import Mission
from fbn_sim.sea import Sea
from fbn_sim.sensors.actuation import Actuation
from fbn_sim.sensors.compass import Compass
from fbn_sim.sensors.depth import Altimeter, Pressure
from fbn_sim.sensors.position import Gps, Lbl
from fbn_sim.sensors.sonar import Sonar
from fbn_sim.vehicle import Vehicle
from fbn_sim.world import MapErrors, World


@dataclass(frozen=True, slots=True)
class Truth:
    """How often the truth is logged."""

    odometry_rate: float = param(2.0, "Hz", "of truth/odometry", "modest")
    water_rate: float = param(0.2, "Hz", "of truth/water", "it varies slowly")


@dataclass(frozen=True, slots=True)
class Sensors:
    """All sensors; a timing.rate of 0 takes one off."""

    compass: Compass = group(Compass)
    pressure: Pressure = group(Pressure)
    altimeter: Altimeter = group(Altimeter)
    gps: Gps = group(Gps)
    lbl: Lbl = group(Lbl)
    actuators: Actuation = group(Actuation)
    sonar: Sonar = group(Sonar)
    truth: Truth = group(Truth)


@dataclass(frozen=True, slots=True)
class Scenario:
    """All that a simulated mission is made from."""

    name: str = param("", "-", "name of the scenario", "scenario")
    about: str = param("", "-", "what it shows", "scenario")
    seed: int = param(1, "-", "of all random numbers, unless another is given", "scenario")
    start_time: int = param(1_159_884_000, "s", "time of day at the start, since 1970", "3 October 2006, 14:00 UTC")
    time_step: float = param(0.02, "s", "of the integration of motion; 0.1 s must be a multiple", "stable to 0.05 s")
    world: World = group(World)
    prior_map: MapErrors = group(MapErrors)
    vehicle: Vehicle = group(Vehicle)
    sea: Sea = group(Sea)
    sensors: Sensors = group(Sensors)
    faults: dict[str, Fault] = group(dict)
    mission: Mission = group(Mission)

    def __post_init__(self) -> None:
        if self.time_step <= 0.0 or abs(0.1 / self.time_step - round(0.1 / self.time_step)) > 1e-9:
            raise ParameterError("time_step must divide 0.1 s")
        for name, fault in self.faults.items():
            if fault.topic not in GRAPH.external_inputs():
                topics = ", ".join(GRAPH.external_inputs())
                raise ParameterError(f"faults.{name}.topic: no sensor's topic {fault.topic!r}; there are {topics}")


def scenario_names() -> tuple[str, ...]:
    """The scenarios that come with the package."""
    return file_names(_directory())


def load_scenario(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of this name or in this file, with dotted names overridden (``{"sea.current_speed_max": 0.2}``).

    Raises ParameterError for an unknown scenario, an unreadable file, or a wrong key, which it names.
    """
    text = read_named(name_or_path, _directory(), "scenario")
    try:
        document = yaml.safe_load(text) or {}
    except yaml.YAMLError as error:
        raise ParameterError(f"{name_or_path}: not readable as YAML: {error}") from error
    if not isinstance(document, Mapping):
        raise ParameterError(f"{name_or_path}: a scenario is a mapping, got {type(document).__name__}")
    return load(Scenario, beside(dotted(document), Path(name_or_path)) | dict(overrides or {}))


def _directory() -> Traversable:
    return resources.files("fbn_sim").joinpath("data", "scenarios")
