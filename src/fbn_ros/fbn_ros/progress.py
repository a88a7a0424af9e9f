"""``replay/progress``: how many messages each has published, told after every step of a lock-step replay.

Thirty thousand of them go to every process in a replay of twenty minutes, so their bytes are written and read here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping

from fbn_common.graph import Qos, Topic
from fbn_common.records import NodeProgress, TopicCount
from fbn_common.types import NS

PROGRESS = Topic("replay/progress", NodeProgress, Qos.FLOW, 1000, "who has taken in which step of a replay")
PLAYER = "player"
FIRST_STEP = 1
REPORT = 0  # in place of a step, from the player: nothing comes any more, tell your health a last time

_PREFIX = b"\x00\x01\x00\x00"  # CDR, little endian; alignment counts from behind it
_TIME, _LENGTH, _COUNT = struct.Struct("<iI"), struct.Struct("<I"), struct.Struct("<Q")


def progress(node: str, step: int, stamp_ns: int, topics: Iterable[str], published: Mapping[str, int]) -> NodeProgress:
    """What a node tells after a step: every topic it speaks for, with what it has sent so far."""
    counts = tuple(TopicCount(topic, published.get(topic, 0)) for topic in topics)
    return NodeProgress(stamp_ns, "", node, step, counts)


def to_bytes(told: NodeProgress) -> bytes:
    """The bytes of its message."""
    body = bytearray(_TIME.pack(*divmod(told.stamp_ns, NS)))
    _put_text(body, told.frame_id)
    _put_text(body, told.node)
    _put_count(body, told.step)
    body += _LENGTH.pack(len(told.published))
    for topic, count in ((c.topic, c.count) for c in told.published):
        _put_text(body, topic)
        _put_count(body, count)
    return _PREFIX + bytes(body)


def from_bytes(data: bytes) -> NodeProgress:
    """The record in a message's bytes; ValueError for bytes that are no such message."""
    try:
        return _read(data)
    except (struct.error, IndexError) as error:
        raise ValueError(f"not a progress message: {error}") from error


def _read(data: bytes) -> NodeProgress:
    if data[:4] != _PREFIX:
        raise ValueError("not a progress message: other byte order")
    body = data[4:]
    sec, nanosec = _TIME.unpack_from(body, 0)
    frame_id, position = _text(body, 8)
    node, position = _text(body, position)
    step, position = _number(body, position)
    (n,) = _LENGTH.unpack_from(body, position)
    position += 4
    counts = []
    for _ in range(n):
        topic, position = _text(body, position)
        count, position = _number(body, position)
        counts.append(TopicCount(topic, count))
    return NodeProgress(sec * NS + nanosec, frame_id, node, step, tuple(counts))


def _put_text(body: bytearray, text: str) -> None:
    encoded = text.encode()
    body += b"\0" * (-len(body) % 4) + _LENGTH.pack(len(encoded) + 1) + encoded + b"\0"


def _put_count(body: bytearray, count: int) -> None:
    body += b"\0" * (-len(body) % 8) + _COUNT.pack(count)


def _text(body: bytes, position: int) -> tuple[str, int]:
    position += -position % 4
    (length,) = _LENGTH.unpack_from(body, position)
    return body[position + 4 : position + 3 + length].decode(), position + 4 + length


def _number(body: bytes, position: int) -> tuple[int, int]:
    position += -position % 8
    return _COUNT.unpack_from(body, position)[0], position + 8
