"""``/diagnostics``: an estimator's health and its node's statistics as one status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fbn_common.estimator import Health, Level
from fbn_common.graph import GRAPH, Node
from fbn_ros.conversion import MessageFactory, time_codec


def diagnostic_array(
    factory: MessageFactory,
    stamp_ns: int,
    node: Node,
    health: Health,
    statistics: Mapping[str, Any],
    silent: Sequence[str] = (),
    gone: Sequence[str] = (),
) -> Any:
    """A ``diagnostic_msgs/DiagnosticArray`` of one node; silent inputs and lost publishers are named."""
    status, key_value = (factory.message(f"diagnostic_msgs/msg/{n}") for n in ("DiagnosticStatus", "KeyValue"))
    header = factory.message("std_msgs/msg/Header")(stamp=time_codec(factory).encode(stamp_ns), frame_id="")
    values = {"silent": " ".join(silent), "gone": " ".join(gone), **health.values, **statistics}
    message = status(
        level=bytes([max(health.level, Level.WARN if gone else Level.OK)]),
        name=f"{node.name}: estimator",
        message="; ".join(
            (health.message, *(_without(t) for t in (*gone, *silent) if t not in silent or t not in gone))
        ),
        hardware_id=node.name,
        values=[key_value(key=k, value=_text(v)) for k, v in values.items()],
    )
    return factory.message("diagnostic_msgs/msg/DiagnosticArray")(header=header, status=[message])


def _without(topic: str) -> str:
    without = GRAPH.topics[topic].without if topic in GRAPH.topics else ""
    return f"nothing on {topic}" + (f" ({without})" if without else "")


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
