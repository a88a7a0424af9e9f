"""The filter itself: a state, its timeline of the last seconds, and re-running that when late data comes."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fbn_common.motion_ekf import run as loop
from fbn_common.motion_ekf.layout import (
    DROPPED_UNTIL,
    GRID_NS,
    LAST_USED,
    SENSOR_SIZE,
    SNAPSHOT_NS,
    X_SIZE,
    Config,
    Kind,
    Snapshots,
)
from fbn_common.motion_ekf.timeline import EventLog, MotionLog
from fbn_common.records import PredictedMotion
from fbn_common.types import Array, nanoseconds


class State(NamedTuple):
    """A filter state at a stamp; see :mod:`fbn_common.motion_ekf.layout` for the order."""

    stamp_ns: int
    x: Array
    covariance: Array
    sensors: Array

    def copy(self) -> State:
        """One that does not share its arrays."""
        return State(self.stamp_ns, self.x.copy(), self.covariance.copy(), self.sensors.copy())


class MotionEkf:
    """EKF over predicted motions and measurements in the order of their stamps, whatever the order of arrival.

    ``outside`` handles items that the kernels leave to Python (a slot, and the state to change in place).
    """

    def __init__(
        self, size: int, sensors: int, config: Config, history_s: float, outside: Callable[[int, Array, Array], None]
    ) -> None:
        self.size, self.config, self.history_ns = size, config, nanoseconds(history_s)
        self.motions, self.events = MotionLog(), EventLog()
        n = int(self.history_ns / SNAPSHOT_NS) + 20
        self.snapshots = Snapshots(
            np.full(n, -1, np.int64),
            np.zeros((n, X_SIZE)),
            np.zeros((n, size, size)),
            np.zeros((n, sensors, SENSOR_SIZE)),
        )
        self.state = State(-1, np.zeros(X_SIZE), np.eye(size), fresh_sensors(sensors))
        self.base = self.state
        self.reruns = 0
        self._outside = outside
        self._dirty_ns = -1

    @property
    def head_ns(self) -> int:
        """Everything stamped up to here is in the state; -1 before the start."""
        return self.state.stamp_ns

    def start(self, state: State) -> None:
        """Begin here; what was known before is forgotten, what is stamped earlier will not be used."""
        self.state, self.base, self._dirty_ns = state.copy(), state.copy(), -1
        self.snapshots.stamp[:] = -1

    def put_motions(self, *motions: PredictedMotion) -> list[str]:
        """Take motions, or their replacements; for each, why it cannot be used, empty if it can."""
        errors, again_ns = self.motions.put(*motions)
        if 0 <= again_ns < self.head_ns:
            self._mark(again_ns)
        return errors

    def put_event(self, stamp_ns: int, rank: int, kind: Kind, sensor: int, data: Array) -> int:
        """Take a measurement; its slot, or -1 where there is no room."""
        slot = self.events.put(stamp_ns, rank, kind, sensor, data)
        if slot >= 0 and stamp_ns <= self.head_ns:
            self._mark(stamp_ns - 1)
        return slot

    def withdraw(self, slot: int) -> None:
        """Take a measurement back; if it was used, the history is re-run without it."""
        stamp = int(self.events.rows.stamp[slot])
        self.events.remove(slot)
        if stamp <= self.head_ns:
            self._mark(stamp - 1)

    def _mark(self, ns: int) -> None:
        self._dirty_ns = ns if self._dirty_ns < 0 else min(self._dirty_ns, ns)

    def advance(self, target_ns: int) -> None:
        """Process what is stamped up to ``target_ns``, as far as there are motions; late items re-run the history."""
        target_ns = max(target_ns // GRID_NS * GRID_NS, self.head_ns)
        if self._dirty_ns >= 0:
            self.state = self._restored(self._dirty_ns)
            self.reruns += 1
            self._dirty_ns = -1
        self.state = self._run(self.state, target_ns, keep=True)
        self.events.forget(self.head_ns - self.history_ns - nanoseconds(1.0))

    def state_at(self, stamp_ns: int) -> State:
        """The state at a stamp between the history's beginning and the head, of all that is now known up to it."""
        return self._run(self._restored(stamp_ns), stamp_ns, keep=False)

    def open_loop(self, state: State, stamp_ns: int) -> State:
        """A state within the history carried on to a stamp by the motions alone."""
        t, x, p, sensors = state.copy()
        t, _ = loop.run(
            t, stamp_ns, 0, 0, x, p, sensors, self.motions.rows, self.events.rows, self.snapshots, self.config, False
        )[1:]
        return State(t, x, p, sensors)

    def snapshot_row(self, stamp_ns: int) -> int:
        """The ring's row of a multiple of SNAPSHOT_NS; -1 if that is not in the ring."""
        k = (stamp_ns // SNAPSHOT_NS) % len(self.snapshots.stamp)
        return k if self.snapshots.stamp[k] == stamp_ns <= self.head_ns else -1

    def _restored(self, stamp_ns: int) -> State:
        """A copy of the newest state kept that has in it nothing later than the stamp."""
        if stamp_ns >= self.head_ns:
            return self.state.copy()
        stamp = stamp_ns // SNAPSHOT_NS * SNAPSHOT_NS
        k, kept = self.snapshot_row(stamp), self.snapshots
        if k < 0 or stamp < self.base.stamp_ns:
            return self.base.copy()
        return State(stamp, kept.x[k], kept.covariance[k], kept.sensors[k]).copy()

    def _run(self, state: State, target_ns: int, keep: bool) -> State:
        t, x, p, sensors = state
        first = self.events.after(t)
        while True:
            why, t, first = loop.run(
                t, target_ns, first, len(self.events.slots), x, p, sensors,
                self.motions.rows, self.events.rows, self.snapshots, self.config, keep,
            )  # fmt: skip
            if why != loop.OUTSIDE:
                return State(t, x, p, sensors)
            self._outside(self.events.slots[first], x, p)
            first += 1


def fresh_sensors(count: int) -> Array:
    """Rows of sensors that have not measured yet."""
    rows = np.zeros((count, SENSOR_SIZE))
    rows[:, LAST_USED] = rows[:, DROPPED_UNTIL] = -1e18
    rows[:, 7] = 1e18  # no altitude yet: any time is before it
    return rows
