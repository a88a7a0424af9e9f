"""What a mapping file says: which columns, in which units and conventions, become which topics.

The file is YAML; its groups and keys are the dataclasses below.  Unknown keys and wrong types are refused with the
nearest key there is; a column that the log does not have is refused with the nearest one it has.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any

import yaml

from fbn_bringup.importing import units
from fbn_common import records as r
from fbn_common.graph import GRAPH
from fbn_common.parameters import ParameterError, group, load, param

_FILE = "set by the mapping"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number in every row: the weighted sum of columns, less ``zero``, times ``scale``, in ``unit``; or a constant.

    In a covariance's place it is a standard deviation.  Neither columns nor a value: the quantity is absent.
    """

    columns: tuple[str, ...] = param((), "-", "their mean, or their sum by weights", _FILE)
    weights: tuple[float, ...] = param((), "-", "one for each column; none: the mean", _FILE)
    value: float | None = param(None, "the unit below", "a constant in place of columns", _FILE)
    unit: str = param("-", "-", "of the value after scaling", _FILE)
    zero: float = param(0.0, "the column's", "the column's reading at zero, e.g. 128 counts", _FILE)
    scale: float = param(1.0, "unit per the column's", "negative where the column's sign is the other one", _FILE)
    least: float | None = param(None, "the column's", "smaller readings are invalid", _FILE)
    most: float | None = param(None, "the column's", "greater readings are invalid", _FILE)
    floor: float | None = param(None, "the unit above", "smaller results are raised to this (for deviations)", _FILE)

    def __post_init__(self) -> None:
        if self.columns and self.value is not None:
            raise ParameterError(f"columns {list(self.columns)} and the constant {self.value} exclude each other")
        if self.weights and len(self.weights) != len(self.columns):
            raise ParameterError(f"{len(self.columns)} columns need as many weights, got {len(self.weights)}")

    @property
    def given(self) -> bool:
        """Is there such a quantity at all?"""
        return bool(self.columns) or self.value is not None

    def si(self, *dimensions: str) -> float:
        """SI units in one of its unit; ParameterError unless that is of these dimensions."""
        return units.factor(self.unit, *dimensions)


@dataclass(frozen=True, slots=True)
class Rule:
    """A condition on one column, in the column's own readings; a missing cell does not meet it."""

    column: str = param(MISSING, "-", "the column", _FILE)
    least: float | None = param(None, "the column's", "met from this reading on", _FILE)
    most: float | None = param(None, "the column's", "met up to this reading", _FILE)
    above: float | None = param(None, "the column's", "met by greater readings", _FILE)
    below: float | None = param(None, "the column's", "met by smaller readings", _FILE)
    equals: tuple[float, ...] = param((), "the column's", "met by one of these", _FILE)
    differs: tuple[float, ...] = param((), "the column's", "met by any reading but these", _FILE)
    says: tuple[str, ...] = param((), "-", "met by one of these texts", _FILE)


@dataclass(frozen=True, slots=True)
class FileFormat:
    """How to read the cells."""

    encoding: str = param("utf-8-sig", "-", "of the characters, e.g. latin-1", "most writers")
    delimiter: str = param(",", "-", "between cells; '\\t' for tabs", "csv")
    decimal: str = param(".", "-", "decimal sign", "csv")
    skip_lines: int = param(0, "-", "lines before the one with the names of columns", "csv")
    missing: tuple[str, ...] = param((), "-", "cells that say there is no value, beside empty ones and NaN", _FILE)

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1 or len(self.decimal) != 1 or self.skip_lines < 0:
            raise ParameterError("delimiter and decimal are one character each; skip_lines is not negative")


@dataclass(frozen=True, slots=True)
class Clock:
    """From cells to stamps (UTC)."""

    column: str = param(MISSING, "-", "time of the row", _FILE)
    format: str = param("seconds", "-", "seconds, milliseconds, iso, hh:mm:ss, mm:ss, or a strptime pattern", _FILE)
    date_column: str = param("", "-", "the day, for times without one", _FILE)
    date_format: str = param("%Y-%m-%d", "-", "strptime pattern of that", "ISO 8601")
    file_name: str = param(
        "", "-", "regular expression with groups year, month, day, hour, minute, for the name", _FILE
    )
    start: str = param("", "-", "ISO date and time at which the log starts, for what nothing else says", _FILE)
    utc_offset: float = param(0.0, "h", "local time less UTC", "the log is in UTC")
    longest_gap: float = param(
        5.0, "s", "longer ones are reported; a lone stamp that leaps so far is dropped", "logs at 1 Hz or faster"
    )

    def __post_init__(self) -> None:
        if self.longest_gap <= 0.0:
            raise ParameterError("longest_gap must be positive")


@dataclass(frozen=True, slots=True)
class Sensor:
    """What all topics share; its rules decide which rows give a message."""

    frame_id: str = param("base_link", "-", "frame of the measurement", "REP 105")
    age: float = param(0.0, "s", "of the measurement at the row's time", "measured when logged")
    when: dict[str, Rule] = group(dict)
    repeats: bool = param(True, "-", "false: cells equal to those of the row before are no new measurement", _FILE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Compass(Sensor):
    """Orientation and turn rates.

    ``ned``: yaw is a heading, clockwise from north, pitch is positive bow up, rates are about forward, right, down.
    """

    convention: str = param(MISSING, "-", "ned, or enu (yaw left of east, pitch positive bow down, as ours)", _FILE)
    roll: Quantity = group(Quantity)
    pitch: Quantity = group(Quantity)
    yaw: Quantity = group(Quantity)
    variation: Quantity = group(lambda: Quantity(value=0.0, unit="deg"))  # added to a magnetic heading, east positive
    sigma_tilt: Quantity = group(Quantity)
    sigma_yaw: Quantity = group(Quantity)
    rate_x: Quantity = group(Quantity)
    rate_y: Quantity = group(Quantity)
    rate_z: Quantity = group(Quantity)
    sigma_rate: Quantity = group(Quantity)

    def __post_init__(self) -> None:
        if self.convention not in ("ned", "enu"):
            raise ParameterError(f"convention must be 'ned' or 'enu', got {self.convention!r}")
        _need(self, "yaw", "roll", "pitch", "sigma_tilt", "sigma_yaw")


@dataclass(frozen=True, slots=True)
class Pressure(Sensor):
    """Absolute pressure, or a depth that is turned back into the pressure it came from."""

    depth: Quantity = group(Quantity)
    pressure: Quantity = group(Quantity)
    sigma: Quantity = group(Quantity)  # of whichever is given
    density: float = param(1000.0, "kg/m^3", "that the depth was computed with; the estimators' is 1000", "fresh water")
    gravity: float = param(9.80665, "m/s^2", "likewise", "standard gravity")
    surface_pressure: float = param(101325.0, "Pa", "likewise", "standard atmosphere")

    def __post_init__(self) -> None:
        if self.depth.given == self.pressure.given:
            raise ParameterError("needs either depth or pressure")
        _need(self, "sigma")


@dataclass(frozen=True, slots=True)
class Altitude(Sensor):
    """Altimeter; readings outside [min_range, max_range] are handed on and mean: no bottom."""

    frame_id: str = param("altimeter_link", "-", "frame of the measurement", "the altimeter looks along its x")
    range: Quantity = group(Quantity)
    min_range: float = param(0.3, "m", "nearest bottom it can tell", "altimeters of 500 kHz")
    max_range: float = param(100.0, "m", "farthest", "altimeters of 500 kHz")
    field_of_view: float = param(0.1, "rad", "width of the beam", "6 deg")

    def __post_init__(self) -> None:
        _need(self, "range")


@dataclass(frozen=True, slots=True)
class Gps(Sensor):
    """Fixes; a row that does not meet ``fix`` is handed on with status -1 (no fix)."""

    frame_id: str = param("gps_link", "-", "frame of the antenna", "REP 105")
    latitude: Quantity = group(Quantity)
    longitude: Quantity = group(Quantity)
    altitude: Quantity = group(lambda: Quantity(value=0.0, unit="m"))
    sigma: Quantity = group(Quantity)  # horizontal, each axis; e.g. HDOP times metres
    sigma_vertical: Quantity = group(lambda: Quantity(value=10.0, unit="m"))
    fix: dict[str, Rule] = group(dict)

    def __post_init__(self) -> None:
        _need(self, "latitude", "longitude", "sigma")


@dataclass(frozen=True, slots=True)
class Actuators(Sensor):
    """Joints by name (propeller, pan, tilt, rudder, stern_plane): a rate or an angle each."""

    joints: dict[str, Quantity] = group(dict)

    def __post_init__(self) -> None:
        if not self.joints:
            raise ParameterError("needs at least one of joints")


@dataclass(frozen=True, slots=True)
class Beacon(Sensor):
    """Ranges to one acoustic beacon; the group's name is the beacon's."""

    range: Quantity = group(Quantity)
    sigma: Quantity = group(Quantity)
    travel_delay: Quantity = group(lambda: Quantity(value=0.0, unit="s"))

    def __post_init__(self) -> None:
        _need(self, "range", "sigma")


@dataclass(frozen=True, slots=True)
class Mapping:
    """A mapping file.  The groups of sensors hold one group per topic, those of beacons one per beacon."""

    time: Clock
    about: str = param("", "-", "which vehicle and logger", _FILE)
    file: FileFormat = field(default_factory=FileFormat)
    rows: dict[str, Rule] = group(dict)  # rows that do not meet them all are left out altogether
    compass: dict[str, Compass] = group(dict)
    pressure: dict[str, Pressure] = group(dict)
    altitude: dict[str, Altitude] = group(dict)
    gps: dict[str, Gps] = group(dict)
    actuators: dict[str, Actuators] = group(dict)
    beacons: dict[str, Beacon] = group(dict)

    def __post_init__(self) -> None:
        for name, kind in _TOPIC_KINDS.items():
            for topic in getattr(self, name):
                fitting = [t.name for t in GRAPH.topics.values() if t.record is kind]
                if topic not in fitting:
                    raise ParameterError(
                        f"{name}: {topic!r} is no topic of {kind.ros_type}; use {' or '.join(fitting)}"
                    )
        if not any(getattr(self, name) for name in SENSORS):
            raise ParameterError(f"maps nothing: it needs one of {', '.join(SENSORS)}")

    def sensors(self) -> Iterator[tuple[str, str, Sensor]]:
        """Group, name (topic or beacon) and mapping of every sensor."""
        for kind in SENSORS:
            for name, sensor in getattr(self, kind).items():
                yield kind, name, sensor


SENSORS = ("compass", "pressure", "altitude", "gps", "actuators", "beacons")
_TOPIC_KINDS: dict[str, type[r.Record]] = {
    "compass": r.Imu,
    "pressure": r.FluidPressure,
    "altitude": r.Range,
    "gps": r.NavSatFix,
    "actuators": r.JointState,
}


def read_mapping(path: Path) -> Mapping:
    """The mapping in a file; ParameterError names file, key and remedy."""
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterError(f"{path}: not a readable mapping: {error}") from error
    if not isinstance(document, dict):
        raise ParameterError(
            f"{path}: expected groups of keys (time, compass, gps, ...), got {type(document).__name__}"
        )
    try:
        return load(Mapping, {str(key): value for key, value in document.items()})
    except ParameterError as error:
        text = str(error).replace("  (fbn params lists all)", "  (fbn import keys lists all)")
        raise ParameterError(f"{path}: {text}") from error


def restrict(mapping: Mapping, conditions: Iterable[str]) -> Mapping:
    """The mapping for those rows alone that meet conditions like ``Vehicle State=1``; ParameterError if one is none."""
    rows = dict(mapping.rows)
    for condition in conditions:
        column, equals, value = condition.rpartition("=")
        try:
            rows[condition] = Rule(column.strip(), equals=(float(value),))
        except ValueError:
            column = ""
        if not equals or not column.strip():
            raise ParameterError(f"{condition!r}: expected COLUMN=NUMBER, e.g. 'Vehicle State=1'")
    return dataclasses.replace(mapping, rows=rows)


def columns_of(node: Any) -> Iterator[str]:
    """Every column that a mapping, or a part of one, speaks of."""
    if isinstance(node, Quantity):
        yield from node.columns
    elif isinstance(node, Rule):
        yield node.column
    elif isinstance(node, Clock):
        yield from (c for c in (node.column, node.date_column) if c)
    elif isinstance(node, dict):
        for item in node.values():
            yield from columns_of(item)
    elif dataclasses.is_dataclass(node):
        for f in dataclasses.fields(node):
            yield from columns_of(getattr(node, f.name))


def _need(sensor: Sensor, *names: str) -> None:
    absent = [name for name in names if not getattr(sensor, name).given]
    if absent:
        raise ParameterError(f"needs {', '.join(absent)}: columns, or a constant value")
