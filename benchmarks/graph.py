"""The five estimators on a mission in one process: times real time each, and the tracker's time per ping."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from fbn_bringup.configuration import load_parameters
from fbn_bringup.offline import Runner, steps
from fbn_bringup.simulation import estimator_parameters
from fbn_common.graph import GRAPH
from fbn_common.parameters import dotted
from fbn_common.types import Array
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import simulate


class Speed(NamedTuple):
    """One estimator on the whole log."""

    node: str
    cpu_s: float
    factor: float  # times real time


def graph_speed(seconds_of_log: float = 420.0, seed: int = 1000) -> tuple[list[Speed], Array]:
    """Speed of each estimator, and seconds (n,) of every advance in which the tracker had pings to work on."""
    simulation = simulate(load_scenario("charles_river_2006", {"mission.limit": seconds_of_log}), seed)
    chosen = dotted(estimator_parameters(simulation))
    runner = Runner.build(GRAPH, load_parameters(GRAPH, (), chosen))
    tracker = next(h for h in runner.hosts if h.node.name == "fbn_tracking")
    pings = []
    for step in steps(simulation.records()):
        before, received = tracker.cpu_ns, tracker.received["deadreck/ping_motion"]
        runner.step(*step)
        new = tracker.received["deadreck/ping_motion"] - received
        if new:
            pings += [(tracker.cpu_ns - before) / 1e9 / new] * new
    span = (simulation.entries[-1].log_time_ns - simulation.entries[0].log_time_ns) / 1e9
    return [Speed(h.node.name, h.cpu_ns / 1e9, span * 1e9 / h.cpu_ns) for h in runner.hosts], np.array(pings)


def calibration(loops: int = 300_000) -> float:
    """Seconds of a fixed pure-Python loop: how fast this machine is right now."""
    begin = time.thread_time()
    total = 0
    for i in range(loops):
        total += i & 7
    return time.thread_time() - begin
