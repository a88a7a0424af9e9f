"""What the tracker is given on a simulated mission, made once, and what it makes of that with any parameters."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from fbn_bringup.configuration import load_parameters
from fbn_bringup.offline import Runner, Step, steps
from fbn_bringup.simulation import estimator_parameters
from fbn_common.graph import GRAPH
from fbn_common.parameters import dotted
from fbn_common.records import CompositeMeasurement, PingMotion, Record, TrackedFeatures
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import Simulation, simulate
from fbn_tracking.estimator import Tracking

FRONT = ("predict", "deadreck", "reference")
NODES = (*FRONT, "tracking")


class Heard(NamedTuple):
    """A mission as the tracker hears it: steps of log time with what came in each, and how it really was."""

    simulation: Simulation
    steps: list[Step]


@dataclass
class Outcome:
    """What the tracker made of a mission."""

    heard: Heard
    composites: list[CompositeMeasurement] = field(default_factory=list)
    features: list[TrackedFeatures] = field(default_factory=list)
    ping_s: list[float] = field(default_factory=list)  # CPU time of every advance that processed a ping
    counts: dict[str, Any] = field(default_factory=dict)


def hear(scenario: str, seed: int, changes: Mapping[str, Any] | None = None) -> Heard:
    """Simulate, with dotted names of the scenario changed, and run the filters before the tracker."""
    simulation = simulate(load_scenario(scenario, changes), seed)
    runner = Runner.build(GRAPH.only(FRONT), load_parameters(GRAPH.only(FRONT), (), {}))
    heard = []
    for step in steps(simulation.records()):
        scans = [entry for entry in step.logged if entry[1] == "sonar/detections"]
        motions = [(step.end_ns, t, r) for t, r in runner.step(*step) if isinstance(r, PingMotion)]
        heard.append(Step(step.end_ns, [*scans, *motions]))
    return Heard(simulation, heard)


def track(heard: Heard, settings: Mapping[str, Any] | None = None) -> Outcome:
    """The tracker on a mission, with some of its parameters set by dotted name (``feature.elevation``)."""
    tracker, outcome = tracker_of(heard, settings), Outcome(heard)
    for step in heard.steps:
        for _, topic, record in step.logged:
            tracker.put(topic, record)
        began = time.thread_time()
        records = [output.record for output in tracker.advance(step.end_ns)]
        if any(isinstance(r, TrackedFeatures) for r in records):
            outcome.ping_s.append(time.thread_time() - began)
        keep(outcome, records)
    outcome.counts = dict(tracker.health().values)
    return outcome


def tracker_of(heard: Heard, settings: Mapping[str, Any] | None = None) -> Tracking:
    """A tracker with the parameters of the mission's vehicle and sonar, some of them set by dotted name."""
    graph = GRAPH.only(("tracking",))
    chosen = {name: value for name, value in dotted(estimator_parameters(heard.simulation)).items() if _ours(name)}
    chosen |= {f"tracking.{name}": value for name, value in (settings or {}).items()}
    (parameters,) = load_parameters(graph, (), chosen).values()
    return Tracking(parameters)


def _ours(name: str) -> bool:
    return name.split(".")[0].removeprefix("fbn_") == "tracking"


def keep(outcome: Outcome, records: Iterable[Record]) -> None:
    """Note the composites and the features shown."""
    for record in records:
        if isinstance(record, CompositeMeasurement):
            outcome.composites.append(record)
        elif isinstance(record, TrackedFeatures):
            outcome.features.append(record)
