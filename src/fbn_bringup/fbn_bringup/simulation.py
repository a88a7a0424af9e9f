"""Scenarios of the simulator written to disk: the bag, its prior map, its truth, and what the estimators must know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from fbn_sim.simulation import Simulation

Advance = Callable[[float, str], None]
PARAMETER_FILE = "parameters.yaml"


def project_root() -> Path | None:
    """The source tree this runs from; None when installed elsewhere."""
    for parent in Path(__file__).resolve().parents:
        if (parent / "Makefile").is_file() and (parent / "src").is_dir():
            return parent
    return None


def scenarios() -> dict[str, str]:
    """What the scenarios that come along show, by name."""
    from fbn_sim.scenario import load_scenario, scenario_names

    return {name: load_scenario(name).about for name in scenario_names()}


def simulate_to_bag(scenario: str, target: Path, seed: int | None, advance: Advance = lambda _f, _t: None) -> Path:
    """Simulate into a new directory: bag, prior map, truth and the estimators' parameters; gives the directory.

    Raises ParameterError for a wrong scenario, BagError where the bag cannot be written.
    """
    from fbn_sim.bag import write_bag
    from fbn_sim.scenario import load_scenario
    from fbn_sim.simulation import simulate

    loaded = load_scenario(scenario)
    advance(0.0, "the mission (the first time, kernels are compiled)")
    simulation = simulate(loaded, seed)
    write_bag(simulation, target, lambda fraction: advance(0.3 + 0.7 * fraction, "the bag"))
    (target / PARAMETER_FILE).write_text(parameter_text(simulation))
    return target


def parameter_text(simulation: Simulation) -> str:
    """A ROS parameter file with what an estimator cannot guess."""
    document = {node: {"ros__parameters": values} for node, values in estimator_parameters(simulation).items()}
    about = "# What the estimators must know of this vehicle; for all else the defaults hold.\n"
    return about + yaml.safe_dump(document, sort_keys=False, default_flow_style=None)


def estimator_parameters(simulation: Simulation) -> dict[str, dict[str, Any]]:
    """What an estimator cannot guess: the sonar arrays' mounts and fields of view, for those that ask for them."""
    from fbn_bringup.catalogue import parameter_class
    from fbn_common.graph import GRAPH

    arrays = {name: _plain(array) for name, array in simulation.scenario.sensors.sonar.arrays.items()}
    asking = (n.name for n in GRAPH.nodes if "arrays" in parameter_class(n).__dataclass_fields__)
    return {name: {"arrays": arrays} for name in asking}


def _plain(group: Any) -> dict[str, Any]:
    values = asdict(group) if is_dataclass(group) and not isinstance(group, type) else dict(group)
    return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
