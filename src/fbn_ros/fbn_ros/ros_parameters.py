"""ROS parameters from an estimator's parameter class: names, defaults, descriptions; what is unknown is an error."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from fbn_common.parameters import Description, ParameterError, describe, flatten, load

OF_ROS = ("use_sim_time", "start_type_description_service", "lock_step")
OF_ROS_PREFIX = "qos_overrides."


def read_parameters(node: Node, cls: type[Any]) -> Any:
    """An instance of ``cls`` from the parameters that a node was given; all of it is then declared, read-only.

    The node must have been made with its overrides declared.  Raises ParameterError for unknown names, wrong types
    and failed checks.
    """
    own = {name: p.value for name, p in node.get_parameters_by_prefix("").items() if not _is_ros(name)}
    try:
        parameters = load(cls, own)
    except ParameterError as error:
        raise ParameterError(f"{node.get_name()}: {error}") from error
    about = {d.name: d for d in describe(cls)}
    for name, value in flatten(parameters).items():
        descriptor = ParameterDescriptor(
            description=_text(about.get(name)),
            read_only=True,
            dynamic_typing=True,
            additional_constraints="fixed at start",
        )
        if name in own:
            node.undeclare_parameter(name)
        node.declare_parameter(name, _value(value), descriptor, ignore_override=True)
    return parameters


def _is_ros(name: str) -> bool:
    return name in OF_ROS or name.startswith(OF_ROS_PREFIX)


def _text(description: Description | None) -> str:
    if description is None:
        return ""
    return f"{description.about} [{description.unit}]; from: {description.origin}"


def _value(value: Any) -> Any:
    """ROS knows no None and no list of mixed numbers."""
    if value is None:
        return ""
    if isinstance(value, list) and any(isinstance(v, float) for v in value):
        return [float(v) for v in value]
    return value
