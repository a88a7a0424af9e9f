"""The actuators' commands of the last seconds, held from stamp to stamp and averaged over a step."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from math import isnan, nan, pi

import numpy as np
import numpy.typing as npt

from fbn_common.records import JointState
from fbn_common.types import Array

IntArray = npt.NDArray[np.int64]
ACTUATORS = ("propeller", "pan", "tilt", "rudder", "stern_plane")
_NEVER = -(1 << 60)  # ns
_LARGEST = (2000.0, pi, pi, pi, pi)  # rad/s, rad: beyond is no actuator's


class Malformed(Exception):
    """A command that cannot be used; the text says why."""


def actuator_values(record: JointState) -> Array:
    """Propeller [rad/s], pan, tilt, rudder, stern plane [rad] (5,); NaN where the record does not name one.

    Raises Malformed.
    """
    values = [nan] * len(ACTUATORS)
    for i, name in enumerate(record.name):
        if name not in ACTUATORS:
            continue
        column = record.velocity if name == "propeller" else record.position
        if len(column) != len(record.name):
            raise Malformed(f"{len(record.name)} names, but {len(column)} values for {name}")
        value = float(column[i])
        at = ACTUATORS.index(name)
        if not abs(value) <= _LARGEST[at]:
            raise Malformed(f"{name} is {value}, not within +-{_LARGEST[at]:.4g}")
        values[at] = value
    if all(map(isnan, values)):
        raise Malformed(f"names none of {', '.join(ACTUATORS)}: {record.name}")
    return np.array(values)


class Commands:
    """Commands sorted by stamp; before the first one nothing moves."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._values: list[Array] = []

    @property
    def oldest_ns(self) -> int:
        """-1 without commands."""
        return self._stamps[0] if self._stamps else -1

    @property
    def newest_ns(self) -> int:
        """-1 without commands."""
        return self._stamps[-1] if self._stamps else -1

    def put(self, stamp_ns: int, values: Array) -> bool:
        """Take a command; an actuator it does not name keeps its angle.  False if it changes nothing."""
        at = bisect_left(self._stamps, stamp_ns)
        held = self._values[at - 1] if at else np.zeros(len(ACTUATORS))
        filled = np.where(np.isnan(values), held, values)
        if at < len(self._stamps) and self._stamps[at] == stamp_ns:
            if np.array_equal(self._values[at], filled):
                return False
            self._values[at] = filled
            return True
        self._stamps.insert(at, stamp_ns)
        self._values.insert(at, filled)
        return True

    def means(self, start_ns: int, step_ns: int, count: int) -> Array:
        """The commands' mean over each of these steps (count, 5): a stamp moved a little moves the mean a little."""
        out = np.empty((count, len(ACTUATORS)))
        at = bisect_right(self._stamps, start_ns)
        out[:] = self._values[at - 1] if at else 0.0
        while at < len(self._stamps) and (step := (self._stamps[at] - start_ns) // step_ns) < count:
            begin = start_ns + step * step_ns
            out[step] = self._mean(begin, begin + step_ns)
            at = bisect_right(self._stamps, begin + step_ns - 1)
            out[step + 1 :] = self._values[at - 1]
        return out

    def _mean(self, start_ns: int, end_ns: int) -> Array:
        """Over an interval (5,)."""
        at = bisect_right(self._stamps, start_ns)
        held = self._values[at - 1] if at else np.zeros(len(ACTUATORS))
        if at >= len(self._stamps) or self._stamps[at] >= end_ns:
            return held
        total, t = np.zeros(len(ACTUATORS)), start_ns
        while at < len(self._stamps) and self._stamps[at] < end_ns:
            total += held * (self._stamps[at] - t)
            t, held = self._stamps[at], self._values[at]
            at += 1
        return (total + held * (end_ns - t)) / (end_ns - start_ns)

    def in_force_ns(self, stamp_ns: int) -> int:
        """Stamp of the command in force at this one; ages ago without one."""
        at = bisect_right(self._stamps, stamp_ns)
        return self._stamps[at - 1] if at else _NEVER

    def ages(self, start_ns: int, step_ns: int, count: int) -> IntArray:
        """At the start of each of these steps, how old [ns] (count,) the command in force is; ages without one."""
        stamps = start_ns + step_ns * np.arange(count)
        known = np.array([_NEVER, *self._stamps])
        return np.asarray(stamps - known[np.searchsorted(known, stamps, side="right") - 1])

    def forget(self, before_ns: int) -> None:
        """Drop what is no longer in force at the stamp."""
        n = bisect_right(self._stamps, before_ns) - 1
        if n > 0:
            del self._stamps[:n], self._values[:n]
