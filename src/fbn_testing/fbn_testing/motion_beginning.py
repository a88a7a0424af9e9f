"""Whether dead reckoning is as good as it says at the surface and under water, over a mission's first minutes.

python -m fbn_testing.motion_beginning charles_river_2006 --seeds 0:6 --set fbn_deadreck.depth.bias=0.017
python -m fbn_testing.motion_beginning no_map_transit --seconds 700 --set fbn_deadreck.compass.wave_acceleration=0.15

The front half alone, without sonar; ``--set`` takes the numbers apart.  Some 10 s of CPU time a seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import partial
from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np

from fbn_bringup.evaluation.errors import ErrorSeries, against, aligned
from fbn_bringup.evaluation.series import track
from fbn_bringup.simulation import estimator_parameters
from fbn_bringup.ui import number, out, table
from fbn_common.parameters import dotted
from fbn_common.types import NS
from fbn_sim.scenario import load_scenario
from fbn_sim.simulation import Simulation, simulate
from fbn_testing.motion_study import assignments
from fbn_testing.motion_voyage import (
    NEAR_SURFACE,
    front_half,
    in_map,
    navigate,
    nees_of,
    nis_by_sensor,
    true_depth,
    true_track,
)
from fbn_testing.seeds import How, add_options, run_seeds, seed_range

SETTLED_S = 60.0  # what the start assumed is not judged
PARTS = {"z": slice(2, 3), "roll, pitch": slice(3, 5), "yaw": slice(5, 6), "x, y since the start": slice(0, 2)}
WITHOUT_SONAR = {"sensors.sonar.timing.rate": 0.0, "sensors.truth.odometry_rate": 5.0}
NODES = ("predict", "deadreck", "reference")


class Judged(NamedTuple):
    """One seed: NEES over its degrees of freedom, error and stated sigma (rms) by where and part; NIS by sensor."""

    parts: dict[tuple[str, str], tuple[float, float, float]]
    nis: dict[str, tuple[float, int]]


def beginning(scenario: str, seconds: float, settings: Mapping[str, Any], seed: int) -> Judged:
    """One seed's first minutes, judged against truth."""
    simulation = simulate(load_scenario(scenario, WITHOUT_SONAR), seed)
    end_ns = simulation.truth.start_ns + round(seconds * NS)
    own = {name: v for name, v in dotted(estimator_parameters(simulation)).items() if _of_front_half(name)}
    estimators = front_half({**own, **in_map(simulation.scenario.world.datum), **settings})
    kept = navigate(estimators, takewhile(lambda arrival: arrival[0] <= end_ns, simulation.records()))
    true = true_track(simulation)
    odometry = track(kept.odometry["deadreck"]).within(true)
    errors = against(aligned(odometry, true, int(odometry.stamp_ns[0])), true)
    return Judged(_parts(simulation, errors), nis_by_sensor(simulation, kept))


def _of_front_half(name: str) -> bool:
    return name.split(".")[0].removeprefix("fbn_") in NODES


def _parts(simulation: Simulation, errors: ErrorSeries) -> dict[tuple[str, str], tuple[float, float, float]]:
    time_s = (errors.track.stamp_ns - simulation.truth.start_ns) / NS
    depth = true_depth(simulation, errors.track.stamp_ns)
    found = {}
    for where, there in (("at the surface", depth < NEAR_SURFACE), ("under water", depth >= NEAR_SURFACE)):
        rows = np.flatnonzero(there & (time_s > SETTLED_S))
        for name, part in PARTS.items():
            error = np.concatenate([errors.position, errors.rotation], axis=1)[rows, part]
            variance = np.diagonal(errors.track.covariance[rows][:, part, part], axis1=1, axis2=2)
            rms = float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(variance)))
            found[where, name] = (nees_of(errors, rows, part), *rms)
    return found


def report(title: str, found: list[Judged]) -> None:
    """Print means over the seeds."""
    shown = table(f"{title}: {len(found)} seeds", "dead reckoning", "NEES / dof", "error, rms", "sigma, rms")
    for where, name in found[0].parts:
        values = np.mean([j.parts[where, name] for j in found], axis=0)
        shown.add_row(f"{name}, {where}", number(float(values[0])), *(number(float(v), 3) for v in values[1:]))
    for sensor in found[0].nis:
        total, dof = np.sum([j.nis[sensor] for j in found], axis=0)
        shown.add_row(f"NIS {sensor}", number(float(total / dof) if dof else None))
    out.print(shown)


def main() -> None:
    """Run the seeds and print their table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--seeds", default="1000:1004", metavar="A:B", help="tune on 1000 and up, report below")
    parser.add_argument("--seconds", type=float, default=450.0, help="of the mission")
    parser.add_argument("--set", action="append", default=[], metavar="NODE.NAME=VALUE", help="of an estimator")
    add_options(parser)
    a = parser.parse_args()
    one = partial(beginning, a.scenario, a.seconds, assignments(a.set))
    report(" ".join([a.scenario, *a.set]), run_seeds(one, seed_range(a.seeds), a.scenario, How(a.jobs, a.keep)))


if __name__ == "__main__":
    main()
