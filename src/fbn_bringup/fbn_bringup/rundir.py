"""What a replay writes: ``RUN/bag`` with everything in it, and ``RUN/run.yaml`` with how it came about."""

from __future__ import annotations

import dataclasses
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fbn_bringup.configuration import Parameters, effective
from fbn_common.estimator import Health
from fbn_common.graph import GRAPH, Graph
from fbn_common.types import NS, seconds
from fbn_ros.bag import BagError, BagReader
from fbn_ros.host import Host

STEP_S = 0.2  # s of log time: long against the cost of a round over DDS, short against anything that is fed back

OVERHEAD_TOPICS = frozenset({"clock", "diagnostics", "rosout", "parameter_events"})


class ReplayError(RuntimeError):
    """A replay that could not be brought to its end; the text says where it stood and what was missing."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a replay has come."""

    log_s: float
    total_s: float
    speed: float  # times real time, so far
    text: str = ""

    @property
    def fraction(self) -> float:
        return min(1.0, self.log_s / self.total_s) if self.total_s > 0 else 1.0


OnProgress = Callable[[Progress], None]


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What to replay, with which parameters."""

    parameter_files: tuple[Path, ...] = ()
    overrides: Mapping[str, Any] = field(default_factory=dict)  # node.parameter -> value
    only: tuple[str, ...] = ()  # nodes to run; () = all
    namespace: str = ""  # of the vehicle, in the bag
    extra: Mapping[str, Any] = field(default_factory=dict)  # goes into run.yaml as it is
    graph: Graph = GRAPH

    @property
    def selected(self) -> Graph:
        """The nodes to run; KeyError names those there are."""
        return self.graph.only(self.only) if self.only else self.graph


DEFAULTS = ReplayOptions()


@dataclass(frozen=True, slots=True)
class NodeSummary:
    """One node's part in a run."""

    cpu_s: float
    received: dict[str, int]
    published: dict[str, int]
    refused: dict[str, int]  # malformed messages, by topic
    level: str
    message: str
    values: dict[str, Any]

    @classmethod
    def of(cls, host: Host) -> NodeSummary:
        health: Health = host.health()
        values = {k: v.item() if isinstance(v, np.generic) else v for k, v in health.values.items()}
        received, published, refused = (dict(sorted(c.items())) for c in (host.received, host.published, host.refused))
        return cls(host.cpu_ns / NS, received, published, refused, health.level.name, health.message, values)


@dataclass(frozen=True, slots=True)
class RunSummary:
    """How a run came about; ``run.yaml``."""

    source: str
    mode: str  # offline, lock step, or paced
    step_s: float
    log_start_ns: int
    log_end_ns: int
    wall_s: float
    only: list[str]
    namespace: str
    damaged: str  # what was lost of a truncated bag; "" = nothing
    parameters: dict[str, Any]
    nodes: dict[str, NodeSummary]
    messages: dict[str, int]  # in RUN/bag, by topic
    versions: dict[str, str]
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def log_s(self) -> float:
        return seconds(self.log_end_ns - self.log_start_ns)

    @property
    def speed(self) -> float:
        """Times real time."""
        return self.log_s / self.wall_s if self.wall_s else 0.0


def read_run(run: Path) -> RunSummary:
    """The summary of a run directory; BagError if there is none."""
    try:
        values = yaml.safe_load((run / "run.yaml").read_text())
        nodes = {name: NodeSummary(**node) for name, node in values.pop("nodes").items()}
        return RunSummary(nodes=nodes, **values)
    except (OSError, yaml.YAMLError, TypeError, KeyError, AttributeError) as error:
        raise BagError(f"{run}: not a run directory (written by fbn replay): {error}") from error


def create(run: Path) -> Path:
    """Make an empty run directory and give the path of its bag; BagError if there is a run already."""
    if (run / "bag").exists() or (run / "run.yaml").exists():
        raise BagError(f"{run}: holds a run already; choose another directory or remove it")
    try:
        run.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BagError(f"{run}: cannot write here: {error}") from error
    return run / "bag"


def write_run(run: Path, summary: RunSummary) -> None:
    """Write ``run.yaml``."""
    (run / "run.yaml").write_text(yaml.safe_dump(dataclasses.asdict(summary), sort_keys=False))


def summarise(
    reader: BagReader,
    options: ReplayOptions,
    parameters: Parameters,
    mode: str,
    wall_s: float,
    nodes: dict[str, NodeSummary],
    messages: Mapping[str, int],
) -> RunSummary:
    """The summary of a replay that has come to its end."""
    return RunSummary(
        source=str(reader.path),
        mode=mode,
        step_s=STEP_S,
        log_start_ns=reader.start_ns,
        log_end_ns=reader.end_ns,
        wall_s=wall_s,
        only=list(options.only),
        namespace=options.namespace,
        damaged=reader.truncated,
        parameters=effective(parameters),
        nodes=nodes,
        messages=dict(sorted(messages.items())),
        versions=versions(),
        extra=dict(options.extra),
    )


def versions() -> dict[str, str]:
    """Of everything that can change a result."""
    found = {"python": platform.python_version()}
    for name in ("numpy", "scipy", "numba", "gtsam", "rosbags"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "?"
    return found


def inputs_of(reader: BagReader, graph: Graph) -> frozenset[str]:
    """The topics that the graph's nodes take from this log; BagError if a node would get nothing at all.

    Outputs of the graph's own nodes that the log already has are not among them: they are made anew.
    """
    own = {topic for node in graph.nodes for topic in node.outputs}
    for node in graph.nodes:
        wanted = [t for t in (*node.inputs, *node.feedback) if t not in own]
        there = [t for t in wanted if t in reader.topics and reader.topics[t].count]
        if wanted and not there and not any(t in own for t in node.inputs):
            raise BagError(f"{reader.path}: {node.name} needs {' or '.join(wanted)}; the bag has {_listed(reader)}")
        for topic in there:
            reader.check_type(topic)
    taken = {t for node in graph.nodes for t in (*node.inputs, *node.feedback)} - own
    return frozenset(t for t in taken if t in reader.topics)


def without_outputs(reader: BagReader, graph: Graph) -> Iterator[tuple[int, str, bytes]]:
    """The log's messages that go into the run's bag: all but what the graph makes anew and what only a replay needs."""
    own = {topic for node in graph.nodes for topic in node.outputs} | OVERHEAD_TOPICS
    return reader.raw([topic for topic in reader.topics if topic not in own and not topic.startswith("replay/")])


def _listed(reader: BagReader) -> str:
    names = [c.topic for c in reader.all_connections() if c.msgcount]
    return ", ".join(sorted(names)[:8]) + (" ..." if len(names) > 8 else "")


class Meter:
    """Calls ``on_progress`` a few times a second."""

    PERIOD_S = 0.2  # s of wall clock between two calls

    def __init__(self, reader: BagReader, on_progress: OnProgress | None) -> None:
        self.begin = time.monotonic()
        self._start_ns, self._total_s = reader.start_ns, seconds(reader.end_ns - reader.start_ns)
        self._call, self._due = on_progress, 0.0

    def restart(self) -> None:
        """From here on time counts: the nodes are up."""
        self.begin = time.monotonic()

    @property
    def wall_s(self) -> float:
        return time.monotonic() - self.begin

    def at(self, log_time_ns: int, text: str = "") -> None:
        """The replay has come to this log time."""
        now = time.monotonic()
        if self._call is not None and now >= self._due:
            self._due = now + self.PERIOD_S
            log_s = max(0.0, seconds(log_time_ns - self._start_ns))
            self._call(Progress(log_s, self._total_s, log_s / max(self.wall_s, 1e-9), text))
