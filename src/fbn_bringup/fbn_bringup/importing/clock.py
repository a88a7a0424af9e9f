"""From a log's cells to stamps, and what is wrong with them: wraps, repeats, steps back, leaps."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation

import numpy as np
import numpy.typing as npt

from fbn_bringup.importing.mapping import Clock
from fbn_bringup.importing.table import LogError, Mask, Table
from fbn_common.types import NS, nanoseconds

Stamps = npt.NDArray[np.int64]
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_PERIOD_NS = {"mm:ss": 3600 * NS, "hh:mm:ss": 86400 * NS}  # after which such a time begins anew
_FIELDS = ("year", "month", "day", "hour", "minute")


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """Stamps of the rows kept (``keep`` is a mask of all), strictly increasing, and why others were not."""

    stamp_ns: Stamps
    keep: Mask
    dropped: dict[str, list[int]]  # reason: lines in the file
    gaps: tuple[tuple[int, float], ...]  # line after the gap, its length [s]


def stamps(table: Table, clock: Clock, after_ns: int = 0) -> Timed:
    """Stamps of a table's rows; all kept ones are later than ``after_ns``. LogError where the mapping does not fit."""
    readings = [_reading(cell, clock, table) for cell in table.cells[clock.column]]
    known = [i for i, value in enumerate(readings) if value is not None]
    if not known:
        sample = next((c for c in table.cells[clock.column] if c), "")
        wanted = f"a time of format {clock.format!r}"
        raise LogError(f"{table.path}: no cell of {clock.column!r} is {wanted}, e.g. {sample!r}; set time.format")
    reading = np.array([readings[i] for i in known], dtype=np.int64)
    if clock.format in _PERIOD_NS and not (clock.date_column and clock.format == "hh:mm:ss"):
        reading = _unwrapped(reading, _PERIOD_NS[clock.format])
    stamp = reading + _origin(table, clock, known, int(reading[0]))
    good, reasons = _increasing(stamp, nanoseconds(clock.longest_gap), after_ns)
    keep = np.zeros(len(table), dtype=bool)
    keep[np.array(known)[good]] = True
    dropped = {"no time": [int(x) for x in table.lines[[i for i in range(len(table)) if i not in set(known)]]]}
    for i, reason in reasons.items():
        dropped.setdefault(reason, []).append(int(table.lines[known[i]]))
    kept, lines = stamp[good], table.lines[keep]
    steps = np.diff(kept) / NS
    gaps = tuple((int(lines[i + 1]), float(steps[i])) for i in np.flatnonzero(steps > clock.longest_gap))
    return Timed(kept, keep, {reason: x for reason, x in dropped.items() if x}, gaps)


def _reading(cell: str, clock: Clock, table: Table) -> int | None:
    """A cell as nanoseconds of its period, since 1970, or since the log's start; None where it is no time."""
    try:
        if clock.format in ("seconds", "milliseconds"):
            unit = NS if clock.format == "seconds" else NS // 1000
            return _whole(Decimal(cell.replace(table.format.decimal, ".")) * unit)
        if clock.format in _PERIOD_NS:
            parts = [Decimal(p.replace(table.format.decimal, ".")) for p in cell.split(":")]
            if len(parts) != clock.format.count(":") + 1 or not all(0 <= p < 61 for p in parts):
                return None
            weights = (NS, 60 * NS, 3600 * NS)
            return _whole(sum((p * w for p, w in zip(reversed(parts), weights, strict=False)), Decimal(0)))
        iso = clock.format == "iso"
        return _absolute(datetime.fromisoformat(cell) if iso else datetime.strptime(cell, clock.format))
    except (ValueError, InvalidOperation):
        return None


def _whole(value: Decimal) -> int | None:
    return round(value) if value.is_finite() else None


def _absolute(moment: datetime) -> int:
    """Nanoseconds since 1970; without a zone of its own it counts as UTC."""
    return (moment.replace(tzinfo=moment.tzinfo or UTC) - _EPOCH) // timedelta(microseconds=1) * 1000


def _unwrapped(reading: Stamps, period: int) -> Stamps:
    """Readings that go on where the cell's time began anew; a step back of less than half a period stays one."""
    turns = np.round(np.diff(reading) / period).astype(np.int64)
    return reading - period * np.concatenate([[0], np.cumsum(turns)])


def _origin(table: Table, clock: Clock, known: list[int], first_ns: int) -> Stamps | int:
    """What is added to the readings [ns]: the day (and hour) where they have none, and the offset to UTC."""
    offset = -nanoseconds(3600.0 * clock.utc_offset)
    if clock.format in ("seconds", "milliseconds"):
        return (_absolute(datetime.fromisoformat(clock.start)) if clock.start else 0) + offset
    if clock.format not in _PERIOD_NS:
        return offset
    if clock.format == "hh:mm:ss" and clock.date_column:
        return np.array([_absolute(_day(table, clock, i)) for i in known], dtype=np.int64) + offset
    begin, minute_known = _begin(table, clock, known[0])
    if clock.format == "hh:mm:ss":
        return _absolute(begin.replace(hour=0, minute=0, second=0)) + offset
    hour = _absolute(begin.replace(minute=0, second=0))
    if minute_known:  # the first reading may belong to the hour before or after the one named
        hour += 3600 * NS * round((_absolute(begin) - hour - first_ns) / (3600 * NS))
    return hour + offset


def _begin(table: Table, clock: Clock, row: int) -> tuple[datetime, bool]:
    """When the log begins, by date column, file name and mapping, in this order; and whether the minute is known."""
    said: dict[str, int] = {}
    if clock.file_name:
        match = re.search(clock.file_name, table.path.name)
        if match is None:
            remedy = "rename the file, or set time.start"
            raise LogError(f"{table.path}: the name does not fit time.file_name {clock.file_name!r}; {remedy}")
        said = {k: int(v) for k, v in match.groupdict().items() if v is not None and k in _FIELDS}
    base = datetime.fromisoformat(clock.start) if clock.start else None
    if clock.date_column:
        day = _day(table, clock, row)
        said |= {"year": day.year, "month": day.month, "day": day.day}
    if base is None and not {"year", "month", "day"} <= said.keys():
        raise LogError(f"{table.path}: nothing says the day; set time.date_column, time.file_name or time.start")
    if base is None and clock.format == "mm:ss" and "hour" not in said:
        raise LogError(f"{table.path}: nothing says the hour of the first row; set time.file_name or time.start")
    minute_known = base is not None or "minute" in said
    base = base or datetime(said["year"], said["month"], said["day"])
    return base.replace(**said), minute_known  # type: ignore[arg-type]


def _day(table: Table, clock: Clock, row: int) -> datetime:
    cell = table.cells[clock.date_column][row]
    try:
        return datetime.strptime(cell, clock.date_format)
    except ValueError:
        where = f"{table.path}, line {table.lines[row]}: {clock.date_column!r}"
        raise LogError(f"{where} is {cell!r}, not of format {clock.date_format!r}; set time.date_format") from None


def _increasing(stamp: Stamps, leap_ns: int, after_ns: int) -> tuple[npt.NDArray[np.int64], dict[int, str]]:
    """Indices whose stamps strictly increase, and the reason for every other one.

    One that leaps ahead by more than ``leap_ns`` while the next one goes on as before is itself the wrong one.
    """
    good: list[int] = []
    reasons: dict[int, str] = {}
    last = after_ns
    for i in range(len(stamp)):
        if stamp[i] <= last:
            reasons[i] = "repeated stamp" if stamp[i] == last else "stamp goes back"
        elif good and i + 1 < len(stamp) and stamp[i] - last > leap_ns and last < stamp[i + 1] <= stamp[i]:
            reasons[i] = "stamp leaps ahead and back"
        else:
            good.append(i)
            last = int(stamp[i])
    return np.array(good, dtype=np.int64), reasons


def describe(stamp_ns: int) -> str:
    """A stamp as date and time (UTC), for people."""
    return (_EPOCH + timedelta(microseconds=stamp_ns // 1000)).strftime("%Y-%m-%d %H:%M:%S.%f")[:-5] + " UTC"
