"""Records to the bytes that travel and are logged, and back."""

from __future__ import annotations

import re
import struct
from typing import Any, Protocol, TypeVar

from fbn_common.records import Innovation, Record
from fbn_ros import innovations
from fbn_ros.conversion import Conversion, ConversionError, MessageFactory
from fbn_ros.flat import flat

R = TypeVar("R", bound=Record)

_BROKEN = (AssertionError, IndexError, ValueError, struct.error, MemoryError, RuntimeError)


class Serialiser(Protocol):
    """A family of message classes that can be made bytes and read again."""

    @property
    def factory(self) -> MessageFactory: ...

    @property
    def errors(self) -> tuple[type[Exception], ...]:
        """Raised by read for bytes that are no such message."""
        ...

    def write(self, message: Any, ros_type: str) -> bytes: ...

    def read(self, data: bytes, ros_type: str) -> Any: ...


class Quick(Protocol):
    """Serialising and reading one record type without a message; None says that these bytes need the slow way."""

    def encode(self, record: Any) -> bytes: ...

    def decode(self, data: bytes) -> Record | None: ...


class Cdr:
    """Serialised messages (CDR, little endian) of records; by rosbags unless another serialiser is given."""

    def __init__(self, serialiser: Serialiser | None = None) -> None:
        self.serialiser = serialiser or _of_rosbags()
        self.conversion = Conversion(self.serialiser.factory)
        self._quick_ways: dict[type, Quick | None] = {Innovation: innovations}
        self._narrow: dict[str, bool] = {}
        self._errors: tuple[type[BaseException], ...] = (*_BROKEN, *self.serialiser.errors)

    def encode(self, record: Record) -> bytes:
        """The bytes of the record's message."""
        quick = self.quick(type(record))
        if quick is not None:
            return quick.encode(record)
        return self.serialiser.write(self.conversion.to_message(record), record.ros_type)

    def outgoing(self, record: Record) -> Any:
        """What a publisher of these messages takes: bytes where there is the quick way, else the message itself.

        (The bytes that rclpy makes of a message by itself may have a tail of no meaning.)
        """
        quick = self.quick(type(record))
        return self.conversion.to_message(record) if quick is None else quick.encode(record)

    def decode(self, topic: str, record_type: type[R], data: bytes) -> R:
        """The record in a message's bytes, checked; raises ConversionError, also for bytes that are no such message."""
        quick = self.quick(record_type)
        record = None if quick is None else quick.decode(data)
        if record is not None:
            return record  # type: ignore[return-value]
        try:
            message = self.serialiser.read(data, record_type.ros_type)
        except self._errors as error:
            expected = f"the bytes of a {record_type.ros_type}"
            raise ConversionError(
                topic, "message", expected, f"{len(data)} bytes ({str(error) or 'malformed'})"
            ) from None
        return self.conversion.to_record(topic, record_type, message)

    def as_sent(self, record: R) -> R:
        """The record as a subscriber gets it: where its message has single-precision numbers, they are rounded."""
        if not self._narrows(record.ros_type):
            return record
        return self.decode(record.ros_type, type(record), self.encode(record))

    def quick(self, kind: type[Record]) -> Quick | None:
        """The way without a message, for a type that has one."""
        if kind not in self._quick_ways:
            self._quick_ways[kind] = flat(kind, self.serialiser.factory.field_types)
        return self._quick_ways[kind]

    def _narrows(self, ros_type: str) -> bool:
        """Whether a type holds single-precision numbers, itself or in a part."""
        if ros_type not in self._narrow:
            self._narrow[ros_type] = any(map(self._is_narrow, self.serialiser.factory.field_types(ros_type).values()))
        return self._narrow[ros_type]

    def _is_narrow(self, field_type: str) -> bool:
        item = re.sub(r"sequence<(.*)>|\[\d*\]", r"\1", field_type)
        return item == "float" or ("/" in item and self._narrows(item.replace("/", "/msg/")))


def _of_rosbags() -> Serialiser:
    from fbn_ros.definitions import RosbagsSerialiser  # slow to import, and no node needs it

    return RosbagsSerialiser()
