"""The same log gives the same bits; and what must not matter does not.

The jitter tests: a peer's answer moves by tens of metres when two callbacks swap or a stamp moves by a microsecond.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbn_bringup.configuration import Parameters
from fbn_bringup.offline import Runner, replay_offline, run_offline, steps
from fbn_bringup.rundir import ReplayOptions
from fbn_common import records as r
from fbn_common.graph import GRAPH
from fbn_common.lie import matrix_from_quaternion, so3_log
from fbn_common.types import nanoseconds
from fbn_testing.compare import first_difference, read_log
from fbn_testing.faults import restamped

TRACKS = ("deadreck/odometry", "reference/odometry", "global/odometry")
Final = dict[str, r.Odometry]


def test_the_same_log_twice_gives_the_same_bits(
    river: Path, river_run: Path, river_options: ReplayOptions, tmp_path: Path
) -> None:
    replay_offline(river, tmp_path / "run", river_options)
    assert first_difference(read_log(river_run / "bag"), read_log(tmp_path / "run" / "bag")) == ""


@pytest.fixture(scope="module")
def baseline(river_log: list[Any], river_parameters: Parameters) -> Final:
    return final_poses(river_log, river_parameters)


def final_poses(log: Iterable[Any], parameters: Parameters) -> Final:
    """The last pose of each track."""
    last: dict[str, r.Odometry] = {}

    def keep(log_time_ns: int, topic: str, record: r.Record) -> None:
        if topic in TRACKS and isinstance(record, r.Odometry):
            last[topic] = record

    run_offline(GRAPH, parameters, log, keep)
    return last


def swapped(log: list[Any]) -> list[Any]:
    """All messages of a step in the opposite order, as if the callbacks had come so."""
    return [entry for step in steps(log) for entry in reversed(step.logged)]


JITTER: dict[str, Callable[[list[Any]], list[Any]]] = {
    "callbacks of one step swapped": swapped,
    "the compass's stamps 1 us later": lambda log: list(restamped(log, "imu/data", 1000)),
    "the pressure's stamps 1 us earlier": lambda log: list(restamped(log, "pressure", -1000)),
    "the sonar's stamps 1 us later": lambda log: list(restamped(log, "sonar/detections", 1000)),
    "the actuators' stamps 1 us later": lambda log: list(restamped(log, "actuators", 1000)),
}


@pytest.mark.parametrize("case", JITTER)
def test_what_jitter_changes_is_below_a_millimetre(
    case: str, river_log: list[Any], river_parameters: Parameters, baseline: Final
) -> None:
    assert_same_poses(baseline, final_poses(JITTER[case](river_log), river_parameters))


def test_an_extra_prediction_changes_nothing(
    river_log: list[Any], river_parameters: Parameters, baseline: Final
) -> None:
    """In the middle of every tenth step all nodes advance once more."""
    runner = Runner.build(GRAPH, river_parameters)
    published: list[tuple[str, r.Record]] = []
    for k, step in enumerate(steps(river_log)):
        middle_ns = step.end_ns - nanoseconds(0.1)
        later = step.logged
        if k % 10 == 0:
            published += runner.step(middle_ns, [e for e in step.logged if e[0] <= middle_ns], whole=False)
            later = [e for e in step.logged if e[0] > middle_ns]
        published += runner.step(step.end_ns, later)
    assert_same_poses(
        baseline, {t: record for t, record in published if t in TRACKS and isinstance(record, r.Odometry)}
    )


def assert_same_poses(one: Final, other: Final) -> None:
    """Within 1 mm and 0.001 degrees, at the same time but for the microsecond of the jitter."""
    assert one.keys() == other.keys() == set(TRACKS)
    for topic in TRACKS:
        a, b = one[topic], other[topic]
        assert abs(a.stamp_ns - b.stamp_ns) <= 1000, topic
        assert np.linalg.norm(a.pose.position - b.pose.position) < 1e-3, topic
        turn = matrix_from_quaternion(a.pose.orientation).T @ matrix_from_quaternion(b.pose.orientation)
        assert np.linalg.norm(so3_log(np.ascontiguousarray(turn))) < np.radians(1e-3), topic
