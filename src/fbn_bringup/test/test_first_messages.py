"""No node loads anything after its start: the first ping, fix, range and command find all compiled and imported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fbn_bringup.configuration import load_parameters
from fbn_bringup.offline import run_offline
from fbn_bringup.simulation import estimator_parameters
from fbn_common.graph import GRAPH
from fbn_common.parameters import dotted
from fbn_common.records import Record
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import simulate
from fbn_testing.first_messages import Played, in_new_process

BEACONS = {"a": (100.0, 0.0, -2.0), "b": (-100.0, 50.0, -2.0)}
LONG_ENOUGH_S = 45.0  # a first GPS fix takes 3 to 12 s, a composite half a minute
QUIET = {"predict/innovations", "tracking/innovations"}  # nothing is refused

Log = tuple[dict[str, Any], list[tuple[int, str, Record]]]


@pytest.fixture(scope="module")
def log() -> Log:
    """Parameters, and all that was said in 45 s with every sensor at work."""
    there = {f"sensors.lbl.beacons.{name}.position": xyz for name, xyz in BEACONS.items()}
    simulation = simulate(load_scenario("charles_river_2006", {"mission.limit": LONG_ENOUGH_S} | there), 1000)
    told = {f"reference.lbl.beacons.{n}.{c}": v for n, xyz in BEACONS.items() for c, v in zip("xyz", xyz, strict=True)}
    parameters = load_parameters(GRAPH, (), dotted(estimator_parameters(simulation)) | told)
    entries: list[tuple[int, str, Record]] = list(simulation.records())
    run_offline(GRAPH, parameters, list(entries), lambda t, topic, record: entries.append((t, topic, record)))
    return parameters, sorted(entries, key=lambda entry: entry[0])


@pytest.mark.parametrize("name", [node.name for node in GRAPH.nodes])
def test_after_its_start_a_node_compiles_loads_and_imports_nothing(name: str, log: Log, tmp_path: Path) -> None:
    parameters, entries = log
    node = GRAPH.node(name)
    heard = [e for e in entries if e[1] in (*node.inputs, *node.feedback)]
    assert {e[1] for e in heard} == {*node.inputs, *node.feedback}
    loaded = in_new_process(Played(name, parameters[name], heard), tmp_path / "played.pickle")
    assert set(node.outputs) - set(loaded.published) <= QUIET
    assert (loaded.kernels, loaded.modules) == ([], [])
