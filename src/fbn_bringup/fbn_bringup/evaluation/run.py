"""A run in memory: everything evaluation and report need of a bag, as arrays and short lists."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from fbn_bringup.evaluation.dives import Dive, dives, whole
from fbn_bringup.evaluation.series import Innovations, Track, Traffic, innovations, track
from fbn_bringup.evaluation.truth import Truth
from fbn_common import records as r
from fbn_common.estimator import Health
from fbn_common.graph import GRAPH, SIMULATOR_TOPICS

R = TypeVar("R", bound=r.Record)

TRACKS = ("truth/odometry", "deadreck/odometry", "reference/odometry", "global/odometry", "global/pose")
NOT_KEPT = ("predict/motion", "imu/data", "pressure", "actuators")  # many messages; only their times are kept
KNOWN = (*GRAPH.topics, *(t.name for t in SIMULATOR_TOPICS))

Item = tuple[int, str, r.Record]  # log time [ns], topic, record


class RunError(ValueError):
    """A run cannot be evaluated; the text says what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class Timing:
    """What a replay cost."""

    mode: str  # offline, lock step, or paced
    wall_s: float
    log_s: float
    cpu_s: dict[str, float]  # by node

    @property
    def speed(self) -> float:
        """Times real time."""
        return self.log_s / self.wall_s if self.wall_s > 0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One run: tracks by topic, the other records by topic, innovations by sensor, traffic by topic."""

    name: str
    tracks: dict[str, Track]
    records: dict[str, list[r.Record]]
    innovations: tuple[Innovations, ...]
    traffic: dict[str, Traffic]
    truth: Truth | None = None  # in the run's map
    health: dict[str, Health] = field(default_factory=dict)
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    timing: Timing | None = None

    def of(self, topic: str, kind: type[R]) -> list[R]:
        """The records of a topic, by stamp."""
        return [x for x in self.records.get(topic, ()) if isinstance(x, kind)]

    def logged_ns(self, topic: str) -> dict[int, int]:
        """When each record of a topic was logged first, by its stamp."""
        traffic = self.traffic.get(topic)
        if traffic is None:
            return {}
        pairs = zip(traffic.stamp_ns[::-1].tolist(), traffic.log_ns[::-1].tolist(), strict=True)
        return dict(pairs)

    @property
    def true_track(self) -> Track | None:
        """The true path in the run's map; None where it is not known."""
        return self.tracks.get("truth/odometry")

    def legs(self) -> tuple[Dive, ...]:
        """The dives, by truth where known, else by dead reckoning; a run that never dives is one leg."""
        for topic in ("truth/odometry", "deadreck/odometry", "reference/odometry"):
            if topic in self.tracks:
                return dives(self.tracks[topic]) or (whole(self.tracks[topic]),)
        return ()

    @property
    def start_ns(self) -> int:
        """The first stamp of all tracks; where the report's time begins."""
        return min((int(t.stamp_ns[0]) for t in self.tracks.values() if len(t)), default=0)


def collect(
    items: Iterable[Item], name: str = "run", truth: Truth | None = None, ready: Mapping[str, Track] | None = None
) -> Run:
    """A run of items in log order; topics may carry a namespace; truth is moved into the run's map.

    ``ready`` are tracks decoded already; their items serve for the traffic alone.
    """
    ready = ready or {}
    kept: dict[str, list[r.Record]] = defaultdict(list)
    times: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for log_ns, topic, record in items:
        plain = without_namespace(topic)
        times[plain].append((record.stamp_ns, log_ns))
        if plain not in NOT_KEPT and plain not in ready:
            kept[plain].append(record)
    tracks = {t: track(kept.pop(t)) for t in TRACKS if kept.get(t)}  # type: ignore[arg-type]
    tracks |= {t: made for t, made in ready.items() if len(made)}
    tables = tuple(table for t in list(kept) if t.endswith("/innovations") for table in _by_sensor(t, kept.pop(t)))
    for records in kept.values():
        records.sort(key=lambda x: x.stamp_ns)
    traffic = {t: Traffic(t, *np.array(pairs, dtype=np.int64).T) for t, pairs in times.items()}
    return _in_map(Run(name, tracks, dict(kept), tables, traffic), truth)


def _in_map(run: Run, truth: Truth | None) -> Run:
    """The run with truth expressed in its own map, whose datum may be a first fix with its error."""
    if truth is None:
        return run
    data = run.of("reference/datum", r.Datum)
    offset = truth.offset_to(data[-1] if data else None)
    tracks = dict(run.tracks)
    if "truth/odometry" in tracks:
        tracks["truth/odometry"] = tracks["truth/odometry"].shifted(offset)
    return Run(run.name, tracks, run.records, run.innovations, run.traffic, truth.shifted(offset))


def _by_sensor(topic: str, records: list[r.Record]) -> list[Innovations]:
    by_sensor: dict[str, list[r.Innovation]] = defaultdict(list)
    for record in records:
        if isinstance(record, r.Innovation):
            by_sensor[record.sensor].append(record)
    node = topic.removesuffix("/innovations")
    return [innovations(node, sensor, found) for sensor, found in sorted(by_sensor.items())]


def without_namespace(topic: str) -> str:
    """The graph's name of a topic: without the leading slash and a vehicle's namespace."""
    plain = topic.lstrip("/")
    if plain in KNOWN:
        return plain
    return max((k for k in KNOWN if plain.endswith("/" + k)), key=len, default=plain)
