"""What makes a record unusable, whoever gets it: numbers that are none, rotations of no rotation, mad covariances.

Checks are compiled once per type from the fields' names, shapes and types; those that a message allows to be absent
have rules of their own.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable
from math import isfinite, isnan, sqrt
from typing import Any

from fbn_common import records as r
from fbn_ros.conversion import Malformed

Check = Callable[[Any], None]

QUATERNIONS = ("orientation", "attitude_start")
NORM_TOLERANCE = 0.1  # float32 sources and rounding stay far below; what is farther off is no rotation
_checks: dict[type, Check] = {}


def check(record: Any) -> None:
    """Raise Malformed (field, expected, got) unless every number of the record can be used."""
    kind = type(record)
    if kind not in _checks:
        _checks[kind] = _compile(kind)
    _checks[kind](record)


def has_rules(kind: type) -> bool:
    """Whether records of this type have rules of their own, because something in them may be absent."""
    return kind in _BY_HAND


def finite_number(name: str, value: float) -> None:
    if not isfinite(value):
        raise Malformed(name, "a finite number", str(value))


def finite_array(name: str, values: Any) -> None:
    if not isfinite(values.sum()):  # one pass: NaN and infinities survive a sum
        raise Malformed(name, "finite numbers", str(next(float(v) for v in values.flat if not isfinite(v))))


def covariance(name: str, matrix: Any) -> None:
    finite_array(name, matrix)
    if matrix.size and (least := matrix[:, -len(matrix) :].diagonal().min()) < 0.0:  # (n, m): own block stands last
        raise Malformed(name, "variances of at least 0", str(float(least)))


def quaternion(name: str, q: Any) -> None:
    finite_array(name, q)
    norm = sqrt(float(q @ q))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise Malformed(name, "a unit quaternion", f"norm {norm:.3g}")


def is_covariance(name: str) -> bool:
    """Whether a field of this name holds a covariance or an information matrix."""
    return any(word in name for word in ("covariance", "noise", "information"))


def length(name: str, values: Any, expected: int, of: str) -> None:
    if len(values) != expected:
        raise Malformed(name, f"{expected} ({of})", str(len(values)))


# --- by declaration ------------------------------------------------------------------------------------------


def _compile(kind: type) -> Check:
    if kind in _BY_HAND:
        return _BY_HAND[kind]
    hints = typing.get_type_hints(kind)
    steps = [(f.name, step) for f in dataclasses.fields(kind) if (step := _step(f, hints[f.name])) is not None]
    relation = _RELATIONS.get(kind)

    def run(record: Any) -> None:
        for name, step in steps:
            step(name, getattr(record, name))
        if relation is not None:
            relation(record)

    return run


def _step(field: dataclasses.Field[Any], hint: Any) -> Callable[[str, Any], None] | None:
    """The check of one field; None where nothing can be wrong."""
    shape = field.metadata.get("shape")
    if field.name in QUATERNIONS:
        return quaternion
    if shape is not None:
        return covariance if is_covariance(field.name) and len(shape) == 2 else finite_array
    if hint is float:
        return finite_number
    if dataclasses.is_dataclass(hint):
        return _nested
    if typing.get_origin(hint) is tuple and dataclasses.is_dataclass(typing.get_args(hint)[0]):
        return _each
    return None


def _nested(name: str, value: Any) -> None:
    try:
        check(value)
    except Malformed as error:
        raise Malformed(f"{name}.{error.field}", error.expected, error.got) from None


def _each(name: str, values: tuple[Any, ...]) -> None:
    for i, value in enumerate(values):
        _nested(f"{name}.{i}", value)


# --- what belongs together -----------------------------------------------------------------------------------


def _composite(record: r.CompositeMeasurement) -> None:
    n = 13 + 3 * len(record.features)
    length("mean", record.mean, n, "10 + 3 a feature + 3")
    length("covariance", record.covariance, n, "rows, as mean")
    length("swept.scans", record.swept.scans, record.swept.width * record.swept.height, "width x height")


def _feature_map(record: r.FeatureMap) -> None:
    length("covariance", record.covariance, 3 * len(record.features), "rows, three a feature")


def _hypothesis(record: r.MatchHypothesis) -> None:
    length("feature_keys", record.feature_keys, len(record.map_ids), "as map_ids")


_RELATIONS: dict[type, Check] = {
    r.CompositeMeasurement: _composite,
    r.FeatureMap: _feature_map,
    r.MatchHypothesis: _hypothesis,
}


# --- messages in which something may be absent ---------------------------------------------------------------


def _imu(record: r.Imu) -> None:
    """A first covariance element of -1 says that the quantity is absent: nothing is asked of it then."""
    if record.orientation_covariance[0, 0] != -1.0:
        quaternion("orientation", record.orientation)
        covariance("orientation_covariance", record.orientation_covariance)
    for name in ("angular_velocity", "linear_acceleration"):
        matrix = getattr(record, f"{name}_covariance")
        if matrix[0, 0] != -1.0:
            finite_array(name, getattr(record, name))
            covariance(f"{name}_covariance", matrix)


def _range(record: r.Range) -> None:
    """Infinities say too near and too far; only NaN says nothing."""
    for name in ("min_range", "max_range", "range"):
        if isnan(getattr(record, name)):
            raise Malformed(name, "a number", "nan")


def _nav_sat_fix(record: r.NavSatFix) -> None:
    """Without a fix nothing is asked of the position; the altitude may be absent (NaN) at any time."""
    if record.status < 0:
        return
    finite_number("latitude", record.latitude)
    finite_number("longitude", record.longitude)
    if abs(record.latitude) > 90.0:
        raise Malformed("latitude", "-90 to 90 deg", str(record.latitude))
    if abs(record.longitude) > 360.0:
        raise Malformed("longitude", "-360 to 360 deg", str(record.longitude))
    covariance("position_covariance", record.position_covariance)


def _joint_state(record: r.JointState) -> None:
    """Each array is empty or has a number for every name; effort is nobody's."""
    for name in ("position", "velocity"):
        values = getattr(record, name)
        if len(values):
            length(name, values, len(record.name), "as name")
            finite_array(name, values)


def _fluid_pressure(record: r.FluidPressure) -> None:
    finite_number("fluid_pressure", record.fluid_pressure)
    finite_number("variance", record.variance)
    if record.variance < 0.0:
        raise Malformed("variance", "at least 0", str(record.variance))


def _beacon_range(record: r.BeaconRange) -> None:
    for name in ("range", "range_variance", "travel_delay"):
        finite_number(name, getattr(record, name))
        if getattr(record, name) < 0.0:
            raise Malformed(name, "at least 0", str(getattr(record, name)))


_BY_HAND: dict[type, Check] = {
    r.Imu: _imu,
    r.Range: _range,
    r.NavSatFix: _nav_sat_fix,
    r.JointState: _joint_state,
    r.FluidPressure: _fluid_pressure,
    r.BeaconRange: _beacon_range,
}
