"""What all sensors share: sampling times, transport delay, and the truth at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.parameters import ParameterError, param
from fbn_common.records import Record
from fbn_common.types import NS, Array
from fbn_sim.motion import Motion, interpolate


@dataclass(frozen=True, slots=True)
class Timing:
    """When a sensor measures, and how long its data takes to the log."""

    rate: float = param(10.0, "Hz", "measurements a second; 0 = the sensor is not fitted", "data sheet class")
    latency: float = param(0.03, "s", "from measurement to log, least", "serial line")
    jitter: float = param(0.02, "s", "mean of the exponential part on top", "not a real-time system")
    drop: float = param(0.002, "-", "chance that a message is lost", "assumed")

    def __post_init__(self) -> None:
        if min(self.rate, self.latency, self.jitter) < 0.0 or not 0.0 <= self.drop < 1.0:
            raise ParameterError("rate, latency and jitter must not be negative; drop must be in [0, 1)")


class Flight(NamedTuple):
    """What every sensor is given: the truth, when it began, and the seed."""

    motion: Motion
    start_ns: int
    seed: int


class Entry(NamedTuple):
    """A record as a log holds it."""

    log_time_ns: int
    topic: str
    record: Record


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The truth at a sensor's sampling times; rows as in :class:`Motion`."""

    time_s: Array
    stamp_ns: tuple[int, ...]
    log_time_ns: tuple[int, ...]
    kept: tuple[bool, ...]
    motion: Motion


def sample(flight: Flight, when: Timing, rng: np.random.Generator) -> Samples:
    """The truth at the sensor's times: regular but for a random phase and a jitter of a twentieth of the period."""
    if when.rate <= 0.0:
        return at_times(flight, np.empty(0), when, rng)
    period = 1.0 / when.rate
    count = int((flight.motion.time_s[-1] - 2.0 * period) / period)
    times = (np.arange(count) + 0.5 + rng.uniform(0.0, 1.0)) * period + rng.uniform(-0.05, 0.05, count) * period
    return at_times(flight, times, when, rng)


def at_times(flight: Flight, times: Array, when: Timing, rng: np.random.Generator) -> Samples:
    """The truth interpolated at these times [s since the start], with stamps and times of logging."""
    n = len(times)
    stamps = flight.start_ns + np.round(times * 1e6).astype(np.int64) * 1000  # whole microseconds
    delay = when.latency + when.jitter * rng.exponential(1.0, n)
    logged = np.maximum.accumulate(stamps + np.round(delay * NS).astype(np.int64))  # a line delivers in order
    kept = rng.random(n) >= when.drop
    return Samples(times, _ints(stamps), _ints(logged), tuple(bool(k) for k in kept), interpolate(flight.motion, times))


def _ints(values: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> tuple[int, ...]:
    return tuple(values.tolist())


def rotations(quaternions: Array) -> Array:
    """Rotation matrices (n, 3, 3), body to map, of unit quaternions (n, 4)."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).reshape(3, 3, -1).transpose(2, 0, 1)


def angles(rotation: Array) -> Array:
    """Roll, pitch, yaw (n, 3) [rad] of rotation matrices (n, 3, 3)."""
    pitch = np.arctan2(-rotation[:, 2, 0], np.hypot(rotation[:, 0, 0], rotation[:, 1, 0]))
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    return np.stack([roll, pitch, np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])], axis=1)


def quaternions(rpy: Array) -> Array:
    """Unit quaternions (n, 4), w >= 0, of roll, pitch, yaw (n, 3) [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy.T / 2.0), np.sin(rpy.T / 2.0)
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    z, w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
    q = np.stack([x, y, z, w], axis=1)
    return np.asarray(q * np.where(q[:, 3:] < 0.0, -1.0, 1.0))
