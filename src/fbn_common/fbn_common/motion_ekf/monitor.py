"""What comes in is watched: stamps out of bounds, duplicates, frozen and dead sensors are found and named."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from fbn_common.estimator import Health, Level
from fbn_common.records import Innovation, Verdict
from fbn_common.types import Array, nanoseconds, seconds

_NOTHING = np.empty(0)
_NOTHING.flags.writeable = False


@dataclass(slots=True)
class Watch:
    """One sensor's stream: its counters and what is wrong with it now."""

    frozen_after: int = 0  # equal values in a row that noise does not explain; 0 = never
    dead_after_s: float = 0.0  # silence that is worth a warning; 0 = never
    verdicts: Counter[str] = field(default_factory=Counter)
    newest_ns: int = -1
    began_ns: int = -1  # stamp of the value that is repeated since
    stopped: str = ""  # why its last measurements were refused, where that lasts
    _recent: deque[tuple[int, bytes]] = field(default_factory=lambda: deque(maxlen=400))
    _seen: set[tuple[int, bytes]] = field(default_factory=set)
    _value: bytes = b""
    _equal: int = 0

    def objection(self, stamp_ns: int, content: bytes, bounds: tuple[int, int]) -> tuple[Verdict, str] | None:
        """Why a measurement is not to be used; ``bounds``: oldest and newest stamp allowed."""
        oldest, newest = bounds
        if stamp_ns > newest:
            return Verdict.REFUSED, f"stamp {seconds(stamp_ns - newest):.3g} s too far ahead of the clock"
        if stamp_ns < oldest:
            return Verdict.LATE, f"older than the history by {seconds(oldest - stamp_ns):.3g} s"
        if (stamp_ns, content) in self._seen:
            return Verdict.REFUSED, "duplicate"
        self._remember(stamp_ns, content)
        self.newest_ns = max(self.newest_ns, stamp_ns)
        self._equal = self._equal + 1 if content == self._value else 0
        if not self._equal:
            self.began_ns = stamp_ns
        self._value = content
        self.stopped = ""
        if self.frozen_after and self._equal >= self.frozen_after:
            self.stopped = f"frozen: {self._equal + 1} equal values in a row"
            return Verdict.REFUSED, self.stopped
        return None

    def _remember(self, stamp_ns: int, content: bytes) -> None:
        if len(self._recent) == self._recent.maxlen:
            self._seen.discard(self._recent[0])
        self._recent.append((stamp_ns, content))
        self._seen.add((stamp_ns, content))

    def complaint(self, now_ns: int) -> str:
        """What is wrong with the sensor now; empty if nothing."""
        if self.stopped:
            return self.stopped
        if self.dead_after_s and self.newest_ns < 0:
            return "no data yet"
        if self.dead_after_s and now_ns - self.newest_ns > nanoseconds(self.dead_after_s):
            return f"no data for {seconds(now_ns - self.newest_ns):.1f} s"
        return ""


def refusal(stamp_ns: int, frame_id: str, sensor: str, verdict: Verdict, reason: str) -> Innovation:
    """The answer to a measurement that was not looked at."""
    return Innovation(stamp_ns, frame_id, sensor, 0.0, 0, verdict, reason, _NOTHING, _NOTHING)


def content_of(*values: object) -> bytes:
    """What two equal measurements have in common."""
    return b"|".join([v.tobytes() if isinstance(v, np.ndarray) else repr(v).encode() for v in values])


def all_finite(*values: float | Array) -> bool:
    """Whether every number in these floats and arrays is finite."""
    return all(map(_finite, values))


def _finite(value: float | Array) -> bool:
    if isinstance(value, np.ndarray):  # the sum of squares may overflow where every number is finite
        return isfinite(np.vdot(value, value)) or bool(np.isfinite(value).all())
    return isfinite(value)


def health_of(
    watches: dict[str, Watch], now_ns: int, notes: Iterable[str], values: dict[str, int | float | str]
) -> Health:
    """One line from all sensors' complaints and the estimator's own notes, and the counters."""
    complaints = [f"{name}: {text}" for name, w in watches.items() if (text := w.complaint(now_ns))]
    lines = [*notes, *complaints]
    counts: dict[str, int | float | str] = {
        f"{name}.{verdict.lower()}": n for name, w in watches.items() for verdict, n in sorted(w.verdicts.items())
    }
    return Health(Level.WARN if lines else Level.OK, "; ".join(lines) or "running", values | counts)
