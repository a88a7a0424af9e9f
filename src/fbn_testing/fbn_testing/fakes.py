"""Small estimators that stand in for the five: real time keeping and counting, no navigation.

They show every property that the runners rely on: outputs that depend on all inputs and on the step in which those
came, feedback, order by stamp, and arithmetic in which a lost, doubled or swapped message shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common import records as r
from fbn_common.estimator import Health, Level, Output
from fbn_common.graph import GRAPH, Graph, Node
from fbn_common.parameters import ParameterError, param
from fbn_common.types import nanoseconds

IDENTITY = r.Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


@dataclass(frozen=True, slots=True)
class FakeParameters:
    """What a fake can be told."""

    gain: float = param(0.3, "-", "share of each new number in the digest", "arbitrary")
    names: list[str] = param(["a", "b"], "-", "a list, to see it through", "arbitrary")

    def __post_init__(self) -> None:
        if not 0.0 < self.gain < 1.0:
            raise ParameterError("gain must lie between 0 and 1")


class Digest:
    """Keeps one number that depends on every record taken in and on their order by stamp."""

    inputs: tuple[str, ...] = ()

    def __init__(self, parameters: FakeParameters) -> None:
        self.parameters = parameters
        self.value = 0.0
        self.taken = 0
        self.now_ns = 0
        self._waiting: list[tuple[int, int, float, r.Record]] = []

    def put(self, topic: str, record: r.Record) -> None:
        self._waiting.append((record.stamp_ns, self.inputs.index(topic), number(record), record))

    def advance(self, now_ns: int) -> list[Output]:
        due = sorted((w for w in self._waiting if w[0] <= now_ns), key=lambda w: w[:3])
        self._waiting = [w for w in self._waiting if w[0] > now_ns]
        for stamp_ns, place, what, _ in due:
            self.value += self.parameters.gain * (np.sin(what + place + stamp_ns * 1e-9) - self.value)
        self.taken += len(due)
        outputs = self.publish(now_ns, [record for *_, record in due])
        self.now_ns = now_ns
        return outputs

    def publish(self, now_ns: int, due: list[r.Record]) -> list[Output]:
        raise NotImplementedError

    def health(self) -> Health:
        return Health(Level.OK, "digesting", {"taken": self.taken, "digest": self.value})


def number(record: r.Record) -> float:
    """One number out of a record, whatever it is."""
    match record:
        case r.PredictedMotion():
            return float(record.increment[0])
        case r.Odometry():
            return float(record.pose.position[0])
        case r.CompositeMeasurement():
            return float(record.mean.sum() + record.swept.scans.sum())
        case r.SonarDetections():
            return record.ping + sum(d.range for d in record.detections)
        case r.JointState():
            return float(record.velocity.sum())
        case r.FluidPressure():
            return record.fluid_pressure * 1e-5
        case _:
            return 0.5


class FakePredict(Digest):
    """Motion at 100 Hz."""

    inputs = GRAPH.node("predict").inputs + GRAPH.node("predict").feedback

    def publish(self, now_ns: int, due: list[r.Record]) -> list[Output]:
        tick = nanoseconds(0.01)
        ends = range((self.now_ns // tick + 1) * tick if self.now_ns else now_ns, now_ns + 1, tick)
        return [Output("predict/motion", self._motion(end, tick)) for end in ends]

    def _motion(self, end_ns: int, tick: int) -> r.PredictedMotion:
        increment = np.array([self.value + end_ns % 7, 0.0, 0.0])
        return r.PredictedMotion(
            end_ns,
            end_ns - tick,
            increment=increment,
            rotation=np.zeros(3),
            velocity_start=np.zeros(6),
            velocity_end=np.zeros(6),
            parameters=np.zeros(15),
            jacobian_velocity=np.zeros((12, 6)),
            jacobian_attitude=np.zeros((12, 3)),
            jacobian_parameters=np.zeros((12, 15)),
            noise=np.zeros((12, 12)),
            attitude_start=IDENTITY.orientation,
        )


class FakeDeadreck(Digest):
    """Odometry each advance, dead service each ping."""

    inputs = GRAPH.node("deadreck").inputs

    def publish(self, now_ns: int, due: list[r.Record]) -> list[Output]:
        pose = r.Pose(np.array([self.value, 0.0, 0.0]), IDENTITY.orientation)
        odometry = r.Odometry(now_ns, "odom", "base_link", pose, np.zeros(6), np.eye(6), np.eye(6))
        pings = (record for record in due if isinstance(record, r.SonarDetections))
        return [Output("deadreck/odometry", odometry), *(Output("deadreck/ping_motion", self._ping(p)) for p in pings)]

    def _ping(self, ping: r.SonarDetections) -> r.PingMotion:
        pose = r.Pose(np.array([self.value, 0.0, 0.0]), IDENTITY.orientation)
        return r.PingMotion(
            ping.stamp_ns, "odom", ping.stamp_ns, IDENTITY, pose, 0.0, -1.0, 100.0,
            np.zeros((6, 6)), np.zeros(4), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros(6), np.zeros((3, 3)),
        )  # fmt: skip


class FakeReference(Digest):
    """Parameters to predict, and fixes."""

    inputs = GRAPH.node("reference").inputs

    def publish(self, now_ns: int, due: list[r.Record]) -> list[Output]:
        parameters = r.VehicleParameters(now_ns, "", np.full(15, self.value), np.eye(15))
        fix = r.ReferenceFix(now_ns, "map", np.full(2, self.value), np.eye(2), np.eye(2))
        return [Output("reference/parameters", parameters), Output("reference/fix", fix)]


class FakeTracking(Digest):
    """A composite every advance, with numbers that single precision cannot hold."""

    inputs = GRAPH.node("tracking").inputs

    def publish(self, now_ns: int, due: list[r.Record]) -> list[Output]:
        swept = r.SweptArea(1.0, 2, 1, np.zeros(2), np.array([self.value, 1.0 / 3.0]))
        feature = r.CompositeFeature(3, 2, 1.5, now_ns, now_ns)
        mean, covariance = np.full(16, self.value), np.eye(16)
        prior = (np.zeros(7), np.eye(7))
        composite = r.CompositeMeasurement(
            now_ns, "odom", self.taken, now_ns, True, 3, 1.0, 100.0, (feature,), swept, mean, covariance, *prior
        )
        return [Output("tracking/composite", composite)]


class FakeGlobal(Digest):
    """A pose each advance."""

    inputs = GRAPH.node("global").inputs

    def publish(self, now_ns: int, due: list[r.Record]) -> list[Output]:
        pose = r.Pose(np.array([self.value, self.taken, 0.0]), IDENTITY.orientation)
        return [Output("global/pose", r.PoseWithCovarianceStamped(now_ns, "map", pose, np.eye(6)))]


def _fake(node: Node) -> Node:
    estimator = f"fbn_testing.fakes:Fake{node.name.removeprefix('fbn_').title()}"
    return Node(
        node.name, "fbn_testing", estimator, "fbn_testing.fakes:FakeParameters",
        node.inputs, node.outputs, node.period_s, node.about, node.feedback,
    )  # fmt: skip


FAKE_GRAPH = Graph(GRAPH.topics, tuple(_fake(node) for node in GRAPH.nodes))
