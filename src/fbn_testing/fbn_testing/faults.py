"""Faults in a log: what sensors, drivers and links do wrong, as functions from a log to a log."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from fbn_common.records import Record
from fbn_common.types import nanoseconds

Entry = tuple[int, str, Any]
Log = Iterable[Entry]


def dropped(log: Log, topic: str, after_ns: int = 0, until_ns: int = 2**62) -> Iterator[Entry]:
    """Without a topic's messages, between two log times."""
    return (e for e in log if e[1] != topic or not after_ns <= e[0] < until_ns)


def changed(log: Log, topic: str, change: Callable[[Any], Any], every: int = 1) -> Iterator[Entry]:
    """With every n-th record of a topic passed through a function."""
    count = 0
    for log_time_ns, name, record in log:
        if name == topic:
            count += 1
            if count % every == 0:
                record = change(record)
        yield log_time_ns, name, record


def frozen(log: Log, topic: str, after_ns: int) -> Iterator[Entry]:
    """With a topic's last good value repeated under new stamps."""
    last: Record | None = None
    for log_time_ns, name, record in log:
        if name == topic:
            if log_time_ns < after_ns or last is None:
                last = record
            else:
                record = dataclasses.replace(last, stamp_ns=record.stamp_ns)
        yield log_time_ns, name, record


def late(log: Log, topic: str, delay_s: float) -> Iterator[Entry]:
    """With a topic's messages arriving later, their stamps as they were."""
    delay = nanoseconds(delay_s)
    moved = [(t + delay if name == topic else t, name, record) for t, name, record in log]
    yield from sorted(moved, key=lambda e: e[0])


def restamped(log: Log, topic: str, shift_ns: int) -> Iterator[Entry]:
    """With a topic's stamps moved."""
    return changed(log, topic, lambda r: dataclasses.replace(r, stamp_ns=r.stamp_ns + shift_ns))


def duplicated(log: Log, topic: str) -> Iterator[Entry]:
    """With each message of a topic twice."""
    for entry in log:
        yield entry
        if entry[1] == topic:
            yield entry


def with_field(name: str, value: Any) -> Callable[[Any], Any]:
    """A change for :func:`changed`: one field replaced."""
    return lambda record: dataclasses.replace(record, **{name: value})
