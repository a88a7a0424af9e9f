"""The mission cut into dives: from leaving the surface to being back at it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.series import Track
from fbn_common.types import NS

DEPTH = 1.0  # m: under it there is no GPS, and waves hardly reach
SHORTEST = 20.0  # s: less is a dip, not a dive


@dataclass(frozen=True, slots=True)
class Dive:
    """One dive; the number counts from 1."""

    number: int
    start_ns: int
    end_ns: int

    @property
    def duration(self) -> float:
        """[s]"""
        return (self.end_ns - self.start_ns) / NS

    def contains(self, stamp_ns: int) -> bool:
        """Is the stamp in this dive?"""
        return self.start_ns <= stamp_ns <= self.end_ns


def dives(track: Track, depth: float = DEPTH, shortest: float = SHORTEST) -> tuple[Dive, ...]:
    """All dives of a track: deeper than ``depth`` [m], with hysteresis of half of it, for at least ``shortest`` [s]."""
    below, found, start = -track.position[:, 2], [], -1
    for i, d in enumerate(below):
        if start < 0 and d > depth:
            start = i
        elif start >= 0 and d < depth / 2:
            found.append((start, i))
            start = -1
    if start >= 0:
        found.append((start, len(track) - 1))
    spans = [(int(track.stamp_ns[a]), int(track.stamp_ns[b])) for a, b in found]
    long = [(a, b) for a, b in spans if b - a >= shortest * NS]
    return tuple(Dive(n + 1, a, b) for n, (a, b) in enumerate(long))


def whole(track: Track) -> Dive:
    """The whole mission as one leg, for runs that never dive."""
    ends = track.stamp_ns[[0, -1]] if len(track) else np.zeros(2, dtype=np.int64)
    return Dive(1, int(ends[0]), int(ends[1]))
