"""From columns to records: one function a kind of sensor, conventions and units to ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fbn_bringup.importing import mapping as m
from fbn_bringup.importing.clock import Stamps
from fbn_bringup.importing.table import Mask, Table
from fbn_bringup.importing.units import UNITS
from fbn_common import records as r
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.types import Array, nanoseconds

_ABSENT = np.diag([-1.0, 0.0, 0.0])  # sensor_msgs/Imu: not measured
_DIAGONAL_KNOWN = 2  # sensor_msgs/NavSatFix
_ULTRASOUND = 0  # sensor_msgs/Range
_NO_FIX, _FIX = -1, 0  # sensor_msgs/NavSatStatus


class Made(NamedTuple):
    """Messages of one sensor: log time, topic, record; and the rows that gave none, by reason."""

    items: list[tuple[int, str, r.Record]]
    refused: dict[str, int]
    notes: dict[str, int]  # messages that say "no", by reason: no fix, no bottom


class Rows(NamedTuple):
    """The rows that give one sensor's messages: stamps, quantities in SI units, cells; and notes to be made on them."""

    name: str  # topic or beacon
    stamps: list[int]
    values: dict[str, Array]
    table: Table
    notes: dict[str, int]


def messages(kind: str, name: str, sensor: Any, table: Table, stamp_ns: Stamps) -> Made:
    """All messages of one sensor of the mapping."""
    topic = "lbl/range" if kind == "beacons" else name
    refused: dict[str, int] = {}
    keep = _wanted(sensor, table, refused)
    values = _VALUES[kind](sensor, table)
    for quantity, column in values.items():
        lost = keep & ~np.isfinite(column)
        if lost.any():
            refused[f"{quantity} missing or out of range"] = int(lost.sum())
            keep &= ~lost
    taken = [int(s) - nanoseconds(sensor.age) for s in stamp_ns[keep]]
    rows = Rows(name, taken, {quantity: column[keep] for quantity, column in values.items()}, table.where(keep), {})
    made = _RECORDS[kind](sensor, rows)
    items = [(int(log_ns), topic, record) for log_ns, record in zip(stamp_ns[keep], made, strict=True)]
    return Made(items, refused, rows.notes)


def _wanted(sensor: m.Sensor, table: Table, refused: dict[str, int]) -> Mask:
    """Rows that meet the sensor's rules; counts those that do not, each by the first rule that it fails."""
    keep = np.ones(len(table), dtype=bool)
    for name, rule in sensor.when.items():
        met = table.meets(rule)
        if (keep & ~met).any():
            refused[f"rule {name!r}"] = int((keep & ~met).sum())
        keep &= met
    if not sensor.repeats:
        own = (f for f in (getattr(sensor, n) for n in sensor.__dataclass_fields__) if isinstance(f, m.Quantity))
        again = keep & table.repeated(dict.fromkeys(c for q in own for c in q.columns))
        if again.any():
            refused["repeats the row before"] = int(again.sum())
        keep &= ~again
    return keep


# --- quantities in SI units -----------------------------------------------------------------------------------


def _compass_values(c: m.Compass, t: Table) -> dict[str, Array]:
    values = {
        name: t.quantity(getattr(c, name), "angle")
        for name in ("roll", "pitch", "yaw", "variation", "sigma_tilt", "sigma_yaw")
    }
    for name in ("rate_x", "rate_y", "rate_z", "sigma_rate"):
        if getattr(c, name).given:
            values[name] = t.quantity(getattr(c, name), "turn rate")
    return values


def _pressure_values(p: m.Pressure, t: Table) -> dict[str, Array]:
    if p.pressure.given:
        return {"pressure": t.quantity(p.pressure, "pressure"), "sigma": t.quantity(p.sigma, "pressure")}
    weight = p.density * p.gravity
    depth, sigma = t.quantity(p.depth, "length"), t.quantity(p.sigma, "length")
    return {"pressure": p.surface_pressure + weight * depth, "sigma": weight * sigma}


def _altitude_values(a: m.Altitude, t: Table) -> dict[str, Array]:
    return {"range": t.quantity(a.range, "length")}


def _gps_values(g: m.Gps, t: Table) -> dict[str, Array]:
    degree = 180.0 / math.pi  # NavSatFix has degrees
    places = {n: degree * t.quantity(getattr(g, n), "angle") for n in ("latitude", "longitude")}
    return places | {n: t.quantity(getattr(g, n), "length") for n in ("altitude", "sigma", "sigma_vertical")}


def _actuator_values(a: m.Actuators, t: Table) -> dict[str, Array]:
    return {name: t.quantity(joint, "angle", "turn rate") for name, joint in a.joints.items()}


def _beacon_values(b: m.Beacon, t: Table) -> dict[str, Array]:
    lengths = {n: t.quantity(getattr(b, n), "length") for n in ("range", "sigma")}
    return lengths | {"travel_delay": t.quantity(b.travel_delay, "time")}


# --- records --------------------------------------------------------------------------------------------------


def _compass(c: m.Compass, rows: Rows) -> Iterator[r.Record]:
    v, ned = rows.values, c.convention == "ned"
    turn = -1.0 if ned else 1.0  # right-handed about left and up, against right and down
    yaw = math.pi / 2.0 - v["yaw"] - v["variation"] if ned else v["yaw"] - v["variation"]
    rates = all(name in v for name in ("rate_x", "rate_y", "rate_z", "sigma_rate"))
    for i, stamp in enumerate(rows.stamps):
        rpy = np.array([v["roll"][i], turn * v["pitch"][i], yaw[i]])
        tilt, heading = v["sigma_tilt"][i] ** 2, v["sigma_yaw"][i] ** 2
        rate, rate_covariance = np.zeros(3), _ABSENT
        if rates:
            rate = np.array([v["rate_x"][i], turn * v["rate_y"][i], turn * v["rate_z"][i]])
            rate_covariance = v["sigma_rate"][i] ** 2 * np.eye(3)
        orientation = quaternion_from_matrix(matrix_from_rpy(rpy))
        yield r.Imu(
            stamp, c.frame_id, orientation, np.diag([tilt, tilt, heading]), rate, rate_covariance, np.zeros(3), _ABSENT
        )


def _pressure(p: m.Pressure, rows: Rows) -> Iterator[r.Record]:
    v = rows.values
    for stamp, pressure, sigma in zip(rows.stamps, v["pressure"], v["sigma"], strict=True):
        yield r.FluidPressure(stamp, p.frame_id, float(pressure), float(sigma**2))


def _altitude(a: m.Altitude, rows: Rows) -> Iterator[r.Record]:
    v = rows.values
    outside = (v["range"] < a.min_range) | (v["range"] > a.max_range)
    if outside.any():
        rows.notes["no bottom"] = int(outside.sum())
    for stamp, value in zip(rows.stamps, v["range"], strict=True):
        yield r.Range(stamp, a.frame_id, _ULTRASOUND, a.field_of_view, a.min_range, a.max_range, float(value))


def _gps(g: m.Gps, rows: Rows) -> Iterator[r.Record]:
    v, fixed = rows.values, np.ones(len(rows.stamps), dtype=bool)
    for name, rule in g.fix.items():
        met = rows.table.meets(rule)
        if (fixed & ~met).any():
            rows.notes[f"no fix by {name!r}"] = int((fixed & ~met).sum())
        fixed &= met
    for i, stamp in enumerate(rows.stamps):
        variance = [v["sigma"][i] ** 2] * 2 + [v["sigma_vertical"][i] ** 2]
        place = (float(v["latitude"][i]), float(v["longitude"][i]), float(v["altitude"][i]))
        yield r.NavSatFix(stamp, g.frame_id, _FIX if fixed[i] else _NO_FIX, *place, np.diag(variance), _DIAGONAL_KNOWN)


def _actuators(a: m.Actuators, rows: Rows) -> Iterator[r.Record]:
    names = tuple(a.joints)
    turning = np.array([UNITS[a.joints[n].unit][0] == "turn rate" for n in names])
    table = np.stack([rows.values[n] for n in names], axis=1)
    for stamp, row in zip(rows.stamps, table, strict=True):
        position, velocity = np.where(turning, 0.0, row), np.where(turning, row, 0.0)
        yield r.JointState(stamp, a.frame_id, names, position, velocity, np.zeros(0))


def _beacon(b: m.Beacon, rows: Rows) -> Iterator[r.Record]:
    v = rows.values
    for stamp, distance, sigma, delay in zip(rows.stamps, v["range"], v["sigma"], v["travel_delay"], strict=True):
        yield r.BeaconRange(stamp, b.frame_id, rows.name, float(distance), float(sigma**2), float(delay))


_VALUES: dict[str, Callable[[Any, Table], dict[str, Array]]] = {
    "compass": _compass_values,
    "pressure": _pressure_values,
    "altitude": _altitude_values,
    "gps": _gps_values,
    "actuators": _actuator_values,
    "beacons": _beacon_values,
}
_RECORDS: dict[str, Callable[..., Iterator[r.Record]]] = {
    "compass": _compass,
    "pressure": _pressure,
    "altitude": _altitude,
    "gps": _gps,
    "actuators": _actuators,
    "beacons": _beacon,
}
