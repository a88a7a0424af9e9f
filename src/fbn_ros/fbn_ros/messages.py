"""The message classes that rclpy publishes."""

from __future__ import annotations

import importlib
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from fbn_common.types import Array

_TYPECODES = {"double": "d", "float": "f", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q"}
_DTYPES = {"double": np.float64, "float": np.float32}


class RclpyMessages:
    """ROS's own Python messages: a :class:`fbn_ros.conversion.MessageFactory`."""

    def message(self, ros_type: str) -> Callable[..., Any]:
        package, _, name = ros_type.split("/")
        try:
            return getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            raise KeyError(f"no message {ros_type}: is its package built, and its workspace sourced?") from None

    def numbers(self, ros_type: str, field: str) -> Callable[[Array | Sequence[int]], Any]:
        """Fixed arrays stay numpy; sequences become ``array.array``, which rclpy takes as they are."""
        declared: str = self.message(ros_type).get_fields_and_field_types()[field]  # type: ignore[attr-defined]
        if (fixed := re.fullmatch(r"(\w+)\[\d+\]", declared)) is not None:
            dtype = _DTYPES[fixed[1]]
            return lambda values: np.asarray(values, dtype=dtype)
        code = _TYPECODES[declared.removeprefix("sequence<").removesuffix(">")]
        return lambda values: array(code, np.asarray(values, dtype=code).tobytes())

    def field_types(self, ros_type: str) -> Mapping[str, str]:
        return self.message(ros_type).get_fields_and_field_types()  # type: ignore[attr-defined]


class RclpySerialiser:
    """ROS's own serialisation: a :class:`fbn_ros.cdr.Serialiser`."""

    errors: tuple[type[Exception], ...] = ()  # what it raises is a RuntimeError

    def __init__(self) -> None:
        self.factory = RclpyMessages()

    def write(self, message: Any, ros_type: str) -> bytes:
        return bytes(serialize_message(message))

    def read(self, data: bytes, ros_type: str) -> Any:
        return deserialize_message(data, self.factory.message(ros_type))
