"""``replay/progress/NODE``: how many messages a node has published, told after every step of a lock-step replay.

Thousands of them go to every process in a replay of twenty minutes: so each node has a topic of its own, which only
those subscribe to that wait for it, and the bytes are written and read here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping

from fbn_common.graph import Qos, Topic
from fbn_common.records import NodeProgress, TopicCount
from fbn_ros.primitives import (
    PREFIX,
    count_at,
    length_at,
    put_count,
    put_length,
    put_text,
    put_time,
    text_at,
    time_at,
)

PLAYER = "player"
FIRST_STEP = 1
REPORT = 0  # in place of a step, from the player: nothing comes any more, tell your health a last time


def progress_topic(node: str) -> Topic:
    """Where a node, or the player, tells how far it has come."""
    return Topic(f"replay/progress/{node}", NodeProgress, Qos.FLOW, 1000, "who has taken in which step of a replay")


def progress(node: str, step: int, stamp_ns: int, topics: Iterable[str], published: Mapping[str, int]) -> NodeProgress:
    """What a node tells after a step: every topic it speaks for, with what it has sent so far."""
    counts = tuple(TopicCount(topic, published.get(topic, 0)) for topic in topics)
    return NodeProgress(stamp_ns, "", node, step, counts)


def to_bytes(told: NodeProgress) -> bytes:
    """The bytes of its message."""
    body = bytearray()
    put_time(body, told.stamp_ns)
    put_text(body, told.frame_id)
    put_text(body, told.node)
    put_count(body, told.step)
    put_length(body, len(told.published))
    for topic, count in ((c.topic, c.count) for c in told.published):
        put_text(body, topic)
        put_count(body, count)
    return PREFIX + bytes(body)


def from_bytes(data: bytes) -> NodeProgress:
    """The record in a message's bytes; ValueError for bytes that are no such message."""
    if data[:4] != PREFIX:
        raise ValueError("not a progress message: other byte order")
    try:
        return _read(data[4:])
    except (struct.error, ValueError) as error:
        raise ValueError(f"not a progress message: {error}") from error


def _read(body: bytes) -> NodeProgress:
    stamp_ns, position = time_at(body, 0)
    frame_id, position = text_at(body, position)
    node, position = text_at(body, position)
    step, position = count_at(body, position)
    n, position = length_at(body, position)
    counts = []
    for _ in range(n):
        topic, position = text_at(body, position)
        count, position = count_at(body, position)
        counts.append(TopicCount(topic, count))
    return NodeProgress(stamp_ns, frame_id, node, step, tuple(counts))
