"""The launch file says what the graph declares; tried with stand-ins for ``launch``, which PyPI does not have."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from fbn_common.graph import GRAPH
from fbn_common.parameters import ParameterError

LAUNCH_FILE = Path(__file__).resolve().parents[1] / "src" / "fbn_bringup" / "launch" / "fbn.launch.py"


class Action(SimpleNamespace):
    """Any launch action: its class's name, and what it was made of."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(arguments=arguments, **named)


class LaunchConfiguration(Action):
    def perform(self, context: dict[str, str]) -> str:
        return context[self.arguments[0]]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The launch file, imported beside stand-ins."""
    names = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "SetEnvironmentVariable"),
        "launch.substitutions": ("EnvironmentVariable",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for module, classes in names.items():
        made = ModuleType(module)
        for name in classes:
            setattr(made, name, type(name, (Action,), {}))
        monkeypatch.setitem(sys.modules, module, made)
    sys.modules["launch.substitutions"].LaunchConfiguration = LaunchConfiguration  # type: ignore[attr-defined]
    spec = importlib.util.spec_from_file_location("fbn_launch", LAUNCH_FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def started(launch_file: ModuleType, **arguments: str) -> list[Any]:
    """The node actions, with these launch arguments over the declared defaults."""
    description = launch_file.generate_launch_description().arguments[0]
    declared = {a.arguments[0]: a.default_value for a in description if type(a).__name__ == "DeclareLaunchArgument"}
    function = next(a.function for a in description if type(a).__name__ == "OpaqueFunction")
    return list(function(declared | arguments))


def test_every_node_of_the_graph_is_started_from_its_package(launch_file: ModuleType) -> None:
    nodes = started(launch_file)
    assert [(n.package, n.executable, n.name) for n in nodes] == [(n.package, n.name, n.name) for n in GRAPH.nodes]
    assert all(n.namespace == "" and n.respawn for n in nodes)


def test_the_arguments_reach_the_nodes(launch_file: ModuleType, tmp_path: Path) -> None:
    file = tmp_path / "ranger.yaml"
    file.write_text("fbn_global:\n  ros__parameters:\n    verdict:\n      match_posterior: 0.5\n")
    nodes = started(launch_file, namespace="ranger", use_sim_time="true", log_level="debug", params_file=str(file))
    on_map = next(n for n in nodes if n.name == "fbn_global")
    assert on_map.namespace == "ranger"
    assert on_map.parameters[0]["verdict.match_posterior"] == 0.5
    assert on_map.parameters[0]["use_sim_time"] is True
    assert on_map.ros_arguments == ["--log-level", "debug"]


def test_a_wrong_parameter_file_stops_the_launch_before_anything_runs(launch_file: ModuleType, tmp_path: Path) -> None:
    file = tmp_path / "ranger.yaml"
    file.write_text("fbn_golbal:\n  ros__parameters: {}\n")
    with pytest.raises(ParameterError, match="no node 'fbn_golbal'"):
        started(launch_file, params_file=str(file))


def test_discovery_is_kept_on_this_host_by_default(launch_file: ModuleType) -> None:
    description = launch_file.generate_launch_description().arguments[0]
    settings = [a for a in description if type(a).__name__ == "SetEnvironmentVariable"]
    opened = next(a for a in settings if a.arguments[0] == "ROS_AUTOMATIC_DISCOVERY_RANGE")
    assert opened.arguments[1].default_value == "LOCALHOST"
