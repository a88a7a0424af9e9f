"""Records to the bytes that travel and are logged, and back, without ROS."""

from __future__ import annotations

import struct
from typing import TypeVar

from rosbags.serde import SerdeError

from fbn_common.records import Record
from fbn_ros.conversion import Conversion, ConversionError
from fbn_ros.definitions import RosbagsMessages

R = TypeVar("R", bound=Record)

_BROKEN = (SerdeError, AssertionError, IndexError, ValueError, struct.error, MemoryError)


class Cdr:
    """Serialised messages (CDR, little endian) of records."""

    def __init__(self, messages: RosbagsMessages | None = None) -> None:
        self.messages = messages or RosbagsMessages()
        self.conversion = Conversion(self.messages)
        self._narrows: dict[str, bool] = {}

    def encode(self, record: Record) -> bytes:
        """The bytes of the record's message."""
        message = self.conversion.to_message(record)
        return bytes(self.messages.store.serialize_cdr(message, record.ros_type))

    def as_sent(self, record: R) -> R:
        """The record as a subscriber gets it: where its message has single-precision numbers, they are rounded."""
        ros_type = record.ros_type
        if ros_type not in self._narrows:
            self._narrows[ros_type] = self.messages.narrows(ros_type)
        if not self._narrows[ros_type]:
            return record
        return self.decode(ros_type, type(record), self.encode(record))

    def decode(self, topic: str, record_type: type[R], data: bytes) -> R:
        """The record in a message's bytes, checked; raises ConversionError, also for bytes that are no such message."""
        try:
            message = self.messages.store.deserialize_cdr(data, record_type.ros_type)
        except _BROKEN as error:
            expected = f"the bytes of a {record_type.ros_type}"
            raise ConversionError(topic, "message", expected, f"{len(data)} bytes ({error or 'malformed'})") from None
        return self.conversion.to_record(topic, record_type, message)
