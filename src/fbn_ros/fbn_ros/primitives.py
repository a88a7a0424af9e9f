"""The parts of serialised messages (CDR, little endian) that are written and read here for speed.

A body is what follows the four bytes of ``PREFIX``; alignment counts from its start.
"""

from __future__ import annotations

import struct

import numpy as np

from fbn_common.types import NS, Array

PREFIX = b"\x00\x01\x00\x00"
_TIME, _LENGTH, _COUNT = struct.Struct("<iI"), struct.Struct("<I"), struct.Struct("<Q")


def put_time(body: bytearray, stamp_ns: int) -> None:
    body += b"\0" * (-len(body) % 4) + _TIME.pack(*divmod(stamp_ns, NS))


def put_length(body: bytearray, length: int) -> None:
    body += b"\0" * (-len(body) % 4) + _LENGTH.pack(length)


def put_text(body: bytearray, text: str) -> None:
    encoded = text.encode()
    put_length(body, len(encoded) + 1)
    body += encoded + b"\0"


def put_count(body: bytearray, count: int) -> None:
    body += b"\0" * (-len(body) % 8) + _COUNT.pack(count)


def put_numbers(body: bytearray, numbers: Array) -> None:
    """A sequence of double-precision numbers."""
    put_length(body, len(numbers))
    if len(numbers):
        body += b"\0" * (-len(body) % 8) + np.ascontiguousarray(numbers, dtype="<f8").tobytes()


def time_at(body: bytes, position: int) -> tuple[int, int]:
    position += -position % 4
    sec, nanosec = _TIME.unpack_from(body, position)
    if nanosec >= NS:
        raise ValueError("a second has 1000000000 ns")
    return int(sec) * NS + int(nanosec), position + 8


def length_at(body: bytes, position: int) -> tuple[int, int]:
    position += -position % 4
    return int(_LENGTH.unpack_from(body, position)[0]), position + 4


def text_at(body: bytes, position: int) -> tuple[str, int]:
    length, position = length_at(body, position)
    if not 0 < length <= len(body) - position:
        raise ValueError("a text longer than its message")
    return body[position : position + length - 1].decode(), position + length


def count_at(body: bytes, position: int) -> tuple[int, int]:
    position += -position % 8
    return int(_COUNT.unpack_from(body, position)[0]), position + 8


def numbers_at(body: bytes, position: int) -> tuple[Array, int]:
    """A sequence of double-precision numbers, as a fresh array (n,)."""
    length, position = length_at(body, position)
    if not length:
        return np.zeros(0), position
    position += -position % 8
    return np.frombuffer(body, "<f8", length, position).copy(), position + 8 * length
