"""The whole import: files and a mapping to records in order of time, with an account of every row and message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fbn_bringup.importing import clock, outputs
from fbn_bringup.importing.mapping import Mapping, columns_of
from fbn_bringup.importing.table import LogError, Table, read_table
from fbn_common.records import Record
from fbn_ros.bag import BagWriter

Item = tuple[int, str, Record]  # log time [ns], topic, record


@dataclass(slots=True)
class FileReport:
    """What became of one file's rows."""

    path: Path
    rows: int = 0
    used: int = 0
    start_ns: int = 0
    end_ns: int = 0
    dropped: dict[str, list[int]] = field(default_factory=dict)  # reason: lines
    gaps: tuple[tuple[int, float], ...] = ()  # line after it, length [s]
    notes: dict[str, int] = field(default_factory=dict)


@dataclass(slots=True)
class SensorReport:
    """What became of one sensor's readings."""

    written: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    notes: Counter[str] = field(default_factory=Counter)


@dataclass(slots=True)
class Report:
    """The account of an import."""

    files: list[FileReport] = field(default_factory=list)
    sensors: dict[str, SensorReport] = field(default_factory=dict)


def import_logs(files: Sequence[Path], mapping: Mapping) -> tuple[list[Item], Report]:
    """The records of column logs, in order of time, and what was left out and why.

    Files are taken in the order of their first stamps and make one log.  Raises LogError for a file that the
    mapping does not fit, ParameterError for a unit of the wrong kind.
    """
    report, items = Report(), list[Item]()
    tables = [_open(path, mapping) for path in files]
    tables.sort(key=lambda pair: clock.stamps(pair[0], mapping.time).stamp_ns[0])
    after_ns = 0
    for table, notes in tables:
        entry = FileReport(table.path, len(table), notes=notes)
        items += _read(table, mapping, after_ns, entry, report)
        report.files.append(entry)
        after_ns = max(after_ns, entry.end_ns)
    if not items:
        raise LogError(f"{', '.join(f.name for f in files)}: no message came of any row; {_why_none(report)}")
    items.sort(key=lambda item: item[0])  # stable: of one row, in the mapping's order
    return items, report


def import_to_bag(files: Sequence[Path], mapping: Mapping, bag: Path) -> Report:
    """As :func:`import_logs`, into a bag (rosbag2 directory); BagError if it cannot be written."""
    items, report = import_logs(files, mapping)
    with BagWriter(bag) as writer:
        for log_time_ns, topic, record in items:
            writer.write(log_time_ns, topic, record)
    return report


def _open(path: Path, mapping: Mapping) -> tuple[Table, dict[str, int]]:
    return read_table(path, mapping.file, columns_of(mapping))


def _read(table: Table, mapping: Mapping, after_ns: int, entry: FileReport, report: Report) -> list[Item]:
    """One file's records; the account goes into ``entry`` and ``report``."""
    timed = clock.stamps(table, mapping.time, after_ns)
    entry.dropped, entry.gaps = dict(timed.dropped), timed.gaps
    table, stamp_ns = table.where(timed.keep), timed.stamp_ns
    for name, rule in mapping.rows.items():
        met = table.meets(rule)
        if not met.all():
            entry.dropped[f"rule {name!r}"] = [int(line) for line in table.lines[~met]]
        table, stamp_ns = table.where(met), stamp_ns[met]
    entry.used = len(table)
    if not entry.used:
        return []
    entry.start_ns, entry.end_ns = int(stamp_ns[0]), int(stamp_ns[-1])
    items: list[Item] = []
    for kind, name, sensor in mapping.sensors():
        made = outputs.messages(kind, name, sensor, table, stamp_ns)
        account = report.sensors.setdefault(name if kind != "beacons" else f"lbl/range {name}", SensorReport())
        account.written += len(made.items)
        account.refused.update(made.refused)
        account.notes.update(made.notes)
        items += made.items
    return items


def _why_none(report: Report) -> str:
    reasons = Counter({reason: len(lines) for f in report.files for reason, lines in f.dropped.items()})
    for sensor in report.sensors.values():
        reasons.update(sensor.refused)
    return ", ".join(f"{reason}: {n}" for reason, n in reasons.most_common(4))
