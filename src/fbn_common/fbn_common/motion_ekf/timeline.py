"""Motions and measurements of the last seconds, as the compiled loop takes them."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import matrix_from_quaternion_into
from fbn_common.motion_ekf.layout import (
    DATA_SIZE,
    GRID_NS,
    M_ATTITUDE,
    M_BY_ATTITUDE,
    M_BY_PARAMETERS,
    M_BY_VELOCITY,
    M_NOISE,
    M_PARAMETERS,
    MOTION_SIZE,
    OUT_SIZE,
    Events,
    IntArray,
    Kind,
    Motions,
)
from fbn_common.records import PredictedMotion, stacked
from fbn_common.types import Array, Mat3

MOTIONS = 2048  # 20 s
EVENTS = 4096


_NEW, _AGAIN, _OFF_THE_GRID, _NOT_FINITE = 0, 1, 2, 3  # what became of a motion


@kernel
def _file(rows: Motions, starts: IntArray, stamps: IntArray, numbers: Array) -> IntArray:
    """Copy motions, their numbers (n, MOTION_SIZE), into their rows; what became of each (n,).

    Nothing is copied of one that is not a step of the grid, or not finite.
    """
    fates, rotation = np.empty(stamps.shape[0], np.int64), np.empty((3, 3))
    for i in range(stamps.shape[0]):
        if stamps[i] % GRID_NS != 0 or stamps[i] - starts[i] != GRID_NS:
            fates[i] = _OFF_THE_GRID
        else:
            fates[i] = _file_one(rows, stamps[i], numbers[i], rotation)
    return fates


@inner_kernel
def _file_one(rows: Motions, stamp: int, one: Array, rotation: Mat3) -> int:
    total = 0.0
    for i in range(0, MOTION_SIZE - 4, 5):
        total += (one[i] + one[i + 1]) + (one[i + 2] + one[i + 3]) + one[i + 4]
    for i in range(MOTION_SIZE - 4, MOTION_SIZE):
        total += one[i]
    if not np.isfinite(total):
        return _NOT_FINITE
    k = (stamp // GRID_NS) % rows.stamp.shape[0]
    for i in range(18):
        rows.mean[k, i] = one[i]
    for i in range(15):
        rows.parameters[k, i] = one[M_PARAMETERS + i]
    for r in range(12):
        for j in range(6):
            rows.jacobian[k, r, 3 + j] = one[M_BY_VELOCITY + 6 * r + j]
        for j in range(3):
            rows.jacobian[k, r, j] = one[M_BY_ATTITUDE + 3 * r + j]
        for j in range(15):
            rows.jacobian[k, r, 9 + j] = one[M_BY_PARAMETERS + 15 * r + j]
        for j in range(12):
            rows.noise[k, r, j] = one[M_NOISE + 12 * r + j]
    matrix_from_quaternion_into(one[M_ATTITUDE:M_BY_VELOCITY], rotation)
    for i in range(3):
        for j in range(3):
            rows.attitude[k, 3 * i + j] = rotation[i, j]
    fate = _AGAIN if rows.stamp[k] == stamp else _NEW
    rows.stamp[k] = stamp
    return fate


def _why(m: PredictedMotion, fate: int) -> str:
    """Why a motion was not taken; empty if it was."""
    if fate == _OFF_THE_GRID:
        return f"not one step of the {GRID_NS} ns grid: {m.start_ns} to {m.stamp_ns}"
    return "not finite" if fate == _NOT_FINITE else ""


class Filed(NamedTuple):
    """What became of motions."""

    errors: list[str]  # for each, why it cannot be used, empty if it can
    again_ns: int  # start of the first that took the place of one of the same step; -1 if none did


class MotionLog:
    """A ring of motions by grid step."""

    def __init__(self) -> None:
        self.rows = Motions(
            np.zeros(MOTIONS, np.int64),
            np.zeros((MOTIONS, 18)),
            np.zeros((MOTIONS, 9)),
            np.zeros((MOTIONS, 15)),
            np.zeros((MOTIONS, 12, 24)),
            np.zeros((MOTIONS, 12, 12)),
        )
        self.first_ns = -1  # start of the oldest motion ever taken
        self.newest_ns = -1

    def put(self, *motions: PredictedMotion) -> Filed:
        """Take motions, or their replacements."""
        if not motions:
            return Filed([], -1)
        stamps = np.array([m.stamp_ns for m in motions], np.int64)
        starts = np.array([m.start_ns for m in motions], np.int64)
        fates = _file(self.rows, starts, stamps, stacked(motions, MOTION_SIZE))
        taken, again = starts[fates <= _AGAIN], starts[fates == _AGAIN]
        if len(taken):
            first = int(taken.min())
            self.first_ns = first if self.first_ns < 0 else min(self.first_ns, first)
            self.newest_ns = max(self.newest_ns, int(taken.max()) + GRID_NS)
        errors = [_why(m, fate) if fate else "" for m, fate in zip(motions, fates.tolist(), strict=True)]
        return Filed(errors, int(again.min()) if len(again) else -1)

    def has(self, stamp_ns: int) -> bool:
        """Whether the motion that ends at this grid stamp is here."""
        return bool(self.rows.stamp[(stamp_ns // GRID_NS) % MOTIONS] == stamp_ns)

    def bridge(self, end_ns: int, spread: Array) -> None:
        """Fill the missing step that ends at ``end_ns``: velocity held, with noise of this spectral density (6,)."""
        rows, k = self.rows, (end_ns // GRID_NS) % MOTIONS
        before = (k - 1) % MOTIONS
        dt = GRID_NS * 1e-9
        velocity = rows.mean[before, 12:18].copy()
        rows.stamp[k] = end_ns
        rows.mean[k] = np.concatenate((velocity * dt, velocity, velocity))
        rows.attitude[k], rows.parameters[k] = rows.attitude[before], rows.parameters[before]
        jacobian = np.zeros((12, 24))
        jacobian[0:6, 3:9], jacobian[6:12, 3:9] = dt * np.eye(6), np.eye(6)
        rows.jacobian[k] = jacobian
        g = np.concatenate((np.eye(6) * dt / 2.0, np.eye(6)))
        rows.noise[k] = (g * spread * dt) @ g.T


class EventLog:
    """Measurements sorted by (stamp, rank of their topic, arrival), in a ring of slots."""

    def __init__(self) -> None:
        self.rows = Events(
            np.zeros(EVENTS, np.int64),
            np.zeros(EVENTS, np.int64),
            np.zeros(EVENTS, np.int64),
            np.zeros(EVENTS, np.int64),
            np.zeros((EVENTS, DATA_SIZE)),
            np.zeros(EVENTS, np.int64),
            np.zeros(EVENTS, np.int64),
            np.zeros(EVENTS, np.int64),
            np.zeros(EVENTS),
            np.zeros((EVENTS, 3)),
            np.zeros((EVENTS, 3)),
            np.zeros((EVENTS, OUT_SIZE)),
        )
        self.keys: list[tuple[int, int, int]] = []
        self.slots: list[int] = []
        self._arrived = 0

    def put(self, stamp_ns: int, rank: int, kind: Kind, sensor: int, data: Array) -> int:
        """Keep a measurement; its slot, or -1 where there is no room."""
        if len(self.keys) >= EVENTS - 1:
            return -1
        slot = self._arrived % EVENTS
        key = (stamp_ns, rank, self._arrived)
        self._arrived += 1
        at = len(self.keys) if not self.keys or key > self.keys[-1] else bisect_left(self.keys, key)
        self.keys.insert(at, key)
        self.slots.insert(at, slot)
        rows, n = self.rows, len(self.slots)
        if at == n - 1:
            rows.order[at] = slot
        else:
            rows.order[at:n] = self.slots[at:]
        rows.stamp[slot], rows.kind[slot], rows.sensor[slot] = stamp_ns, int(kind), sensor
        rows.data[slot, : len(data)] = data
        return slot

    def remove(self, slot: int) -> None:
        """Drop one measurement."""
        at = self.slots.index(slot)
        del self.keys[at], self.slots[at]
        self.rows.order[: len(self.slots)] = self.slots

    def after(self, stamp_ns: int) -> int:
        """Index of the first measurement stamped later."""
        return bisect_right(self.keys, (stamp_ns, 1 << 30, 0))

    def forget(self, before_ns: int) -> int:
        """Drop what is stamped earlier; gives how many."""
        n = bisect_left(self.keys, (before_ns, -1, 0))
        if n:
            del self.keys[:n], self.slots[:n]
            kept = len(self.slots)
            self.rows.order[:kept] = self.rows.order[n : n + kept]
        return n
