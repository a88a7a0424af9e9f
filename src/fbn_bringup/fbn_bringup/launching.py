"""What the launch file starts, without ``launch`` itself: arguments, and each node's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fbn_bringup.configuration import load_parameters, node_files
from fbn_common.graph import GRAPH, Graph


class Argument(NamedTuple):
    """A launch argument."""

    name: str
    default: str
    about: str


ARGUMENTS = (
    Argument("namespace", "", "put in front of all topics, e.g. ranger"),
    Argument("params_file", "", "ROS parameter file of the vehicle; empty: defaults"),
    Argument("use_sim_time", "false", "take the time from /clock"),
    Argument("log_level", "info", "debug, info, warn, error or fatal"),
)


def node_arguments(chosen: Mapping[str, str], graph: Graph = GRAPH) -> list[dict[str, Any]]:
    """Keyword arguments of ``launch_ros.actions.Node`` for every node; ParameterError if the file is wrong.

    The parameters go by value: sections of a file would not match once a namespace is in front of the names.
    """
    files = (Path(chosen["params_file"]),) if chosen["params_file"] else ()
    parameters = node_files(load_parameters(graph, files))
    sim_time = {"use_sim_time": chosen["use_sim_time"].lower() in ("true", "1")}
    return [
        {
            "package": node.package,
            "executable": node.name,
            "name": node.name,
            "namespace": chosen["namespace"],
            "parameters": [parameters[f"/**/{node.name}"]["ros__parameters"] | sim_time],
            "ros_arguments": ["--log-level", chosen["log_level"]],
            "output": "screen",
            "emulate_tty": True,
            "respawn": True,
            "respawn_delay": 1.0,
        }
        for node in graph.nodes
    ]
