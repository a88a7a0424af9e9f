"""Counts, rates and times of a node at work, for its diagnostics; no ROS."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field

from fbn_common.types import NS


@dataclass(slots=True)
class Spread:
    """Mean and largest of a quantity since the last look."""

    count: int = 0
    total: float = 0.0
    largest: float = 0.0

    def add(self, value: float) -> None:
        self.count += 1
        self.total += value
        self.largest = max(self.largest, value)

    @property
    def mean(self) -> float:
        return self.total / self.count if self.count else 0.0


@dataclass(slots=True)
class Statistics:
    """What came in and how long the work took, since the last report and in all."""

    received: Counter[str] = field(default_factory=Counter)
    latency: dict[str, Spread] = field(default_factory=dict)  # s, arrival less stamp
    advance: Spread = field(default_factory=Spread)  # s
    lateness: Spread = field(default_factory=Spread)  # s, of the timer
    missed: int = 0  # of the timer's cycles, in all
    last_ns: dict[str, int] = field(default_factory=dict)
    _begin: float = field(default_factory=time.monotonic)
    _cpu: float = field(default_factory=time.process_time)

    def message(self, topic: str, stamp_ns: int, now_ns: int) -> None:
        """A message of this stamp has come."""
        self.received[topic] += 1
        self.last_ns[topic] = now_ns
        self.latency.setdefault(topic, Spread()).add((now_ns - stamp_ns) / NS)

    def tick(self, late_s: float, period_s: float) -> None:
        """The timer came so much later than a period after it came last: whole periods of that are cycles missed."""
        self.lateness.add(max(0.0, late_s))
        self.missed += int(max(0.0, late_s) / period_s)

    def silent(self, topics: tuple[str, ...], now_ns: int, limit_s: float) -> list[str]:
        """The topics on which nothing has come for so long."""
        return [t for t in topics if now_ns - self.last_ns.get(t, 0) > limit_s * NS]

    def report(self) -> dict[str, int | float | str]:
        """Figures since the last report, as text for people and numbers for plots; begins anew."""
        now, cpu = time.monotonic(), time.process_time()
        interval = max(now - self._begin, 1e-9)
        values: dict[str, int | float | str] = {"cpu [%]": round(100.0 * (cpu - self._cpu) / interval, 1)}
        values["advance mean [ms]"] = round(1e3 * self.advance.mean, 3)
        values["advance max [ms]"] = round(1e3 * self.advance.largest, 3)
        values["timer late max [ms]"] = round(1e3 * self.lateness.largest, 3)
        values["timer cycles missed"] = self.missed
        for topic, spread in sorted(self.latency.items()):
            values[f"{topic} count"] = self.received[topic]
            values[f"{topic} rate [Hz]"] = round(spread.count / interval, 2)
            values[f"{topic} latency mean [ms]"] = round(1e3 * spread.mean, 2)
            values[f"{topic} latency max [ms]"] = round(1e3 * spread.largest, 2)
        self.advance, self.lateness = Spread(), Spread()
        self.latency = {topic: Spread() for topic in self.latency}
        self._begin, self._cpu = now, cpu
        return values
