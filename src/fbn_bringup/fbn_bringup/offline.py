"""The graph in one process: deterministic, without ROS, as fast as the machine can.

Replay goes in steps of log time.  In each, every node takes what was logged during the step and what the nodes
before it published in it, and advances to the step's end; what closes a loop (a node's ``feedback``) is taken in the
step after.  The replay over DDS keeps to the same rule, so both give the same answer.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from fbn_bringup import rundir
from fbn_bringup.configuration import load_parameters
from fbn_bringup.rundir import DEFAULTS, STEP_S, OnProgress, ReplayOptions, RunSummary
from fbn_common.graph import Graph
from fbn_common.records import Record
from fbn_common.types import nanoseconds
from fbn_ros.bag import BagReader, BagWriter
from fbn_ros.cdr import Cdr
from fbn_ros.conversion import ConversionError
from fbn_ros.host import Host

GAP_S = 60.0  # s: a longer silence in a log is skipped; the nodes advance over it in one step

Entry = Record | ConversionError
Batch = defaultdict[str, list[Entry]]
Sink = Callable[[int, str, Record], None]


class Step(NamedTuple):
    """What was logged in ``(end - step, end]``."""

    end_ns: int
    logged: list[tuple[int, str, Any]]


def steps(log: Iterable[tuple[int, str, Any]], step_s: float = STEP_S) -> Iterator[Step]:
    """The log, in time order, cut at whole multiples of the step, empty steps included; payloads are passed on.

    A log time that decreases stays in the step that is open.
    """
    length, gap = nanoseconds(step_s), nanoseconds(GAP_S)
    end_ns, batch = 0, list[tuple[int, str, Any]]()
    for entry in log:
        own_end = -(-entry[0] // length) * length
        end_ns = end_ns or own_end
        if own_end > end_ns + gap:
            yield Step(end_ns, batch)
            end_ns, batch = own_end, []
        while own_end > end_ns:
            yield Step(end_ns, batch)
            end_ns, batch = end_ns + length, []
        batch.append(entry)
    if batch:
        yield Step(end_ns, batch)


class Runner:
    """The nodes of a graph, fed step by step."""

    def __init__(self, hosts: list[Host]) -> None:
        self.hosts = hosts
        self._feedback = {topic for host in hosts for topic in host.node.feedback}
        self._cdr = Cdr()
        self._fed_back: Batch = defaultdict(list)  # of the step before
        self._held: Batch = defaultdict(list)  # of this step

    @classmethod
    def build(cls, graph: Graph, parameters: dict[str, Any]) -> Runner:
        """The estimators of all nodes, with their parameters by node name."""
        return cls([Host.build(node, parameters[node.name]) for node in graph.nodes])

    def step(
        self, end_ns: int, logged: Iterable[tuple[int, str, Entry]], *, whole: bool = True
    ) -> list[tuple[str, Record]]:
        """Take in a step's messages and advance every node; everything published, in order.

        With ``whole`` false this is only the first part of a step: what closes a loop waits until the step is over.
        """
        batch: Batch = defaultdict(list)
        for _, topic, entry in logged:
            batch[topic].append(entry)
        published: list[tuple[str, Record]] = []
        for host in self.hosts:
            self._feed(host, batch)
            place = {topic: i for i, topic in enumerate(host.node.outputs)}
            for topic, record in sorted(host.advance(end_ns), key=lambda output: place[output.topic]):
                record = self._cdr.as_sent(record)
                batch[topic].append(record)
                published.append((topic, record))
        self._fed_back = defaultdict(list)
        for topic in self._feedback & batch.keys():
            self._held[topic] += batch[topic]
        if whole:
            self._fed_back, self._held = self._held, defaultdict(list)
        return published

    def _feed(self, host: Host, batch: Batch) -> None:
        for topics, source in ((host.node.inputs, batch), (host.node.feedback, self._fed_back)):
            for topic in topics:
                for entry in source.get(topic, ()):
                    host.put(topic, entry)


def run_offline(
    graph: Graph,
    parameters: dict[str, Any],
    log: Iterable[tuple[int, str, Entry]],
    sink: Sink = lambda log_time_ns, topic, record: None,
    step_s: float = STEP_S,
) -> list[Host]:
    """Run a log through the graph; every output goes to ``sink(log_time_ns, topic, record)``.

    ``log`` yields log time, topic and record (or the error it was refused with) in order of time.  Messages on topics
    that a node of the graph publishes are left out.  Gives the hosts, with their counts, times and health.
    """
    runner = Runner.build(graph, parameters)
    own = {topic for node in graph.nodes for topic in node.outputs}
    for step in steps((entry for entry in log if entry[1] not in own), step_s):
        for log_time_ns, (topic, record) in stamped(step.end_ns, runner.step(*step)):
            sink(log_time_ns, topic, record)
    return runner.hosts


def stamped(end_ns: int, outputs: list[Any]) -> Iterator[tuple[int, Any]]:
    """A step's outputs with log times that keep their order, one nanosecond apart, and end with the step."""
    first = end_ns - len(outputs) + 1
    return ((first + i, output) for i, output in enumerate(outputs))


def replay_offline(
    bag: Path, run: Path, options: ReplayOptions = DEFAULTS, on_progress: OnProgress | None = None
) -> RunSummary:
    """Replay a log in this process and write the run directory.

    Raises BagError, ParameterError, or KeyError for a node in ``only`` that does not exist.
    """
    graph = options.selected
    parameters = load_parameters(graph, options.parameter_files, options.overrides)
    with BagReader(bag, options.namespace) as reader:
        inputs = rundir.inputs_of(reader, graph)
        runner = Runner.build(graph, parameters)
        with BagWriter(rundir.create(run)) as writer:
            meter = rundir.Meter(reader, on_progress)
            for step in steps(rundir.without_outputs(reader, graph)):
                logged = [(t, topic, reader.decode(topic, raw)) for t, topic, raw in step.logged if topic in inputs]
                for log_time_ns, topic, raw in step.logged:
                    writer.copy(log_time_ns, topic, raw, reader)
                for log_time_ns, (topic, record) in stamped(step.end_ns, runner.step(step.end_ns, logged)):
                    writer.write(log_time_ns, topic, record)
                meter.at(step.end_ns)
            nodes = {host.node.name: rundir.NodeSummary.of(host) for host in runner.hosts}
            counts = writer.counts
        summary = rundir.summarise(reader, options, parameters, "offline", meter.wall_s, nodes, counts)
        rundir.write_run(run, summary)
    return summary
