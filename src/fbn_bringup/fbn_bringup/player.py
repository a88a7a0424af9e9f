"""What both players have in common: the log's messages out, the nodes' messages in, and into the run's bag."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

from fbn_bringup.rundir import Meter
from fbn_common.graph import Graph
from fbn_common.types import NS
from fbn_ros.bag import KNOWN_TOPICS, BagReader, BagWriter
from fbn_ros.station import DIAGNOSTICS_TYPE, Report, Station

START_S = 600.0  # s for the nodes to come up, all alive; a first start compiles their kernels on however few cores


class Player:
    """Plays a log's messages from a station, and hears everything that the graph's nodes say."""

    lock_step = True

    def __init__(
        self,
        station: Station,
        graph: Graph,
        reader: BagReader,
        writer: BagWriter,
        inputs: frozenset[str],
        check: Callable[[], None],
    ) -> None:
        self.station, self.graph, self.reader, self.writer = station, graph, reader, writer
        self.inputs = sorted(inputs)
        self.outputs = [t for node in graph.nodes for t in node.outputs]
        self.published: Counter[str] = Counter()  # by the nodes
        self.played: Counter[str] = Counter()
        self.health: dict[str, Report] = {}
        self._check = check
        for topic in self.inputs:
            station.offer(KNOWN_TOPICS[topic])
        for topic in self.outputs:
            self._listen(topic)
        station.listen_to_diagnostics(self._on_report)

    def wait_for_nodes(self) -> None:
        """Return when every node takes what is played and is heard."""
        raise NotImplementedError

    def play(self, meter: Meter, rate: float) -> None:
        """Play the whole log."""
        raise NotImplementedError

    def heard(self, topic: str, data: bytes) -> None:
        """A node has published."""
        raise NotImplementedError

    def say(self, topic: str, data: bytes) -> None:
        """Publish a message of the log."""
        self.station.say(topic, data)
        self.played[topic] += 1

    def spin(self, timeout_s: float) -> None:
        """Serve callbacks until something happens that is waited for, at most so long; the nodes must be alive."""
        self._check()
        self.station.spin(timeout_s)

    def spin_until(self, done: Callable[[], bool], limit_s: float, failure: Callable[[], Exception]) -> None:
        """Serve callbacks until ``done``; raise ``failure`` after so many seconds without it."""
        deadline = time.monotonic() + limit_s
        while not done():
            self.spin(0.1)
            if time.monotonic() > deadline and not done():
                raise failure()

    def _listen(self, topic: str) -> None:
        self.station.listen(self.graph.topics[topic], lambda data: self.heard(topic, data))

    def _on_report(self, report: Report) -> None:
        self.health[report.node] = report
        self.station.wake()
        if self.reader.start_ns <= report.stamp_ns <= self.reader.end_ns + NS:
            self.writer.write_raw(report.stamp_ns, "diagnostics", DIAGNOSTICS_TYPE, report.data)
