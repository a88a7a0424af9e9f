"""A simulated mission in step with a clock: which records are due now, with stamps in that clock's time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from fbn_sim.sensors.sample import Entry


class Playback:
    """Hands out a mission's records when their time has come; ``shift_ns`` is added to all its times.

    With ``rate`` the mission goes so much faster than the clock; its stamps then go at the mission's pace.
    """

    def __init__(self, entries: Sequence[Entry], begin_ns: int, shift_ns: int = 0, rate: float = 1.0) -> None:
        self._entries, self._next = entries, 0
        self._begin_ns, self._shift_ns, self._rate = begin_ns, shift_ns, rate

    @property
    def over(self) -> bool:
        """All records have been handed out."""
        return self._next >= len(self._entries)

    def time_ns(self, elapsed_ns: int) -> int:
        """The mission's time, shifted, when the clock has run for ``elapsed_ns``."""
        return self._begin_ns + round(elapsed_ns * self._rate) + self._shift_ns

    def due(self, elapsed_ns: int) -> Iterator[Entry]:
        """The records logged up to then that have not been handed out."""
        until = self.time_ns(elapsed_ns) - self._shift_ns
        while not self.over and self._entries[self._next].log_time_ns <= until:
            yield self._shifted(self._entries[self._next])
            self._next += 1

    def _shifted(self, entry: Entry) -> Entry:
        record = dataclasses.replace(entry.record, stamp_ns=entry.record.stamp_ns + self._shift_ns)
        return Entry(entry.log_time_ns + self._shift_ns, entry.topic, record)
