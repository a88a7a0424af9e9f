"""The ``fbn_sim`` node: a simulated mission as the vehicle's sensors would publish it."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from fbn_common.graph import GRAPH, SIMULATOR_TOPICS, Topic
from fbn_common.parameters import ParameterError, param
from fbn_ros.conversion import Conversion
from fbn_ros.messages import RclpyMessages
from fbn_ros.qos import profile
from fbn_ros.ros_parameters import read_parameters
from fbn_ros.spin import run_node
from fbn_sim.playback import Playback
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import simulate

PERIOD_S = 0.005


@dataclass(frozen=True, slots=True)
class SimulatorParameters:
    """Which mission, and how fast."""

    scenario: str = param("charles_river_2006", "-", "name of a scenario, or a file", "mission")
    seed: int = param(-1, "-", "of all randomness; -1 = the scenario's own", "mission")
    rate: float = param(1.0, "-", "times real time; other than 1 needs clock", "mission")
    clock: bool = param(False, "-", "publish /clock, with the mission's own times (nodes: use_sim_time)", "mission")
    delay: float = param(2.0, "s", "before the first record, for subscribers to be found", "discovery over DDS")

    def __post_init__(self) -> None:
        if self.rate <= 0.0 or self.delay < 0.0:
            raise ParameterError("rate must be positive, and delay not negative")
        if self.rate != 1.0 and not self.clock:
            raise ParameterError("a rate other than 1 needs clock: true, and use_sim_time: true in the other nodes")


class SimulatorNode(Node):
    """Publishes a mission's sensors and truth; without ``clock`` as if it happened now."""

    def __init__(self, **options: Any) -> None:
        given = {"allow_undeclared_parameters": True, "automatically_declare_parameters_from_overrides": True}
        super().__init__("fbn_sim", **given, **options)
        self.parameters: SimulatorParameters = read_parameters(self, SimulatorParameters)
        scenario = load_scenario(self.parameters.scenario)
        self.get_logger().info(f"simulating {scenario.name}: {scenario.about}")
        simulation = simulate(scenario, None if self.parameters.seed < 0 else self.parameters.seed)
        topics = GRAPH.topics | {t.name: t for t in SIMULATOR_TOPICS}
        self._conversion = Conversion(RclpyMessages())
        self._sensors = {name: self._publisher(topics[name]) for name in sorted({e.topic for e in simulation.entries})}
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if self.parameters.clock else None
        begin_ns = simulation.entries[0].log_time_ns - round(self.parameters.delay * self.parameters.rate * 1e9)
        shift_ns = 0 if self.parameters.clock else time.time_ns() - begin_ns
        self.playback = Playback(simulation.entries, begin_ns, shift_ns, self.parameters.rate)
        self._started_ns = time.monotonic_ns()
        self._timer = self.create_timer(PERIOD_S, self._tick, clock=RosClock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"publishing {', '.join(self._sensors)}")

    def _publisher(self, topic: Topic) -> Publisher[Any]:
        message: Any = self._conversion.factory.message(topic.ros_type)
        return self.create_publisher(message, topic.name, profile(topic))

    def _tick(self) -> None:
        elapsed_ns = time.monotonic_ns() - self._started_ns
        if self._clock_publisher is not None:
            now = Time(nanoseconds=self.playback.time_ns(elapsed_ns))
            self._clock_publisher.publish(Clock(clock=now.to_msg()))
        for _, topic, record in self.playback.due(elapsed_ns):
            self._sensors[topic].publish(self._conversion.to_message(record))
        if self.playback.over:
            self._timer.cancel()
            self.get_logger().info("the mission is over")


def main() -> int:
    """Run the node until it is told to stop; the exit status."""
    return run_node(SimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
