"""Faults do what they say, to the sensor that they name, and to no other."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from sim_cases import START_NS, circling, flight, short_mission

from fbn_common.parameters import ParameterError
from fbn_common.records import FluidPressure, SonarDetections
from fbn_common.types import NS, nanoseconds
from fbn_sim.faults import KINDS, SIGMA, Fault, apply, shifted
from fbn_sim.sensors.depth import Pressure, pressure_records
from fbn_sim.sensors.sample import Entry

LOG = pressure_records(Pressure(), 1000.0, flight(circling(3.0, seconds=60.0)))


def failed(kind: str, size: float = 0.0) -> list[Entry]:
    return apply(LOG, "f", Fault("pressure", kind, start=20.0, end=40.0, size=size), START_NS, 1)


def during(entries: list[Entry]) -> list[Entry]:
    return [e for e in entries if 20 * NS <= e.record.stamp_ns - START_NS < 40 * NS]


def pascal(entries: list[Entry]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([e.record.fluid_pressure for e in entries if isinstance(e.record, FluidPressure)])


def test_dropped_leaves_nothing_of_that_time_and_all_of_the_rest() -> None:
    assert not during(failed("dropped"))
    assert len(failed("dropped")) == len(LOG) - len(during(LOG))


def test_frozen_gives_the_last_values_under_new_stamps() -> None:
    out = during(failed("frozen"))
    assert [e.record.stamp_ns for e in out] == [e.record.stamp_ns for e in during(LOG)]
    assert len(set(pascal(out))) == 1


def test_repeated_gives_the_last_message_again_with_its_old_stamp() -> None:
    out = failed("repeated")
    before = [e for e in LOG if e.record.stamp_ns < START_NS + 20 * NS]
    assert sum(e.record is before[-1].record for e in out) == 1 + len(during(LOG))


def test_nan_is_not_a_number() -> None:
    assert all(math.isnan(p) for p in pascal(during(failed("nan"))))


def test_noise_is_ten_times_the_sensors_own() -> None:
    difference = pascal(during(failed("noise"))) - pascal(during(LOG))
    # 100 samples: 7 % of the standard deviation, times three
    assert difference.std() == pytest.approx(10.0 * SIGMA[FluidPressure], rel=0.22)


def test_late_comes_five_seconds_later_with_its_stamp() -> None:
    for late, good in zip(during(failed("late")), during(LOG), strict=True):
        assert late.log_time_ns - good.log_time_ns == nanoseconds(5.0)
        assert late.record is good.record


def test_duplicated_comes_twice() -> None:
    assert len(during(failed("duplicated"))) == 2 * len(during(LOG))


def test_bias_is_added() -> None:
    np.testing.assert_allclose(pascal(during(failed("bias", 500.0))) - pascal(during(LOG)), 500.0)


def test_a_clock_jump_moves_the_stamps_alone() -> None:
    moved = failed("clock_jump", -10.0)
    stamps = {e.log_time_ns: e.record.stamp_ns for e in LOG}
    changed = [stamps[e.log_time_ns] - e.record.stamp_ns for e in moved if stamps[e.log_time_ns] != e.record.stamp_ns]
    assert changed == [nanoseconds(10.0)] * len(during(LOG))


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_touches_no_other_topic(kind: str) -> None:
    other = [e._replace(topic="altitude") for e in LOG]
    assert apply(other, "f", Fault("pressure", kind), START_NS, 1) == other


def test_every_sensors_record_can_fail() -> None:
    simulation = short_mission()
    kinds = {type(e.record): e.record for e in simulation.entries if not e.topic.startswith("truth/")}
    for record in kinds.values():
        assert type(shifted(record, 0.1)) is type(record)


def test_one_array_can_fail_and_leave_the_other() -> None:
    fault = Fault("sonar/detections", "dropped", frame="sonar_left")
    out = apply(list(short_mission().entries), "f", fault, START_NS, 1)
    frames = {e.record.frame_id for e in out if isinstance(e.record, SonarDetections)}
    assert frames == {"sonar_right"}


def test_a_faults_mistakes_are_refused_with_the_reason() -> None:
    with pytest.raises(ParameterError, match="kind must be one of"):
        Fault("pressure", "broken")
    with pytest.raises(ParameterError, match="topic"):
        Fault("", "nan")
    with pytest.raises(ParameterError, match="after it starts"):
        dataclasses.replace(Fault("pressure", "nan"), start=5.0, end=5.0)
