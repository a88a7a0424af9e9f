"""Records to ROS messages and back, for rclpy's messages and rosbags' alike; no ROS import.

The messages of ``fbn_msgs`` are converted by what their records declare (see ``fbn_common.records``): the fields'
types and shapes are compiled once per type into a list of functions.  Standard messages have theirs in
:mod:`fbn_ros.standard`.  Data is checked here, at the edge, once: what :meth:`Conversion.to_record` returns has the
right shapes, finite numbers and usable rotations and covariances.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from math import isqrt
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from fbn_common.records import Pose, Record
from fbn_common.types import NS, Array

R = TypeVar("R", bound=Record)


class ConversionError(ValueError):
    """A message that no record can be made of: which topic, which field, what was expected, and what came.

    ``stamp_ns`` is the message's stamp where that could be read, else 0.
    """

    def __init__(self, topic: str, field: str, expected: str, got: str, stamp_ns: int = 0) -> None:
        super().__init__(f"{topic}: {field}: expected {expected}, got {got}")
        self.topic, self.field, self.expected, self.got, self.stamp_ns = topic, field, expected, got, stamp_ns


class Malformed(ValueError):
    """As ConversionError, where the topic is not known yet."""

    def __init__(self, field: str, expected: str, got: str) -> None:
        super().__init__(f"{field}: expected {expected}, got {got}")
        self.field, self.expected, self.got = field, expected, got


class MessageFactory(Protocol):
    """A family of message classes with ROS's attribute names."""

    def message(self, ros_type: str) -> Callable[..., Any]:
        """The class of this type, to be called with its fields by name; KeyError if it is not known."""
        ...

    def numbers(self, ros_type: str, field: str) -> Callable[[Array | Sequence[int]], Any]:
        """What turns a flat array into the value of this field, in the field's own number type."""
        ...

    def field_types(self, ros_type: str) -> Mapping[str, str]:
        """The type's fields in order, with their types as ROS writes them (``double[36]``)."""
        ...


class Codec(NamedTuple):
    """How one field's value goes into a message and comes back."""

    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]


class Fields(NamedTuple):
    """A type's fields: record attribute, message attribute, codec."""

    to_message: Callable[[Any], Any]
    to_record: Callable[[Any], Any]


class Conversion:
    """Both directions for one family of messages; the functions per type are made at first use and kept."""

    def __init__(self, factory: MessageFactory) -> None:
        from fbn_ros import standard  # it builds on this module

        self.factory = factory
        self._fields: dict[type, Fields] = dict(standard.conversions(factory))

    def to_message(self, record: Record) -> Any:
        """The ROS message of a record."""
        return self._of(type(record)).to_message(record)

    def to_record(self, topic: str, record_type: type[R], message: Any) -> R:
        """The record of a ROS message, checked; ConversionError names topic, field, expected and got."""
        from fbn_ros.validation import check

        try:
            record = self._of(record_type).to_record(message)
            check(record)
        except Malformed as error:
            stamp = message.header.stamp
            stamp_ns = int(stamp.sec) * NS + min(int(stamp.nanosec), NS - 1)
            raise ConversionError(topic, error.field, error.expected, error.got, stamp_ns) from None
        return typing.cast(R, record)

    def _of(self, record_type: type) -> Fields:
        fields = self._fields.get(record_type)
        if fields is None:
            fields = self._fields[record_type] = self._compile(record_type)
        return fields

    def _compile(self, record_type: Any) -> Fields:
        """Conversion of an ``fbn_msgs`` type by its declaration."""
        ros_type = record_type.ros_type
        stamped = issubclass(record_type, Record)
        hints = typing.get_type_hints(record_type)
        plain = [f for f in dataclasses.fields(record_type) if not (stamped and f.name in ("stamp_ns", "frame_id"))]
        lacking = {f.name.removesuffix("_ns") for f in plain} - set(self.factory.field_types(ros_type))
        if lacking:
            raise TypeError(f"{ros_type} as built lacks {', '.join(sorted(lacking))}: build fbn_msgs anew (make setup)")
        steps = [(f.name, f.name.removesuffix("_ns"), self._codec(ros_type, f, hints[f.name])) for f in plain]
        message_type = self.factory.message(ros_type)
        framed = "frame_id" in hints
        header = header_codec(self.factory)

        def to_message(record: Any) -> Any:
            values = {there: codec.encode(getattr(record, here)) for here, there, codec in steps}
            if stamped:
                values["header"] = header.encode((record.stamp_ns, record.frame_id if framed else ""))
            return message_type(**values)

        def to_record(message: Any) -> Any:
            values = {here: named(there, codec, getattr(message, there)) for here, there, codec in steps}
            if stamped:
                values["stamp_ns"], frame_id = header.decode(message.header)
                if framed:
                    values["frame_id"] = frame_id
            return record_type(**values)

        return Fields(to_message, to_record)

    def _codec(self, ros_type: str, field: dataclasses.Field[Any], hint: Any) -> Codec:
        if field.name.endswith("_ns"):
            return time_codec(self.factory)
        if "shape" in field.metadata:
            return array_codec(field.metadata["shape"], self.factory.numbers(ros_type, field.name))
        if hint is Pose:
            return pose_codec(self.factory)
        if typing.get_origin(hint) is tuple:
            return self._tuple_codec(ros_type, field.name, typing.get_args(hint)[0])
        if dataclasses.is_dataclass(hint):
            nested = self._of(typing.cast(type, hint))
            return Codec(nested.to_message, nested.to_record)
        if issubclass(hint, IntEnum):
            return Codec(int, lambda value: _member(hint, value))
        return Codec(hint, hint)

    def _tuple_codec(self, ros_type: str, name: str, item: Any) -> Codec:
        if item is int:
            return Codec(self.factory.numbers(ros_type, name), lambda values: tuple(int(v) for v in values))
        if item is str:
            return Codec(list, tuple)
        nested = self._of(item)
        return Codec(
            lambda values: [nested.to_message(v) for v in values],
            lambda values: tuple(named(str(i), nested.to_record, v) for i, v in enumerate(values)),
        )


def named(name: str, codec: Codec | Callable[[Any], Any], value: Any) -> Any:
    """Decode, with the field's name put in front of what an error says."""
    decode = codec.decode if isinstance(codec, Codec) else codec
    try:
        return decode(value)
    except Malformed as error:
        field = f"{name}.{error.field}" if error.field else name
        raise Malformed(field, error.expected, error.got) from None


def _member(enumeration: type[IntEnum], value: Any) -> IntEnum:
    try:
        return enumeration(value)
    except ValueError:
        raise Malformed("", " or ".join(f"{m.value} ({m.name})" for m in enumeration), str(value)) from None


# --- the parts that all messages are made of ---------------------------------------------------------------


def array_codec(shape: tuple[int, ...], numbers: Callable[[Array], Any]) -> Codec:
    """A float64 array of this shape (-1: any length; (-1, -1): square) as a flat row-major sequence.

    What comes back is always a fresh, aligned, C-ordered, writable array: compiled kernels are specialised on that.
    """
    size = int(np.prod(shape)) if -1 not in shape else -1

    def decode(values: Any) -> Array:
        flat = np.array(values, dtype=np.float64)
        if size >= 0:
            if flat.size != size:
                raise Malformed("", f"{size} numbers", str(flat.size))
            return flat.reshape(shape)
        if len(shape) == 1:
            return flat
        n = isqrt(flat.size)
        if n * n != flat.size:
            raise Malformed("", "a square matrix", f"{flat.size} numbers")
        return flat.reshape(n, n)

    if len(shape) == 1:
        return Codec(numbers, decode)
    return Codec(lambda values: numbers(np.ascontiguousarray(values).reshape(-1)), decode)


def time_codec(factory: MessageFactory) -> Codec:
    """Integer nanoseconds as ``builtin_interfaces/Time``."""
    time = factory.message("builtin_interfaces/msg/Time")

    def encode(stamp_ns: int) -> Any:
        sec, nanosec = divmod(stamp_ns, NS)
        return time(sec=sec, nanosec=nanosec)

    def decode(stamp: Any) -> int:
        if stamp.nanosec >= NS:
            raise Malformed("nanosec", "less than a second", f"{stamp.nanosec}")
        return int(stamp.sec) * NS + int(stamp.nanosec)

    return Codec(encode, decode)


def header_codec(factory: MessageFactory) -> Codec:
    """``(stamp_ns, frame_id)`` as ``std_msgs/Header``."""
    header, time = factory.message("std_msgs/msg/Header"), time_codec(factory)

    def encode(value: tuple[int, str]) -> Any:
        return header(stamp=time.encode(value[0]), frame_id=value[1])

    return Codec(encode, lambda h: (named("header.stamp", time, h.stamp), str(h.frame_id)))


def vector_codec(factory: MessageFactory, kind: str = "Vector3") -> Codec:
    """An array (3,) as ``geometry_msgs/Vector3`` or ``Point``."""
    vector = factory.message(f"geometry_msgs/msg/{kind}")

    def encode(v: Array) -> Any:
        x, y, z = v.tolist()
        return vector(x=x, y=y, z=z)

    return Codec(encode, lambda v: np.array((v.x, v.y, v.z), dtype=np.float64))


def quaternion_codec(factory: MessageFactory) -> Codec:
    """An array (4,) x, y, z, w as ``geometry_msgs/Quaternion``."""
    quaternion = factory.message("geometry_msgs/msg/Quaternion")

    def encode(q: Array) -> Any:
        x, y, z, w = q.tolist()
        return quaternion(x=x, y=y, z=z, w=w)

    return Codec(encode, lambda q: np.array((q.x, q.y, q.z, q.w), dtype=np.float64))


def pose_codec(factory: MessageFactory) -> Codec:
    """A :class:`Pose` as ``geometry_msgs/Pose``."""
    pose = factory.message("geometry_msgs/msg/Pose")
    point, quaternion = vector_codec(factory, "Point"), quaternion_codec(factory)
    return Codec(
        lambda p: pose(position=point.encode(p.position), orientation=quaternion.encode(p.orientation)),
        lambda p: Pose(point.decode(p.position), quaternion.decode(p.orientation)),
    )
