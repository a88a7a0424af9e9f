"""The player that keeps to the log's own times, at a rate: for watching, and for latencies as on the vehicle."""

from __future__ import annotations

import time

from fbn_bringup import rundir
from fbn_bringup.player import START_S, Player
from fbn_bringup.rundir import Meter, ReplayError
from fbn_common.types import NS, nanoseconds

TICK_S = 0.005  # s of the log between two messages of the clock
LEAST_S = 1e-4  # s to serve what has come before each tick, however late the replay is
LINGER_S = 0.5  # s for the last messages to arrive


class PacedPlayer(Player):
    """Publishes each message when its log time has come; what the nodes say is written as it arrives."""

    lock_step = False

    def wait_for_nodes(self) -> None:
        """Return when every output is heard and every input has all its takers."""
        self.spin_until(lambda: not self._unmatched(), START_S, self._not_there)

    def play(self, meter: Meter, rate: float) -> None:
        """Play the whole log at this rate."""
        self._now_ns = self.reader.start_ns
        begin = time.monotonic()
        taken = set(self.inputs)
        for log_time_ns, topic, data in rundir.without_outputs(self.reader, self.graph):
            self._go_on_to(log_time_ns, begin, rate)
            self.writer.copy(log_time_ns, topic, data, self.reader)
            if topic in taken:
                self.say(topic, data)
            meter.at(log_time_ns)
        behind = max(0.0, time.monotonic() - self._due(self._now_ns, begin, rate))
        self._go_on_to(self._now_ns + nanoseconds(LINGER_S * rate), begin + behind, rate)

    def heard(self, topic: str, data: bytes) -> None:
        self.writer.write_raw(self._now_ns, topic, self.graph.topics[topic].ros_type, data)
        self.published[topic] += 1

    def _go_on_to(self, log_time_ns: int, begin: float, rate: float) -> None:
        """Let time pass, in ticks of the clock, until the log has come so far; the nodes are heard also when late."""
        while self._now_ns < log_time_ns:
            self._now_ns = min(log_time_ns, self._now_ns + nanoseconds(TICK_S))
            due = self._due(self._now_ns, begin, rate)
            self.spin(LEAST_S)
            while (left := due - time.monotonic()) > 0.0:
                self.spin(left)
            self.station.tell_time(self._now_ns)

    def _due(self, log_time_ns: int, begin: float, rate: float) -> float:
        """When a time of the log comes, on the monotonic clock [s]."""
        return begin + (log_time_ns - self.reader.start_ns) / NS / rate

    def _unmatched(self) -> list[str]:
        """Topics that somebody does not hear yet."""
        missing = [t for t in self.outputs if not self.station.sources(t)]
        for topic in self.inputs:
            takers = sum(topic in (*n.inputs, *n.feedback) for n in self.graph.nodes)
            if self.station.takers(topic) < takers:
                missing.append(topic)
        if self.station.clock_takers() < len(self.graph.nodes):
            missing.append("/clock")
        return missing

    def _not_there(self) -> ReplayError:
        return ReplayError(f"the nodes are not up after {START_S:g} s: no match on {', '.join(self._unmatched())}")
