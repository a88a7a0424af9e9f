"""Faults on request: what a sensor does to its data when it fails.

A fault acts on the records of one topic between two times; its random numbers are its own, so it changes
nothing else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fbn_common import records as r
from fbn_common.lie import matrix_from_quaternion, quaternion_from_matrix, so3_exp
from fbn_common.parameters import ParameterError, param
from fbn_common.types import nanoseconds
from fbn_sim.randomness import generator
from fbn_sim.sensors.sample import Entry

KINDS = ("dropped", "frozen", "repeated", "nan", "noise", "late", "duplicated", "bias", "clock_jump")
METRES_PER_DEGREE = 111_320.0

SIGMA: dict[type[r.Record], float] = {
    r.Imu: 0.0087,  # rad
    r.FluidPressure: 80.0,  # Pa
    r.Range: 0.02,  # m
    r.NavSatFix: 1.7,  # m
    r.BeaconRange: 0.3,  # m
    r.JointState: 0.5,  # rad/s
    r.SonarDetections: 0.03,  # m
}
"""One standard deviation of each kind of record, for ``noise``; the unit is also that of ``bias``."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One failure of one sensor.

    ``dropped``: no data.  ``frozen``: the last good values under new stamps.  ``repeated``: the last good message
    again, old stamp and all.  ``nan``: not a number.  ``noise``: white noise of ``size`` standard deviations on
    top.  ``late``: logged ``size`` seconds later.  ``duplicated``: each message ``size`` times.  ``bias``: ``size``
    is added (rad for yaw and bearing, Pa, m, m east, rad/s).  ``clock_jump``: stamps move by ``size`` seconds.
    """

    topic: str = param("", "-", "topic of the sensor", "scenario")
    kind: str = param("dropped", "-", ", ".join(KINDS), "scenario")
    start: float = param(0.0, "s", "from this time of the mission ...", "scenario")
    end: float = param(1e9, "s", "... to this", "scenario")
    size: float = param(0.0, "by kind", "see the kinds; 0 = 10 deviations, 5 s, twice, -10 s", "scenario")
    frame: str = param("", "-", "only records of this frame_id; empty = all of the topic", "scenario")

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ParameterError(f"kind must be one of {', '.join(KINDS)}; got {self.kind!r}")
        if not self.topic:
            raise ParameterError("a fault needs the topic of the sensor that fails")
        if not self.start < self.end:
            raise ParameterError(f"a fault must end after it starts, got {self.start} to {self.end} [s]")


def apply(entries: list[Entry], name: str, fault: Fault, start_ns: int, seed: int) -> list[Entry]:
    """The log with the fault in it, in the same order; entries of other topics are passed on as they are."""
    begin, end = start_ns + nanoseconds(fault.start), start_ns + nanoseconds(min(fault.end, 1e9))
    rng = generator(seed, "fault", name)
    act = _ACTIONS[fault.kind]
    last: dict[str, Entry] = {}
    out: list[Entry] = []
    for entry in entries:
        frame = str(getattr(entry.record, "frame_id", ""))
        if entry.topic != fault.topic or (fault.frame and frame != fault.frame):
            out.append(entry)
        elif begin <= entry.record.stamp_ns < end:
            out.extend(act(entry, last.get(frame, entry), fault.size, rng))
        else:
            last[frame] = entry
            out.append(entry)
    return out


Action = Callable[[Entry, Entry, float, np.random.Generator], list[Entry]]


def _dropped(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    return []


def _frozen(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    changes: dict[str, int] = {"stamp_ns": entry.record.stamp_ns}
    if isinstance(entry.record, r.SonarDetections):
        changes["ping"] = entry.record.ping
    return [entry._replace(record=dataclasses.replace(last.record, **changes))]


def _repeated(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    return [entry._replace(record=last.record)]


def _nan(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    return [entry._replace(record=shifted(entry.record, float("nan")))]


def _noise(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    deviation = (size or 10.0) * SIGMA[type(entry.record)]
    return [entry._replace(record=shifted(entry.record, deviation * float(rng.standard_normal())))]


def _late(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    return [entry._replace(log_time_ns=entry.log_time_ns + nanoseconds(size or 5.0))]


def _duplicated(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    return [entry] * int(size or 2)


def _bias(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    return [entry._replace(record=shifted(entry.record, size or 10.0 * SIGMA[type(entry.record)]))]


def _clock_jump(entry: Entry, last: Entry, size: float, rng: np.random.Generator) -> list[Entry]:
    moved = entry.record.stamp_ns + nanoseconds(size or -10.0)
    return [entry._replace(record=dataclasses.replace(entry.record, stamp_ns=moved))]


_ACTIONS: dict[str, Action] = {
    "dropped": _dropped,
    "frozen": _frozen,
    "repeated": _repeated,
    "nan": _nan,
    "noise": _noise,
    "late": _late,
    "duplicated": _duplicated,
    "bias": _bias,
    "clock_jump": _clock_jump,
}


def shifted(record: r.Record, by: float) -> r.Record:
    """The record with its value moved by ``by`` (rad of yaw, Pa, m, m to the east, rad/s; NaN makes it NaN).

    A sonar's ranges move by ``by`` metres and, with NaN, become NaN; a record of another kind raises TypeError.
    """
    if isinstance(record, r.Imu):
        turn = quaternion_from_matrix(so3_exp(np.array([0.0, 0.0, by])) @ matrix_from_quaternion(record.orientation))
        return dataclasses.replace(record, orientation=turn if by == by else np.full(4, by))
    if isinstance(record, r.FluidPressure):
        return dataclasses.replace(record, fluid_pressure=record.fluid_pressure + by)
    if isinstance(record, r.Range | r.BeaconRange):
        return dataclasses.replace(record, range=record.range + by)
    if isinstance(record, r.NavSatFix):
        degrees = by / METRES_PER_DEGREE / np.cos(np.radians(record.latitude))
        return dataclasses.replace(record, longitude=float(record.longitude + degrees))
    if isinstance(record, r.JointState):
        return dataclasses.replace(record, velocity=record.velocity + np.array([by, 0.0, 0.0]))
    if isinstance(record, r.SonarDetections):
        moved = tuple(dataclasses.replace(d, range=d.range + by) for d in record.detections)
        return dataclasses.replace(record, detections=moved)
    raise TypeError(f"a fault cannot act on {type(record).__name__}")
