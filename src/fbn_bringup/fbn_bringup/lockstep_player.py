"""The player that sets the pace of a lock-step replay."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial

from fbn_bringup import rundir
from fbn_bringup.offline import Step, stamped, steps
from fbn_bringup.player import START_S, Player
from fbn_bringup.rundir import Meter, ReplayError
from fbn_common.graph import Graph
from fbn_ros.bag import BagReader, BagWriter
from fbn_ros.lockstep import Due, StepGate
from fbn_ros.progress import FIRST_STEP, PLAYER, REPORT, from_bytes, progress, progress_topic, to_bytes
from fbn_ros.station import Station

WINDOW = 4  # steps that a node may be behind: enough to keep two cores busy
STEP_LIMIT_S = 30.0  # s without any step being finished


class LockStepPlayer(Player):
    """Publishes step by step, waits for the nodes, and writes everything in the order of the offline runner."""

    def __init__(
        self,
        station: Station,
        graph: Graph,
        reader: BagReader,
        writer: BagWriter,
        inputs: frozenset[str],
        check: Callable[[], None],
    ) -> None:
        self._gate = StepGate(
            [t for n in graph.nodes for t in n.outputs], (), {t: n.name for n in graph.nodes for t in n.outputs}
        )
        self._written = FIRST_STEP - 1
        self._steps: deque[Step] = deque()  # played, not yet written
        self._meter: Meter | None = None
        super().__init__(station, graph, reader, writer, inputs, check)
        self._progress = progress_topic(PLAYER)
        station.offer(self._progress)
        for node in graph.nodes:
            station.listen(progress_topic(node.name), self._on_progress)

    def wait_for_nodes(self) -> None:
        """Nothing to wait for: whoever comes later gets what was sent before, and the first steps wait for all."""

    def play(self, meter: Meter, rate: float) -> None:
        """Play the whole log; the rate is the nodes'."""
        self._meter, step = meter, FIRST_STEP - 1
        for content in steps(rundir.without_outputs(self.reader, self.graph)):
            step += 1
            self._send(step, content)
            self._wait_for(step - WINDOW)
        self._wait_for(step)
        self._ask_for_reports()

    def _ask_for_reports(self) -> None:
        """The nodes' health at the very end, for the summary."""
        self.health.clear()
        told = progress(PLAYER, REPORT, self.reader.end_ns, (), {})
        self.station.say(self._progress.name, to_bytes(told))
        names = {node.name for node in self.graph.nodes}
        self.spin_until(lambda: names <= self.health.keys(), STEP_LIMIT_S, self._silent)

    def _silent(self) -> ReplayError:
        names = [node.name for node in self.graph.nodes if node.name not in self.health]
        return ReplayError(f"{', '.join(names)}: no diagnostics within {STEP_LIMIT_S:g} s of the replay's end")

    def _send(self, step: int, content: Step) -> None:
        taken = set(self.inputs)
        for _, topic, data in content.logged:
            if topic in taken:
                self.say(topic, data)
        self.station.tell_time(content.end_ns)
        self._steps.append(content)
        told = progress(PLAYER, step, content.end_ns, self.graph.external_inputs(), self.played)
        self._gate.promise(told)
        self.station.say(self._progress.name, to_bytes(told))

    def _wait_for(self, step: int) -> None:
        while self._written < step:
            limit = STEP_LIMIT_S if self._written >= FIRST_STEP else START_S
            self.spin_until(partial(self._beyond, self._written), limit, self._stuck)

    def _beyond(self, step: int) -> bool:
        return self._written > step

    def _stuck(self) -> ReplayError:
        waiting = [
            f"{m.publisher}: {m.topic}: expected {'?' if m.expected is None else m.expected}, got {m.received}"
            for m in self._gate.missing()
        ]
        limit = STEP_LIMIT_S if self._written >= FIRST_STEP else START_S
        return ReplayError(
            f"step {self._gate.step} of the replay was not finished within {limit:g} s; messages so far:\n  "
            + "\n  ".join(waiting)
        )

    def heard(self, topic: str, data: bytes) -> None:
        self._gate.add(topic, data)
        self._write_due()

    def _on_progress(self, data: bytes) -> None:
        self._gate.promise(from_bytes(data))
        self._write_due()

    def _write_due(self) -> None:
        while (due := self._gate.due()) is not None:
            self._write(due)
            self._written = due.step
            self.station.wake()
            if self._meter is not None:
                self._meter.at(due.stamp_ns)

    def _write(self, due: Due) -> None:
        for log_time_ns, topic, data in self._steps.popleft().logged:
            self.writer.copy(log_time_ns, topic, data, self.reader)
        outputs = [(topic, data) for topic, messages in due.messages for data in messages]
        for log_time_ns, (topic, data) in stamped(due.stamp_ns, outputs):
            self.writer.write_raw(log_time_ns, topic, self.graph.topics[topic].ros_type, data)
            self.published[topic] += 1
