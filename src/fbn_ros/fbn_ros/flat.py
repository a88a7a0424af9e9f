"""The quick way for messages that are a header, a few times and names, and then nothing but double-precision numbers.

Most of what flows is of that kind (motion at 100 Hz, odometry, the dead service).  Its numbers lie in one run of the
serialised bytes: one copy instead of a message object, a conversion and a check for every field.
"""

from __future__ import annotations

import dataclasses
import re
import struct
import typing
from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any

import numpy as np

from fbn_common.records import (
    FluidPressure,
    Imu,
    Odometry,
    Packed,
    Pose,
    PoseWithCovarianceStamped,
    Record,
    Run,
    laid_out,
)
from fbn_common.types import Array
from fbn_ros.conversion import Malformed
from fbn_ros.primitives import PREFIX, put_text, put_time, text_at, time_at
from fbn_ros.validation import NORM_TOLERANCE, QUATERNIONS, check, has_rules, is_covariance

_NUMBERS = re.compile(r"double(?:\[(\d+)\])?")
_POSE = "geometry_msgs/Pose"

FieldTypes = Callable[[str], Mapping[str, str]]  # a type's fields, in order, as ROS writes their types


class Flat:
    """Serialising and reading one record type; see :func:`flat`."""

    def __init__(self, kind: type[Any], lead: list[tuple[str, str]], runs: dict[str, Run]) -> None:
        self.kind, self._lead, self._runs = kind, lead, runs
        self._count = max(run.stop for run in runs.values())
        self._packed = issubclass(kind, Packed)
        self._ruled = has_rules(kind)  # something may be absent: judged by its own rules
        self._framed = "frame_id" in {f.name for f in dataclasses.fields(kind)}
        self._quaternions = [r.stop - 4 for name, r in runs.items() if name in QUATERNIONS or r.shape is None]
        self._variances = np.array([place for name, r in runs.items() for place in _variances(name, r)], dtype=int)

    def encode(self, record: Any) -> bytes:
        """The bytes of the record's message."""
        frame = record.frame_id if self._framed else ""
        body = bytearray()
        put_time(body, record.stamp_ns)
        put_text(body, frame)
        for name, what in self._lead:
            if what == "time":
                put_time(body, getattr(record, name))
            else:
                put_text(body, getattr(record, name))
        body += b"\0" * (-len(body) % 8)
        if self._packed:
            return PREFIX + bytes(body) + record.numbers.tobytes()
        numbers = np.empty(self._count)
        for name, (start, stop, shape) in self._runs.items():
            value = getattr(record, name)
            if isinstance(value, Pose):
                numbers[start : start + 3], numbers[start + 3 : stop] = value.position, value.orientation
            elif shape:
                numbers[start:stop] = np.asarray(value).reshape(-1)
            else:
                numbers[start] = value
        return PREFIX + bytes(body) + numbers.tobytes()

    def decode(self, data: bytes) -> Record | None:
        """The record; None if these bytes need the slow way (other byte order, too short, or something is wrong)."""
        if data[:4] != PREFIX:
            return None
        body = data[4:]
        try:
            values, position = self._decode_lead(body)
            numbers = np.frombuffer(body, "<f8", self._count, position).copy()
        except (struct.error, ValueError, IndexError):
            return None
        if not self._ruled and not self._usable(numbers):
            return None
        if self._packed:
            return typing.cast(Record, self.kind.packed(numbers, **values))
        for name, (start, stop, shape) in self._runs.items():
            if shape is None:
                values[name] = Pose(numbers[start : start + 3], numbers[start + 3 : stop])
            elif len(shape) == 2:
                values[name] = numbers[start:stop].reshape(shape)
            else:
                values[name] = numbers[start:stop] if shape else float(numbers[start])
        record = self.kind(**values)
        return typing.cast(Record, record) if not self._ruled or _passes(record) else None

    def _decode_lead(self, body: bytes) -> tuple[dict[str, Any], int]:
        """Header, times and names; and where the numbers begin."""
        stamp_ns, position = time_at(body, 0)
        values: dict[str, Any] = {"stamp_ns": stamp_ns}
        frame_id, position = text_at(body, position)
        if self._framed:
            values["frame_id"] = frame_id
        for name, what in self._lead:
            values[name], position = time_at(body, position) if what == "time" else text_at(body, position)
        return values, position + -position % 8

    def _usable(self, numbers: Array) -> bool:
        """As :mod:`fbn_ros.validation`, all fields at once; what fails here is told in detail there."""
        if not isfinite(numbers.sum()):
            return False
        if self._variances.size and numbers[self._variances].min() < 0.0:
            return False
        for start in self._quaternions:
            x, y, z, w = numbers[start : start + 4].tolist()
            if abs((x * x + y * y + z * z + w * w) ** 0.5 - 1.0) > NORM_TOLERANCE:
                return False
        return True


def _passes(record: Any) -> bool:
    try:
        check(record)
    except Malformed:
        return False
    return True


# --- which types are flat ------------------------------------------------------------------------------------

# Standard messages nest what their records hold side by side: record fields in the order of the message's numbers.
_STANDARD: dict[type, tuple[list[tuple[str, str]], dict[str, Run]]] = {
    Odometry: ([("child_frame_id", "string")], Odometry.layout),
    PoseWithCovarianceStamped: ([], laid_out(pose=None, covariance=(6, 6))),
    FluidPressure: ([], laid_out(fluid_pressure=(), variance=())),
    Imu: (
        [],
        laid_out(
            orientation=(4,),
            orientation_covariance=(3, 3),
            angular_velocity=(3,),
            angular_velocity_covariance=(3, 3),
            linear_acceleration=(3,),
            linear_acceleration_covariance=(3, 3),
        ),
    ),
}


def flat(kind: type[Any], field_types: FieldTypes) -> Flat | None:
    """The quick way for a record type; None if its message is not of that kind."""
    if kind in _STANDARD:
        return Flat(kind, *_STANDARD[kind])
    if not kind.ros_type.startswith("fbn_msgs/"):
        return None
    lead: list[tuple[str, str]] = []
    shapes: dict[str, tuple[int, ...] | None] = {}
    fields = {f.name: f for f in dataclasses.fields(kind)}
    for name, ros_type in list(field_types(kind.ros_type).items())[1:]:  # the header is first
        if ros_type == "builtin_interfaces/Time" and not shapes:
            lead.append((f"{name}_ns", "time"))
        elif ros_type == "string" and not shapes:
            lead.append((name, "string"))
        elif ros_type == _POSE:
            shapes[name] = None
        elif _NUMBERS.fullmatch(ros_type):
            shapes[name] = fields[name].metadata.get("shape", ())
        else:
            return None
    told = {"stamp_ns", "frame_id", *(name for name, _ in lead), *shapes}
    return Flat(kind, lead, laid_out(**shapes)) if shapes and fields.keys() <= told else None


def _variances(name: str, run: Run) -> range:
    """Where a covariance's variances are: of (n, m), n < m, the matrix's own square stands last."""
    if run.shape is None or len(run.shape) != 2 or not is_covariance(name):
        return range(0)
    n, m = run.shape
    return range(run.start + m - n, run.stop, m + 1)
