"""A ROS node for those who are no node of the graph: publishes and hears serialised messages, and spins when told."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future
from rosgraph_msgs.msg import Clock

from fbn_common.estimator import Level
from fbn_common.graph import Topic
from fbn_common.records import Record
from fbn_common.types import NS
from fbn_ros.cdr import Cdr
from fbn_ros.messages import RclpySerialiser
from fbn_ros.qos import profile
from fbn_ros.spin import make_executor, spin

DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


class Report(NamedTuple):
    """A node's diagnostics."""

    stamp_ns: int
    node: str
    level: str
    message: str
    values: dict[str, str]
    data: bytes  # the whole message


class Station:
    """Make it with :func:`station`."""

    def __init__(self, node: Node, *, lock_step: bool) -> None:
        self.cdr = Cdr(RclpySerialiser())
        self._node, self._lock_step = node, lock_step
        self._executor = make_executor(node.context)
        self._executor.add_node(node)
        self._publishers: dict[str, Publisher[Any]] = {}
        self._subscriptions: dict[str, Subscription[Any]] = {}
        self._clock = node.create_publisher(Clock, "/clock", 10)
        self._woken: Future[None] = Future()

    def offer(self, topic: Topic) -> None:
        """Be a publisher of a topic."""
        qos = profile(topic, lock_step=self._lock_step, lease=True)
        self._publishers[topic.name] = self._node.create_publisher(self._message(topic), topic.name, qos)

    def listen(self, topic: Topic, heard: Callable[[bytes], None]) -> None:
        """Have a function called with the bytes of every message of a topic."""
        qos = profile(topic, lock_step=self._lock_step)
        made = self._node.create_subscription(self._message(topic), topic.name, heard, qos, raw=True)
        self._subscriptions[topic.name] = made

    def listen_to_diagnostics(self, heard: Callable[[Report], None]) -> None:
        """Have a function called with every report of a node."""

        def receive(data: bytes) -> None:
            for report in _reports(data):
                heard(report)

        self._node.create_subscription(DiagnosticArray, "/diagnostics", receive, 100, raw=True)

    def say(self, topic: str, what: bytes | Record) -> None:
        """Publish on a topic that was offered."""
        self._publishers[topic].publish(what if isinstance(what, bytes) else self.cdr.outgoing(what))

    def tell_time(self, now_ns: int) -> None:
        """Publish the clock."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, NS)
        self._clock.publish(message)

    def takers(self, topic: str) -> int:
        """How many subscribers get what is said on a topic that was offered."""
        return int(self._publishers[topic].get_subscription_count())

    def clock_takers(self) -> int:
        """How many nodes follow the clock."""
        return int(self._clock.get_subscription_count())

    def sources(self, topic: str) -> int:
        """How many publishers of a topic are heard."""
        return int(self._subscriptions[topic].get_publisher_count())

    def spin(self, timeout_s: float) -> None:
        """Serve callbacks until :meth:`wake`, at most so long."""
        if self._woken.done():
            self._woken = Future()
        spin(self._executor, self._woken, timeout_s)

    def wake(self) -> None:
        """Let :meth:`spin` return."""
        if not self._woken.done():
            self._woken.set_result(None)

    def close(self) -> None:
        """End the node."""
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()

    def _message(self, topic: Topic) -> Any:
        return self.cdr.serialiser.factory.message(topic.ros_type)


@contextmanager
def station(name: str, *, lock_step: bool = False) -> Iterator[Station]:
    """A station in a context of its own, on the domain of the environment (``ROS_DOMAIN_ID``)."""
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ.get("ROS_DOMAIN_ID", "0")))
    made = Station(Node(name, context=context, start_parameter_services=False), lock_step=lock_step)
    try:
        yield made
    finally:
        made.close()
        rclpy.try_shutdown(context=context)


def _reports(data: bytes) -> Iterator[Report]:
    array = deserialize_message(data, DiagnosticArray)
    stamp_ns = array.header.stamp.sec * NS + array.header.stamp.nanosec
    for status in array.status:
        level, values = Level(int.from_bytes(status.level)).name, {v.key: v.value for v in status.values}
        yield Report(stamp_ns, status.hardware_id, level, status.message, values, data)
