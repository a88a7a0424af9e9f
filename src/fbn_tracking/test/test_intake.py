"""What is malformed is refused with a reason; what is early waits; what is late is said to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_world import World, corridor, simulate

from fbn_common.records import Pose, SonarDetection, Verdict
from fbn_tracking.intake import Intake, motion_fault, usable

RUN = simulate(World(corridor(3)), 4, 1000)
MOTION, SCAN = RUN.motions[2], RUN.scans[0]
GOOD = SonarDetection(10.0, 1.5, 0.05, 0.02, 0.5)


def _nan(shape):
    return np.full(shape, np.nan)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"earth": _nan(4)}, "earth"),
        ({"increment": Pose(np.zeros(3), np.zeros(4))}, "quaternion"),
        ({"increment_covariance": -np.eye(6)}, "increment_covariance"),
        ({"increment_covariance": np.eye(5)}, "shape"),
        ({"earth_information": np.arange(16.0).reshape(4, 4)}, "earth_information"),
        ({"drift_covariance": _nan((3, 3))}, "drift_covariance"),
        ({"drift_time_constant": 0.0}, "drift_time_constant"),
        ({"altitude": float("inf")}, "altitude"),
        ({"previous_ns": MOTION.stamp_ns + 1}, "previous"),
    ],
)
def test_a_malformed_motion_is_named(change, word):
    assert word in motion_fault(replace(MOTION, **change))
    assert motion_fault(MOTION) == ""


@pytest.mark.parametrize(
    "echo",
    [
        replace(GOOD, range=float("nan")),
        replace(GOOD, range=-1.0),
        replace(GOOD, bearing=4.0),
        replace(GOOD, bearing_sigma=-0.1),
        replace(GOOD, intensity=float("inf")),
    ],
)
def test_a_malformed_echo_is_refused_and_its_neighbours_kept(echo):
    kept, answers = usable(replace(SCAN, detections=(GOOD, echo)), 10)
    assert kept == [GOOD]
    assert [a.verdict for a in answers] == [Verdict.REFUSED]


def test_of_thousands_of_echoes_the_strongest_are_kept_and_the_rest_answered_for():
    echoes = tuple(replace(GOOD, range=5.0 + 0.01 * i, intensity=i / 3000) for i in range(3000))
    kept, answers = usable(replace(SCAN, detections=echoes), 40)
    assert {e.intensity for e in kept} == {i / 3000 for i in range(2960, 3000)}
    assert answers[0].reason == "2960 echoes: beyond the 40 strongest"


def test_the_order_of_echoes_is_of_no_consequence():
    echoes = tuple(replace(GOOD, range=5.0 + (7 * i) % 11) for i in range(11))
    assert usable(replace(SCAN, detections=echoes), 5)[0] == usable(replace(SCAN, detections=echoes[::-1]), 5)[0]


def _intake():
    return Intake({"sonar_left", "sonar_right"}, 3_000_000_000)


def test_an_unknown_array_is_refused_with_the_names_there_are():
    intake = _intake()
    intake.put(replace(SCAN, frame_id="sonar_lfet"))
    assert "sonar_left, sonar_right" in intake.answers[0].reason


def test_a_scan_whose_ping_never_comes_is_late():
    intake = _intake()
    intake.put(SCAN)
    assert intake.expire(SCAN.stamp_ns + 2_000_000_000) == []
    (answer,) = intake.expire(SCAN.stamp_ns + 4_000_000_000)
    assert answer.verdict is Verdict.LATE and intake.scans == {}


def test_a_second_copy_is_refused():
    intake = _intake()
    for record in (SCAN, SCAN, MOTION, MOTION):
        intake.put(record)
    assert ["second" in a.reason for a in intake.answers] == [True, True]
