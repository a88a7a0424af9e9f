"""Messages without ROS: rosbags' typestore of Jazzy with the definitions of ``fbn_msgs`` added."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fbn_common.types import Array


def definition_files() -> list[Path]:
    """The ``.msg`` files of ``fbn_msgs``: of the source tree that this is in, else of the workspace that is sourced.

    Raises FileNotFoundError saying where they were sought.
    """
    prefixes = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    sources = [parent for parent in Path(__file__).resolve().parents if (parent / "fbn_msgs").is_dir()]
    for place in (*sources, *prefixes):
        files = sorted((place / "fbn_msgs" / "msg").glob("*.msg"))
        if files:
            return files
    raise FileNotFoundError("no definitions of fbn_msgs: source the workspace they were built in (install/setup.bash)")


@functools.cache
def typestore() -> Typestore:
    """All types of Jazzy and of ``fbn_msgs``."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for file in definition_files():
        types |= get_types_from_msg(file.read_text(), f"fbn_msgs/msg/{file.stem}")
    store.register(types)
    return store


class RosbagsMessages:
    """The message classes of a typestore: a :class:`fbn_ros.conversion.MessageFactory`."""

    def __init__(self, store: Typestore | None = None) -> None:
        self.store = store or typestore()

    def message(self, ros_type: str) -> Callable[..., Any]:
        return self.store.types[ros_type]

    def numbers(self, ros_type: str, field: str) -> Callable[[Array | Sequence[int]], Any]:
        fields: dict[str, Any] = dict(self.store.fielddefs[ros_type][1])
        kind, description = fields[field]
        if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            raise TypeError(f"{ros_type}: {field} is not an array")
        dtype = np.dtype(description[0][1][0])
        return lambda values: np.asarray(values, dtype=dtype)

    def field_types(self, ros_type: str) -> Mapping[str, str]:
        return {name: _written(description) for name, description in self.store.fielddefs[ros_type][1]}


class RosbagsSerialiser:
    """rosbags' serialisation: a :class:`fbn_ros.cdr.Serialiser`."""

    errors: tuple[type[Exception], ...] = (SerdeError,)

    def __init__(self) -> None:
        self.factory = RosbagsMessages()

    def write(self, message: Any, ros_type: str) -> bytes:
        return bytes(self.factory.store.serialize_cdr(message, ros_type))

    def read(self, data: bytes, ros_type: str) -> Any:
        return self.factory.store.deserialize_cdr(data, ros_type)


def _written(description: Any) -> str:
    """A field's type as ROS's own Python messages write it."""
    kind, detail = description
    if kind is Nodetype.BASE:
        return {"float64": "double", "float32": "float", "bool": "boolean"}.get(detail[0], detail[0])
    if kind is Nodetype.NAME:
        return detail.replace("/msg/", "/")
    inner, length = detail
    return f"{_written(inner)}[{length}]" if kind is Nodetype.ARRAY else f"sequence<{_written(inner)}>"
