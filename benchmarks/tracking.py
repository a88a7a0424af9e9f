"""How well the tracker finds what is there: features, their errors and NEES, drift, time; over seeds of a scenario.

tools/run python benchmarks/tracking.py charles_river_2006 --seeds 5
tools/run python benchmarks/tracking.py depth_of_features --seeds 5 --elevation linear

A feature within 2 m and four sigmas of a true one is that one; any other is counted apart: patches of the bed that echo
steadily are static things too.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from fbn_bringup.configuration import load_parameters
from fbn_bringup.offline import Runner, steps
from fbn_bringup.simulation import estimator_parameters
from fbn_common.graph import GRAPH
from fbn_common.lie import matrix_from_quaternion
from fbn_common.parameters import dotted
from fbn_common.records import CompositeMeasurement
from fbn_common.sonar import polar
from fbn_common.types import Array
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import Simulation, simulate

NODES = ("predict", "deadreck", "reference", "tracking")


@dataclass
class Tally:
    """Sums over all seeds; NEES by what it is of."""

    due: int = 0  # (dive, feature) pairs in view for ten pings or more
    promoted: int = 0  # of those
    others: set[tuple[int, int]] = field(default_factory=set)
    horizontal: list[float] = field(default_factory=list)
    depth: list[float] = field(default_factory=list)
    motion: list[float] = field(default_factory=list)
    depth_error: list[float] = field(default_factory=list)
    wrong_side: list[bool] = field(default_factory=list)
    motion_error: list[float] = field(default_factory=list)
    dead_reckoning_error: list[float] = field(default_factory=list)
    ping_s: list[float] = field(default_factory=list)
    hours: float = 0.0


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--seeds", type=int, default=3, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--elevation", choices=("cubic", "linear"), default="cubic")
    given = parser.parse_args()
    tally = Tally()
    for seed in range(given.first, given.first + given.seeds):
        study(given.scenario, seed, given.elevation, tally)
    show(tally)


def study(scenario: str, seed: int, elevation: str, tally: Tally) -> None:
    """One seed: sensors to composites in this process, judged by the truth."""
    simulation = simulate(load_scenario(scenario), seed)
    graph = GRAPH.only(NODES)
    wanted = {**dotted(estimator_parameters(simulation)), "tracking.feature.elevation": elevation}
    known = {name: value for name, value in wanted.items() if name.split(".")[0].removeprefix("fbn_") in NODES}
    runner = Runner.build(graph, load_parameters(graph, (), known))
    timed(runner.hosts[-1].estimator, tally)
    composites = []
    for step in steps(simulation.records()):
        composites += [r for _, r in runner.step(*step) if isinstance(r, CompositeMeasurement)]
    judge(composites, simulation, seed, tally)


def timed(tracker: object, tally: Tally) -> None:
    """Let the tracker's ``advance`` note its thread time where it processed a ping."""
    advance = tracker.advance  # type: ignore[attr-defined]

    def measured(now_ns: int) -> object:
        began = time.thread_time()
        outputs = advance(now_ns)
        if outputs:
            tally.ping_s.append(time.thread_time() - began)
        return outputs

    tracker.advance = measured  # type: ignore[attr-defined]


def judge(composites: list[CompositeMeasurement], simulation: Simulation, seed: int, tally: Tally) -> None:
    """Compare composites with the truth."""
    found: set[tuple[int, int]] = set()
    for c in composites:
        base, end = (simulation.truth.at(stamp).position[0] for stamp in (c.start_ns, c.stamp_ns))
        if c.features:
            motion = c.mean[4:6] - (end - base)[:2]
            tally.motion.append(nees(motion, c.covariance[4:6, 4:6]))
            tally.motion_error.append(float(np.hypot(*motion)))
            alone = c.p2_odom.position - c.base_odom.position - (end - base)
            tally.dead_reckoning_error.append(float(np.hypot(*alone[:2])))
        for number in range(len(c.features)):
            target = feature(c, number, base, simulation, seed, tally)
            found |= {(dive_at(simulation, c.stamp_ns), target)} if target is not None else set()
    due = in_view(simulation)
    tally.due += len(due)
    tally.promoted += len(due & found)
    tally.hours += (simulation.entries[-1][0] - simulation.entries[0][0]) / 3.6e12


def feature(
    c: CompositeMeasurement, number: int, base: Array, simulation: Simulation, seed: int, tally: Tally
) -> int | None:
    """Judge one feature; gives the true one that it is."""
    at = slice(10 + 3 * number, 13 + 3 * number)
    xyz, P = c.mean[at] + np.array([*base[:2], 0.0]), c.covariance[at, at]
    errors = xyz - simulation.truth.features.positions
    target = int(np.argmin(np.hypot(*errors.T[:2])))
    error = errors[target]
    if np.hypot(*error[:2]) > 2.0 + 4.0 * np.sqrt(np.linalg.eigvalsh(P[:2, :2])[1]):
        tally.others.add((seed, c.features[number].key))
        return None
    tally.horizontal.append(nees(error[:2], P[:2, :2]))
    tally.depth.append(float(error[2] ** 2 / P[2, 2]))
    tally.depth_error.append(abs(float(error[2])))
    true_z = simulation.truth.features.positions[target][2]
    tally.wrong_side.append(bool((xyz[2] - c.mean[6]) * (true_z - c.mean[6]) < 0.0))
    return target


def nees(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared."""
    return float(error @ np.linalg.solve(covariance, error))


def dive_at(simulation: Simulation, stamp_ns: int) -> int:
    """Number of the dive in which, or after which, this is."""
    return sum(dive.start_ns <= stamp_ns for dive in simulation.dives)


def in_view(simulation: Simulation) -> set[tuple[int, int]]:
    """(dive, feature) pairs with ten looks or more from under water."""
    looks: dict[tuple[int, int], set[int]] = {}
    arrays = simulation.scenario.sensors.sonar.arrays
    for _, topic, record in simulation.records():
        dive = dive_at(simulation, record.stamp_ns)
        if topic != "sonar/detections" or not dive or record.stamp_ns > simulation.dives[dive - 1].end_ns:
            continue
        motion, array = simulation.truth.at(record.stamp_ns), arrays[record.frame_id]
        R = matrix_from_quaternion(motion.orientation[0])
        places = (simulation.truth.features.positions - motion.position[0] - R @ array.position_base) @ R
        for target, place in enumerate(places @ array.rotation_base_array):
            r, phi, theta = polar(place)
            inside = array.range_min < r < array.range_max and array.bearing_min < phi < array.bearing_max
            if inside and abs(theta) < 0.5 * array.lobe_width:
                looks.setdefault((dive, target), set()).add(record.ping)
    return {pair for pair, pings in looks.items() if len(pings) >= 10}


def show(tally: Tally) -> None:
    """Print the figures."""
    print(f"features in view for 10 pings: {tally.due}, promoted: {tally.promoted}")
    print(f"other static things: {len(tally.others)} in {tally.hours:.2f} h")
    for name, values, dof in (
        ("horizontal", tally.horizontal, 2), ("depth", tally.depth, 1), ("motion", tally.motion, 2)
    ):  # fmt: skip
        low, high = chi2.ppf([0.025, 0.975], dof * len(values)) / (dof * len(values))
        print(
            f"NEES / dof of {name}: {np.mean(values) / dof:.2f} (95 %: {low:.2f} to {high:.2f}), {len(values)} values"
        )
    print(f"depth: median error {np.median(tally.depth_error):.2f} m; wrong side {np.mean(tally.wrong_side):.3f}")
    print(
        f"motion a composite: median error {np.median(tally.motion_error):.2f} m, "
        f"dead reckoning alone {np.median(tally.dead_reckoning_error):.2f} m"
    )
    median, high, most = 1e3 * np.percentile(tally.ping_s, [50, 95, 100])
    print(f"time per ping: median {median:.1f} ms, 95 % {high:.1f} ms, most {most:.0f} ms")


if __name__ == "__main__":
    main()
