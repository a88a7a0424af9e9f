"""The check of a log: read its sensors, apply every rule, judge."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from fbn_bringup.check import frames, timing, values
from fbn_bringup.check.findings import Finding, Log, Severity, Verdict
from fbn_bringup.evaluation.series import Traffic
from fbn_common.graph import GRAPH
from fbn_common.records import Record
from fbn_ros.bag import BagReader
from fbn_ros.conversion import ConversionError

Advance = Callable[[float, str], None]
Rule = Callable[[Log], Iterator[Finding]]

SENSORS: Final = tuple(t for t in GRAPH.external_inputs())
NEEDED: Final = ("imu/data", "pressure", "actuators")  # without one of them there is no dead reckoning worth the name
RULES: Final[tuple[Rule, ...]] = (
    values.malformed, timing.order, timing.latency, timing.rates, values.pressure, values.altitude, values.gps,
    values.actuators, values.sonar, frames.orientation,
)  # fmt: skip


def check_bag(path: Path, namespace: str = "", advance: Advance = lambda _f, _t: None) -> Verdict:
    """Everything found in a bag; raises BagError when it cannot be read at all."""
    with BagReader(path, namespace) as reader:
        wrong = list(_wrong_types(reader))
        readable = [t for t in SENSORS if t in reader.topics and t not in {f.topic for f in wrong}]
        log = _read(reader, readable, advance)
        others = sorted(t for t in reader.topics if t not in reader.known)
        damaged = [Finding(Severity.WARNING, "", reader.truncated, "the good part is used")] if reader.truncated else []
    return judge(str(path), log, [*damaged, *wrong, *_strangers(others)])


def judge(name: str, log: Log, found: list[Finding] | None = None) -> Verdict:
    """Apply every rule to a log."""
    missing = tuple(t for t in SENSORS if t not in log.traffic)
    findings = [*(found or []), *_missing(missing), *itertools.chain.from_iterable(rule(log) for rule in RULES)]
    return Verdict(name, log, tuple(sorted(findings, key=lambda f: -f.severity)), missing)


def _missing(missing: tuple[str, ...]) -> Iterator[Finding]:
    for topic in missing:
        severity = Severity.ERROR if topic in NEEDED else Severity.NOTE if topic == "lbl/range" else Severity.WARNING
        yield Finding(severity, topic, "is not in the log", GRAPH.topics[topic].without)
    if "gps/fix" in missing and "lbl/range" in missing:
        yield Finding(
            Severity.WARNING, "gps/fix", "neither GPS nor LBL", "no place on a prior map: only relative navigation"
        )


def _strangers(others: list[str]) -> Iterator[Finding]:
    if others:
        names = ", ".join(others[:6]) + (" …" if len(others) > 6 else "")
        yield Finding(
            Severity.NOTE, "", f"topics of no use here: {names}", "rename those that are meant: docs/topics.md"
        )


def _wrong_types(reader: BagReader) -> Iterator[Finding]:
    for topic in SENSORS:
        if topic in reader.topics and reader.topics[topic].ros_type != GRAPH.topics[topic].ros_type:
            text = f"is {reader.topics[topic].ros_type}, expected {GRAPH.topics[topic].ros_type}"
            yield Finding(Severity.ERROR, topic, text, "convert it: docs/howto/bring-your-own-log.md")


def _read(reader: BagReader, topics: list[str], advance: Advance) -> Log:
    records: dict[str, list[Record]] = defaultdict(list)
    times: dict[str, list[tuple[int, int]]] = defaultdict(list)
    malformed: dict[str, Counter[str]] = defaultdict(Counter)
    span = max(reader.end_ns - reader.start_ns, 1)
    for n, (log_ns, topic, record) in enumerate(reader.entries(topics)):
        if n % 2000 == 0:
            advance((log_ns - reader.start_ns) / span, f"{n} messages")
        if isinstance(record, ConversionError):
            malformed[topic][str(record)] += 1
        else:
            records[topic].append(record)
            times[topic].append((record.stamp_ns, log_ns))
    traffic = {t: Traffic(t, *np.array(pairs, dtype=np.int64).T) for t, pairs in times.items()}
    return Log(dict(records), traffic, dict(malformed))
