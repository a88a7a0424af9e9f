"""One node under test, over DDS, in a context and domain of its own, with a tester node beside it."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.context import Context
from rclpy.node import Node as RosNode
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rclpy.task import Future

from fbn_common.graph import GRAPH, Graph, Node
from fbn_common.records import NodeProgress, Record
from fbn_ros.conversion import Conversion
from fbn_ros.messages import RclpyMessages
from fbn_ros.node import EstimatorNode
from fbn_ros.progress import FIRST_STEP, PLAYER, progress, progress_topic
from fbn_ros.qos import profile
from fbn_ros.spin import make_executor, spin

LIMIT_S = 10.0  # s: on a loaded machine DDS's discovery has a tail of 3 s


@contextmanager
def private_domain() -> Iterator[int]:
    """A DDS domain that no other test on this host has; the environment of child processes says it too."""
    from domain_coordinator import domain_id

    with domain_id() as domain:
        before = os.environ.get("ROS_DOMAIN_ID")
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        try:
            yield domain
        finally:
            if before is None:
                del os.environ["ROS_DOMAIN_ID"]
            else:
                os.environ["ROS_DOMAIN_ID"] = before


class NodeHarness:
    """Publishes to a node, collects what it says, and spins both until something is so; never sleeps.

    With ``lock_step`` the harness is the node's player: see :meth:`step`.  Topics ``not_mine`` are left to others.
    """

    def __init__(
        self, node: Node, domain: int, parameters: Mapping[str, Any] | None = None, *,
        graph: Graph = GRAPH, lock_step: bool = False,
        not_mine: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        self.declared, self.graph, self.lock_step = node, graph, lock_step
        self.received: dict[str, list[Record]] = defaultdict(list)
        self.messages: dict[str, list[Any]] = defaultdict(list)
        self._domain, self._not_mine = domain, not_mine
        self._parameters = dict(parameters or {}) | {"lock_step": lock_step}
        self._conversion = Conversion(RclpyMessages())
        self._publishers: dict[str, Publisher[Any]] = {}
        self._woken: Future[None] = Future()
        self._step, self._played = FIRST_STEP - 1, dict[str, int]()

    def __enter__(self) -> Self:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=self._domain)
        overrides = [Parameter(name, value=value) for name, value in self._parameters.items()]
        self.node = EstimatorNode(self.declared, self.graph, self.context, parameter_overrides=overrides)
        self.tester = RosNode("tester", context=self.context)
        self.executor = make_executor(self.context)
        for topic in (t for t in (*self.declared.inputs, *self.declared.feedback) if t not in self._not_mine):
            self._publishers[topic] = self._publisher(topic)
        for topic in self.declared.outputs:
            self._collect(topic)
        if self.lock_step:
            own, its = progress_topic(PLAYER), progress_topic(self.declared.name)
            message: Any = self._conversion.factory.message(own.ros_type)
            qos = profile(own, lock_step=True)
            self._publishers[own.name] = self.tester.create_publisher(message, own.name, qos)
            self.tester.create_subscription(message, its.name, self._on_progress, qos)
        for node in (self.node, self.tester):
            self.executor.add_node(node)
        self.spin_until(self._matched)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for node in (self.tester, self.node):
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown(context=self.context)

    def publish(self, topic: str, record: Record) -> None:
        """Publish a record on one of the node's inputs."""
        self._publishers[topic].publish(self._conversion.to_message(record))
        self._played[topic] = self._played.get(topic, 0) + 1

    def publish_raw(self, topic: str, data: bytes) -> None:
        """Publish bytes, whatever they are."""
        self._publishers[topic].publish(data)
        self._played[topic] = self._played.get(topic, 0) + 1

    def step(self, end_ns: int) -> None:
        """In lock step: everything of the next step has been published; returns when the node has taken it."""
        self._step += 1
        told = progress(PLAYER, self._step, end_ns, self._publishers, self._played)
        self._publishers[progress_topic(PLAYER).name].publish(self._conversion.to_message(told))
        self.spin_until(lambda: self._done(self._step))

    def listen(self, topic: str, message: Any) -> None:
        """Collect the ROS messages of any other topic in ``messages``."""
        self.tester.create_subscription(message, topic, lambda m: self._hear(self.messages[topic], m), 10)

    def now_ns(self) -> int:
        """The node's time."""
        return int(self.node.get_clock().now().nanoseconds)

    def spin_until(self, predicate: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
        """Serve both nodes' callbacks until it is so; AssertionError after ``limit_s``."""
        deadline = time.monotonic() + limit_s
        while not predicate():
            assert time.monotonic() < deadline, f"not so within {limit_s} s; received {self._counts()}"
            self._woken = Future()
            spin(self.executor, self._woken, 0.05)

    def _publisher(self, name: str) -> Publisher[Any]:
        topic = self.graph.topics[name]
        message: Any = self._conversion.factory.message(topic.ros_type)
        return self.tester.create_publisher(message, name, profile(topic, lock_step=self.lock_step, lease=True))

    def _collect(self, name: str) -> None:
        topic = self.graph.topics[name]
        message: Any = self._conversion.factory.message(topic.ros_type)

        def receive(data: bytes) -> None:
            record = self._conversion.to_record(name, topic.record, deserialize_message(data, message))
            self._hear(self.received[name], record)

        self.tester.create_subscription(message, name, receive, profile(topic, lock_step=self.lock_step), raw=True)

    def _hear(self, heard: list[Any], what: Any) -> None:
        heard.append(what)
        if not self._woken.done():
            self._woken.set_result(None)

    def _on_progress(self, message: Any) -> None:
        name = progress_topic(self.declared.name).name
        self._hear(self.received[name], self._conversion.to_record(name, NodeProgress, message))

    def _done(self, step: int) -> bool:
        """Whether the node has taken the step, and all that it published in it is here."""
        heard = self.received[progress_topic(self.declared.name).name]
        told = [p for p in heard if isinstance(p, NodeProgress) and p.step == step]
        return bool(told) and all(len(self.received[c.topic]) >= c.count for c in told[0].published)

    def _matched(self) -> bool:
        published = all(p.get_subscription_count() for p in self._publishers.values())
        return published and all(self.tester.count_publishers(t) for t in self.declared.outputs)

    def _counts(self) -> dict[str, int]:
        return {topic: len(records) for topic, records in self.received.items()}
