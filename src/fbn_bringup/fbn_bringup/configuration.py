"""The parameters of every node of a graph: defaults, then files, then overrides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from fbn_common.graph import Graph, Node
from fbn_common.parameters import ParameterError, flatten, load, read_yaml
from fbn_common.sonar_file import beside
from fbn_ros.host import resolve

Parameters = dict[str, Any]  # node name -> instance of its parameter class


def load_parameters(graph: Graph, files: Sequence[Path] = (), overrides: Mapping[str, Any] | None = None) -> Parameters:
    """Every node's parameters; later files win over earlier ones, overrides (``node.parameter``) over all.

    Raises ParameterError for a file that cannot be read, an unknown node, and unknown or wrong parameters.
    """
    chosen = _by_node(graph, overrides or {})
    for file in files:
        _check_sections(graph, file)
    return {node.name: _load_node(node, files, chosen.get(node.name, {})) for node in graph.nodes}


def effective(parameters: Parameters) -> dict[str, dict[str, Any]]:
    """Plain names and values by node, as a ROS parameter file holds them."""
    return {name: {"ros__parameters": flatten(values)} for name, values in parameters.items()}


def node_files(parameters: Parameters) -> dict[str, Any]:
    """The effective parameters as a ROS parameter file that holds in any namespace.

    ROS has neither null nor empty lists in such files: those that are, are left to their defaults.
    """
    document = {}
    for name, values in parameters.items():
        plain = {k: v for k, v in flatten(values).items() if v not in (None, [])}
        document[f"/**/{name}"] = {"ros__parameters": plain}
    return document


def _load_node(node: Node, files: Sequence[Path], overrides: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = {}
    for file in files:
        values |= beside(read_yaml(file, node.name), file)
    try:
        return load(resolve(node.parameters), values | dict(overrides))
    except ParameterError as error:
        raise ParameterError(f"{node.name}: {error}") from error


def _by_node(graph: Graph, overrides: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    chosen: dict[str, dict[str, Any]] = {}
    for name, value in overrides.items():
        node, _, parameter = name.partition(".")
        try:
            chosen.setdefault(graph.node(node).name, {})[parameter] = value
        except KeyError as error:
            raise ParameterError(f"{name}: {error.args[0]}; write node.parameter=value") from error
    return chosen


def _check_sections(graph: Graph, file: Path) -> None:
    """A section for a node that does not exist is a misspelling, not a comment."""
    from fbn_common.graph import GRAPH

    try:
        document = yaml.safe_load(file.read_text())
    except (OSError, yaml.YAMLError):
        return  # read_yaml says it better
    known = {n.name for n in (*graph.nodes, *GRAPH.nodes)} | {"/**"}
    unknown = sorted(set(document or ()) - known) if isinstance(document, dict) else []
    if unknown:
        raise ParameterError(f"{file}: no node {unknown[0]!r}; there are {', '.join(sorted(known - {'/**'}))}")
