"""Motions and measurements of the last seconds, as the compiled loop takes them."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import matrix_from_quaternion
from fbn_common.motion_ekf.layout import DATA_SIZE, GRID_NS, OUT_SIZE, Events, Kind, Motions
from fbn_common.records import PredictedMotion
from fbn_common.types import Array

MOTIONS = 2048  # 20 s
EVENTS = 4096


@kernel
def _pack(
    rows: Motions, k: int, increment: Array, rotation: Array, start: Array, end: Array, parameters: Array,
    by_velocity: Array, by_attitude: Array, by_parameters: Array, noise: Array, attitude: Array,
) -> bool:  # fmt: skip
    """Copy a motion into row ``k``; False, and nothing copied, where a number is not finite."""
    total = increment.sum() + rotation.sum() + start.sum() + end.sum() + parameters.sum() + attitude.sum()
    total += by_velocity.sum() + by_attitude.sum() + by_parameters.sum() + noise.sum()
    if not np.isfinite(total):
        return False
    mean, jacobian = rows.mean[k], rows.jacobian[k]
    mean[0:3], mean[3:6], mean[6:12], mean[12:18] = increment, rotation, start, end
    for i in range(12):
        for j in range(3):
            jacobian[i, j] = by_attitude[i, j]
        for j in range(6):
            jacobian[i, 3 + j] = by_velocity[i, j]
        for j in range(15):
            jacobian[i, 9 + j] = by_parameters[i, j]
        for j in range(12):
            rows.noise[k, i, j] = noise[i, j]
    used = matrix_from_quaternion(attitude)
    for i in range(9):
        rows.attitude[k, i] = used[i // 3, i % 3]
    rows.parameters[k] = parameters
    return True


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

    def put(self, m: PredictedMotion) -> str:
        """Take a motion; says why not where it cannot be used."""
        if m.stamp_ns % GRID_NS != 0 or m.stamp_ns - m.start_ns != GRID_NS:
            return f"not one step of the {GRID_NS} ns grid: {m.start_ns} to {m.stamp_ns}"
        k = (m.stamp_ns // GRID_NS) % MOTIONS
        if not _pack(
            self.rows, k, m.increment, m.rotation, m.velocity_start, m.velocity_end, m.parameters,
            m.jacobian_velocity, m.jacobian_attitude, m.jacobian_parameters, m.noise, m.attitude_start,
        ):  # fmt: skip
            return "not finite"
        self.rows.stamp[k] = m.stamp_ns
        self.first_ns = m.start_ns if self.first_ns < 0 else min(self.first_ns, m.start_ns)
        self.newest_ns = max(self.newest_ns, m.stamp_ns)
        return ""

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
            self.rows.order[: len(self.slots)] = self.slots
        return n
