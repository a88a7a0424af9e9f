"""What every estimator is to those who run it: a synchronous, deterministic machine fed with stamped records.

``put`` only checks and keeps; ``advance`` does all the work, in an order that depends on stamps and never on
arrival.  So the live node (which advances on its timer), the lock-step replay and the offline runner (which
advance at the end of each step) run the same code, and what is put between two calls of ``advance`` may come
in any order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple, Protocol

from fbn_common.records import Record


class Output(NamedTuple):
    """A record to publish."""

    topic: str
    record: Record


class Level(IntEnum):
    """Health, as ``diagnostic_msgs/DiagnosticStatus`` counts it."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Health:
    """An estimator's state for ``/diagnostics``: one level, one line, and its counters."""

    level: Level
    message: str
    values: dict[str, int | float | str] = field(default_factory=dict)


class Estimator(Protocol):
    """One of the five (or the simulator's sensors, or what comes later)."""

    def put(self, topic: str, record: Record) -> None:
        """Take in one record; ``advance`` answers malformed or unwanted ones, an exception never does."""
        ...

    def advance(self, now_ns: int) -> list[Output]:
        """Process all that is stamped at or before ``now_ns``; what comes later with such a stamp is late data.

        ``now_ns`` does not decrease; a decrease means the clock jumped back: the estimator resets and says so.
        """
        ...

    def health(self) -> Health:
        """How it is; cheap, and without side effects."""
        ...
