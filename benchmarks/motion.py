"""The front half on a simulated mission: how many times faster than real time, history for late data included."""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

from fbn_common.estimator import Estimator, Health, Output
from fbn_common.motion_ekf.lockstep import play
from fbn_common.records import Innovation, Record
from fbn_testing.motion_voyage import front_half, in_map, transit

MINUTES = 25.0


class Load(NamedTuple):
    """One node's work on the mission."""

    node: str
    cpu_s: float
    factor: float  # times real time


class Timed:
    """An estimator whose CPU time is counted."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator, self.cpu_s = estimator, 0.0

    def put(self, topic: str, record: Record) -> None:
        """As the estimator's; it only keeps the record."""
        self.estimator.put(topic, record)

    def advance(self, now_ns: int) -> list[Output]:
        """As the estimator's."""
        begin = time.thread_time()
        made = self.estimator.advance(now_ns)
        self.cpu_s += time.thread_time() - begin
        return made

    def health(self) -> Health:
        """The estimator's."""
        return self.estimator.health()


def front_half_speed(minutes: float = MINUTES, seed: int = 1000) -> tuple[list[Load], int]:
    """Work of predict, dead reckoning and reference, and how many measurements the two filters answered."""
    simulation = transit(0.1, seed, {"mission.limit": 60.0 * minutes})
    nodes = {name: Timed(e) for name, e in front_half(in_map(simulation.scenario.world.datum)).items()}
    answers = 0
    for made in play(nodes, simulation.records()):
        answers += sum(isinstance(record, Innovation) for _, record in made)
    span = 60.0 * minutes
    return [Load(name, timed.cpu_s, span / timed.cpu_s) for name, timed in nodes.items()], answers


def main() -> int:
    """Print the factor of each node."""
    loads, answers = front_half_speed()
    for load in loads:
        print(f"{load.node:14s} {load.cpu_s:6.2f} s  {load.factor:6.0f} x real time")
    total = sum(load.cpu_s for load in loads)
    print(f"{'all three':14s} {total:6.2f} s  {60.0 * MINUTES / total:6.0f} x real time, {answers} answers")
    return 0


if __name__ == "__main__":
    sys.exit(main())
