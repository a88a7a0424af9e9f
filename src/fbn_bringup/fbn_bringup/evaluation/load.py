"""A run from disk: the bag, what was recorded of the replay, and the truth beside it."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fbn_bringup.evaluation import truth as t
from fbn_bringup.evaluation.odometry import OdometryTable
from fbn_bringup.evaluation.run import NOT_KEPT, TRACKS, Item, Run, Timing, collect
from fbn_common.estimator import Health, Level
from fbn_common.records import Odometry, Record
from fbn_common.types import NS
from fbn_ros.bag import BagReader
from fbn_ros.conversion import ConversionError

if TYPE_CHECKING:
    from fbn_bringup.rundir import RunSummary

Advance = Callable[[float, str], None]
SHOW_EVERY = 2000  # messages between two words of progress


def load_run(path: Path, truth_file: Path | None = None, advance: Advance = lambda _f, _t: None) -> Run:
    """The run in a directory that a replay wrote, or in a bag recorded live.

    Raises BagError, TruthError or ReplayError with what to do.
    """
    bag, summary = (path / "bag", _summary(path)) if (path / "bag").is_dir() else (path, None)
    found = truth_file or _truth_beside(path, summary)
    truth = t.load(found) if found is not None else None
    namespace = summary.namespace if summary is not None else ""
    with BagReader(bag, namespace) as reader:
        tables: dict[str, OdometryTable] = defaultdict(OdometryTable)
        items = list(_items(reader, tables, advance))
        run = collect(items, path.resolve().name, truth, {t: table.track() for t, table in tables.items()})
    return _with_summary(run, summary) if summary is not None else run


def _items(reader: BagReader, tables: dict[str, OdometryTable], advance: Advance) -> Iterator[Item]:
    """Every message that has a record; odometry goes to its table, and of what is only counted the stamp is decoded."""
    span = max(reader.end_ns - reader.start_ns, 1)
    known = [topic for topic in reader.topics if topic in reader.known]
    for topic in known:
        reader.check_type(topic)
    odometry = {topic for topic in TRACKS if topic in known and reader.known[topic].record is Odometry}
    for n, (log_ns, topic, data) in enumerate(reader.raw(known)):
        if n % SHOW_EVERY == 0:
            advance((log_ns - reader.start_ns) / span, f"{n} messages")
        if topic in odometry:
            tables[topic].add(_stamp(data), data)
        bare = topic in odometry or topic in NOT_KEPT
        record = Record(_stamp(data)) if bare else reader.decode(topic, data)
        if not isinstance(record, ConversionError):
            yield log_ns, topic, record


def _stamp(data: bytes) -> int:
    """The header's stamp [ns], first in every message: after four bytes of encapsulation, little endian."""
    second, nanosecond = struct.unpack_from("<iI", data, 4)
    return int(second) * NS + int(nanosecond)


def _summary(path: Path) -> RunSummary | None:
    from fbn_bringup.rundir import read_run

    return read_run(path) if (path / "run.yaml").is_file() else None


def _truth_beside(path: Path, summary: RunSummary | None) -> Path | None:
    """truth.yaml in the run, in its bag, or beside the log that it came from."""
    places = [path, path / "bag"]
    if summary is not None:
        places.append(Path(summary.source))
    return next((place / t.FILE for place in places if (place / t.FILE).is_file()), None)


def _with_summary(run: Run, summary: RunSummary) -> Run:
    health = {name: Health(Level[n.level], n.message, dict(n.values)) for name, n in summary.nodes.items()}
    parameters = {name: dict(values["ros__parameters"]) for name, values in summary.parameters.items()}
    cpu_s = {name: n.cpu_s for name, n in summary.nodes.items()}
    timing = Timing(summary.mode, summary.wall_s, summary.log_s, cpu_s)
    return replace(run, health=health, parameters=parameters, timing=timing)
