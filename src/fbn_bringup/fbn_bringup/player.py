"""What both players have in common: the log's messages out, the nodes' messages in, and into the run's bag."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rosgraph_msgs.msg import Clock

from fbn_bringup.rundir import Meter
from fbn_common.estimator import Level
from fbn_common.graph import Graph, Topic
from fbn_ros.bag import KNOWN_TOPICS, BagReader, BagWriter
from fbn_ros.conversion import Conversion
from fbn_ros.messages import RclpyMessages
from fbn_ros.qos import profile
from fbn_ros.spin import make_executor, spin

START_S = 120.0  # s for the nodes to come up; a first start compiles their kernels


class Player:
    """A ROS node that plays a log's messages and hears everything that the graph's nodes say."""

    lock_step = True

    def __init__(
        self, graph: Graph, reader: BagReader, writer: BagWriter, inputs: frozenset[str], check: Callable[[], None]
    ) -> None:
        self.graph, self.reader, self.writer, self.inputs = graph, reader, writer, sorted(inputs)
        self.published: Counter[str] = Counter()  # by the nodes
        self.played: Counter[str] = Counter()
        self.health: dict[str, tuple[str, str, dict[str, str]]] = {}
        self.outputs = [t for node in graph.nodes for t in node.outputs]
        self._check = check
        self._woken: Future[None] = Future()
        self.conversion = Conversion(RclpyMessages())

    def __enter__(self) -> Self:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node("player", context=self.context, start_parameter_services=False)
        self.executor = make_executor(self.context)
        self.executor.add_node(self.node)
        self.publishers: dict[str, Publisher[Any]] = {t: self._publisher(KNOWN_TOPICS[t]) for t in self.inputs}
        self.clock = self.node.create_publisher(Clock, "/clock", 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100, raw=True)
        for topic in self.outputs:
            self._listen(self.graph.topics[topic])
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown(context=self.context)

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
        self.publishers[topic].publish(data)
        self.played[topic] += 1

    def tell_time(self, now_ns: int) -> None:
        """Publish the clock."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, 1_000_000_000)
        self.clock.publish(message)

    def spin(self, timeout_s: float) -> None:
        """Serve callbacks until something happens that somebody waits for, at most so long."""
        self._check()
        if self._woken.done():
            self._woken = Future()
        spin(self.executor, self._woken, timeout_s)

    def spin_until(self, done: Callable[[], bool], limit_s: float, failure: Callable[[], Exception]) -> None:
        """Serve callbacks until ``done``; raise ``failure`` after so many seconds without it."""
        deadline = time.monotonic() + limit_s
        while not done():
            self.spin(0.1)
            if time.monotonic() > deadline and not done():
                raise failure()

    def wake(self) -> None:
        """Let :meth:`spin` return."""
        if not self._woken.done():
            self._woken.set_result(None)

    def _publisher(self, topic: Topic) -> Publisher[Any]:
        message: Any = self.conversion.factory.message(topic.ros_type)
        return self.node.create_publisher(message, topic.name, profile(topic, lock_step=self.lock_step, lease=True))

    def _listen(self, topic: Topic) -> None:
        message: Any = self.conversion.factory.message(topic.ros_type)
        qos = profile(topic, lock_step=self.lock_step)
        self.node.create_subscription(message, topic.name, lambda data: self.heard(topic.name, data), qos, raw=True)

    def _on_diagnostics(self, data: bytes) -> None:
        array = deserialize_message(data, DiagnosticArray)
        stamp_ns = array.header.stamp.sec * 1_000_000_000 + array.header.stamp.nanosec
        for status in array.status:
            level = Level(int.from_bytes(status.level)).name
            self.health[status.hardware_id] = (level, status.message, {v.key: v.value for v in status.values})
        self.wake()
        if self.reader.start_ns <= stamp_ns <= self.reader.end_ns + 1_000_000_000:
            self.writer.write_raw(stamp_ns, "diagnostics", "diagnostic_msgs/msg/DiagnosticArray", data)
