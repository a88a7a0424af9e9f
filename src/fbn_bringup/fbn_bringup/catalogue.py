"""Parameters and topics as lists and tables: for ``fbn params``, and for the generated pages of the docs."""

from __future__ import annotations

import textwrap
from importlib import import_module
from typing import Any, cast

import yaml

from fbn_common.graph import GRAPH, SIMULATOR_TOPICS, Node, Topic
from fbn_common.parameters import Description, describe


def parameter_class(node: Node) -> type[Any]:
    """The dataclass that holds a node's parameters."""
    module, name = node.parameters.split(":")
    return cast(type[Any], getattr(import_module(module), name))


def parameters(node: str = "") -> dict[str, list[Description]]:
    """Descriptions by node; of one node or all. KeyError names the nodes there are."""
    nodes = (GRAPH.node(node),) if node else GRAPH.nodes
    return {n.name: list(describe(parameter_class(n))) for n in nodes}


def plain(d: Description) -> dict[str, Any]:
    """A description as plain values."""
    default = list(d.default) if isinstance(d.default, tuple) else d.default
    return {"name": d.name, "default": default, "unit": d.unit, "about": d.about, "origin": d.origin}


def parameter_file(chosen: dict[str, list[Description]]) -> str:
    """A ROS parameter file with every default, its unit and origin in a comment."""
    lines: list[str] = []
    for node, items in chosen.items():
        lines += [f"{node}:", "  ros__parameters:"]
        for d in items:
            value = yaml.safe_dump(plain(d)["default"], default_flow_style=True).strip().removesuffix("\n...")
            switched_off = "# " if "<name>" in d.name or d.default in ("required", None) else ""
            lines += textwrap.wrap(
                f"{d.about} [{d.unit}]; {d.origin}", 108, initial_indent="    # ", subsequent_indent="    #   "
            )
            lines += [f"    {switched_off}{d.name}: {value}"]
    return "\n".join(lines) + "\n"


def parameter_page() -> str:
    """docs/parameters.md."""
    lines = ["# Parameters", "", "Generated from the parameter classes by `fbn docs`; do not edit.", ""]
    lines += [
        "`fbn params NODE --yaml` writes a file to start from. A name with `<name>` stands for one group per name.",
        "",
    ]
    for node, items in parameters().items():
        lines += [
            f"## {node}",
            "",
            GRAPH.node(node).about + ".",
            "",
            "| name | default | unit | what | origin |",
            "| --- | --- | --- | --- | --- |",
        ]
        lines += [
            f"| `{d.name}` | {_cell(_short(d.default))} | {_cell(d.unit)} | {_cell(d.about)} | {_cell(d.origin)} |"
            for d in items
        ]
        lines += [""]
    return "\n".join(lines)


def topic_page() -> str:
    """docs/topics.md."""
    lines = ["# Topics", "", "Generated from the graph by `fbn docs`; do not edit.", ""]
    lines += ["Names are relative: a vehicle's namespace goes in front. QoS:", ""]
    lines += [f"- *{role}*: {text}" for role, text in _qos().items()] + [""]
    made = [t for t in GRAPH.topics.values() if GRAPH.publisher(t.name) is None]
    groups = [("Sensors, from the vehicle or the log", made)]
    groups += [(f"From {n.name}", [GRAPH.topics[t] for t in n.outputs]) for n in GRAPH.nodes]
    groups += [("From the simulator; no estimator takes them", list(SIMULATOR_TOPICS))]
    for title, topics in groups:
        lines += [
            f"## {title}",
            "",
            "| topic | type | QoS | taken by | what | without it |",
            "| --- | --- | --- | --- | --- | --- |",
        ]
        lines += [_topic_row(t) for t in topics] + [""]
    return "\n".join(lines)


def _head(*columns: str) -> list[str]:
    return ["| " + " | ".join(columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]


def takers(topic: str) -> list[str]:
    """The nodes that subscribe to a topic."""
    return [n.name for n in GRAPH.nodes if topic in (*n.inputs, *n.feedback)]


def _topic_row(t: Topic) -> str:
    taken = ", ".join(name.removeprefix("fbn_") for name in takers(t.name)) or "–"
    kind = t.ros_type.replace("/msg/", "/")
    cells = (f"`{t.name}`", f"`{kind}`", f"{t.qos.name.lower()}, {t.depth}", taken, t.about, t.without or "–")
    return "| " + " | ".join(map(_cell, cells)) + " |"


def _qos() -> dict[str, str]:
    return {t.qos.name.lower(): t.qos.value for t in GRAPH.topics.values()}


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_short(v) for v in value) + "]"
    return str(value)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
