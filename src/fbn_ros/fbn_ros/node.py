"""The node of every estimator: topics in, estimator, topics out.

Live, messages are put in as they come and a timer advances the estimator to the clock's time.  With the parameter
``lock_step`` there is no timer: a replay's player sets the pace (see :mod:`fbn_ros.lockstep`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node as RosNode
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from fbn_common.estimator import Health, Level
from fbn_common.graph import GRAPH, Graph, Node, Topic
from fbn_common.parameters import flatten
from fbn_common.records import Record
from fbn_ros import extras
from fbn_ros.cdr import Cdr
from fbn_ros.conversion import ConversionError
from fbn_ros.diagnostics import diagnostic_array
from fbn_ros.host import Host, resolve
from fbn_ros.lockstep import Due, StepGate
from fbn_ros.messages import RclpySerialiser
from fbn_ros.progress import REPORT, from_bytes, progress, progress_topic, to_bytes
from fbn_ros.qos import profile
from fbn_ros.ros_parameters import read_parameters
from fbn_ros.spin import run_node
from fbn_ros.statistics import Statistics

SILENT_S = 3.0  # s without a message on a topic after which diagnostics say so
DIAGNOSTIC_STEPS = 10  # in lock step, a report every two seconds of the log


class EstimatorNode(RosNode):
    """One node of the graph around its estimator."""

    def __init__(self, node: Node, graph: Graph = GRAPH, context: Context | None = None, **options: Any) -> None:
        given = {"allow_undeclared_parameters": True, "automatically_declare_parameters_from_overrides": True}
        super().__init__(node.name, context=context, **given, **options)
        self.lock_step = bool(self.get_parameter_or("lock_step", Parameter("lock_step", value=False)).value)
        self.parameters = read_parameters(self, resolve(node.parameters))
        self.host = Host.build(node, self.parameters)
        self.graph, self.declared = graph, node
        self.statistics = Statistics()
        self._cdr = Cdr(RclpySerialiser())
        self._factory = self._cdr.serialiser.factory
        self._gone: set[str] = set()
        self._level = Level.OK
        self._publish: dict[str, Callable[[Record], None]] = {t: self._publisher(t) for t in node.outputs}
        self._diagnostics = self.create_publisher(resolve("diagnostic_msgs.msg:DiagnosticArray"), "/diagnostics", 10)
        self._extras = extras.for_node(self, node.outputs)
        self._gate = StepGate(node.inputs, node.feedback, {t: n.name for n in graph.nodes for t in n.outputs})
        self._subscriptions_by_topic = {t: self._subscribe(t) for t in (*node.inputs, *node.feedback)}
        if self.lock_step:
            self._join_replay()
        else:
            self._due = 0.0
            self.create_timer(node.period_s, self._tick)
            self.create_timer(1.0, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._announce()

    # --- messages --------------------------------------------------------------------------------------------

    def _publisher(self, topic: str) -> Callable[[Record], None]:
        publisher, outgoing = self._create_publisher(self.graph.topics[topic]), self._cdr.outgoing
        return lambda record: publisher.publish(outgoing(record))

    def _create_publisher(self, topic: Topic) -> Publisher[Any]:
        message: Any = self._factory.message(topic.ros_type)
        return self.create_publisher(message, topic.name, profile(topic, lock_step=self.lock_step, lease=True))

    def _subscribe(self, name: str) -> Subscription[Any]:
        """Raw, so that bytes that are no message of the topic's type are answered like any other malformed datum."""
        topic = self.graph.topics[name]
        message: Any = self._factory.message(topic.ros_type)
        ours = self.graph.publisher(name) is not None
        qos: QoSProfile = profile(topic, lock_step=self.lock_step, lease=ours)
        events = SubscriptionEventCallbacks(
            liveliness=lambda info: self._presence(name, info.alive_count, info.alive_count_change),
            matched=lambda info: self._presence(name, info.current_count, info.current_count_change),
        )
        take = self._gate.add if self.lock_step else self._take_in

        def receive(data: bytes) -> None:
            take(name, self._to_record(topic, data))
            if self.lock_step:
                self._advance_steps()

        return self.create_subscription(message, name, receive, qos, raw=True, event_callbacks=events if ours else None)

    def _to_record(self, topic: Topic, data: bytes) -> Record | ConversionError:
        try:
            return self._cdr.decode(topic.name, topic.record, data)
        except ConversionError as error:
            return error

    def _take_in(self, topic: str, entry: Record | ConversionError) -> None:
        now_ns = self.get_clock().now().nanoseconds
        if isinstance(entry, ConversionError):
            self.get_logger().warning(f"refused: {entry}", throttle_duration_sec=5.0)
            entry.stamp_ns = entry.stamp_ns or now_ns
        else:
            self.statistics.message(topic, entry.stamp_ns, now_ns)
            self._extras(topic, entry)
        self.host.put(topic, entry)

    # --- work ------------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        now, now_ns = time.monotonic(), self.get_clock().now().nanoseconds
        if self._due:
            self.statistics.tick(now - self._due, self.declared.period_s)
        self._due = now + self.declared.period_s
        if now_ns > 0:  # simulated time stands at 0 until its first message
            self._advance(now_ns)

    def _advance(self, now_ns: int) -> None:
        begin = time.perf_counter()
        outputs = self.host.advance(now_ns)
        self.statistics.advance.add(time.perf_counter() - begin)
        for topic, record in outputs:
            self._publish[topic](record)
            self._extras(topic, record)

    def _join_replay(self) -> None:
        own = progress_topic(self.declared.name)
        self._progress, qos = self._create_publisher(own), profile(own, lock_step=True)
        message: Any = self._factory.message(own.ros_type)
        for name in self._gate.heeded:
            self.create_subscription(message, progress_topic(name).name, self._on_progress, qos, raw=True)

    def _on_progress(self, data: bytes) -> None:
        told = from_bytes(data)
        if told.step == REPORT:
            self._report(told.stamp_ns)
        else:
            self._gate.promise(told)
            self._advance_steps()

    def _advance_steps(self) -> None:
        while (due := self._gate.due()) is not None:
            self._take_step(due)

    def _take_step(self, due: Due) -> None:
        for topic, entries in due.messages:
            for entry in entries:
                if not isinstance(entry, ConversionError):
                    self.statistics.message(topic, entry.stamp_ns, due.stamp_ns)
                self.host.put(topic, entry)
        self._advance(due.stamp_ns)
        told = progress(self.declared.name, due.step, due.stamp_ns, self.declared.outputs, self.host.published)
        self._progress.publish(to_bytes(told))
        if due.step % DIAGNOSTIC_STEPS == 0:
            self._report(due.stamp_ns)

    # --- what it says of itself ------------------------------------------------------------------------------

    def _announce(self) -> None:
        node, log = self.declared, self.get_logger()
        log.info("parameters: " + ", ".join(f"{k}={v}" for k, v in flatten(self.parameters).items()))
        takes = ", ".join((*node.inputs, *node.feedback))
        pace = "in lock step with a replay" if self.lock_step else f"every {1e3 * node.period_s:.0f} ms"
        log.info(f"ready: takes {takes}; gives {', '.join(node.outputs)}; advances {pace}")

    def _presence(self, topic: str, count: int, change: int) -> None:
        """A publisher of another node has come, or left in order, or given no sign of life for too long."""
        publisher = self.graph.publisher(topic)
        name = publisher.name if publisher else topic
        if count == 0 and change < 0:
            self._gone.add(topic)
            self.get_logger().warning(f"{name} is gone: nothing on {topic}")
        elif count and topic in self._gone:
            self._gone.discard(topic)
            self.get_logger().info(f"{name} is back on {topic}")

    def _tell(self, health: Health) -> None:
        """The logger allows each line of code one severity."""
        if health.level is Level.OK:
            self.get_logger().info(f"health: OK: {health.message}")
        else:
            self.get_logger().warning(f"health: {health.level.name}: {health.message}")

    def _report(self, now_ns: int = 0) -> None:
        now_ns = now_ns or self.get_clock().now().nanoseconds
        values = self.statistics.report()
        silent = [] if self.lock_step else self.statistics.silent(self.declared.inputs, now_ns, SILENT_S)
        health = self.host.health()
        if health.level is not self._level:
            self._level = health.level
            self._tell(health)
        self._diagnostics.publish(
            diagnostic_array(self._factory, now_ns, self.declared, health, values, silent, sorted(self._gone))
        )


def main_of(name: str, graph: Graph = GRAPH) -> int:
    """Run the node of this name; the exit status."""
    return run_node(lambda: EstimatorNode(graph.node(name), graph))
