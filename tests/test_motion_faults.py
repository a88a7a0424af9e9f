"""A few cells of the front half's fault table: what is said, what moves, how it comes back."""

from __future__ import annotations

import pytest

from fbn_predict.twin import Twin
from fbn_sim.sensors.sample import Entry
from fbn_testing.motion_faults import SENSORS, Cell, Heard, cell, listen, voyage

Voyage = tuple[Twin, list[Entry], Heard]


@pytest.fixture(scope="module")
def sailed() -> Voyage:
    twin, entries = voyage(3)
    return twin, entries, listen(entries)


def spoilt(sailed: Voyage, topic: str, kind: str) -> Cell:
    twin, entries, good = sailed
    return cell(twin, entries, good, topic, kind)


@pytest.mark.parametrize(
    ("topic", "kind", "within_s"),
    [
        ("pressure", "nan", 0.5),  # refused one by one: a period, 0.2 s, and a step
        ("imu/data", "frozen", 2.8),  # 20 equal values at 10 Hz, lost messages, a step
        ("lbl/range", "frozen", 3.5),  # four repeats at 0.67 s, and a step
        ("imu/data", "dropped", 3.0),  # dead_after is 2 s, found at a step's end
    ],
)
def test_a_fault_is_named_soon_and_the_sensor_used_again_when_it_is_over(
    sailed: Voyage, topic: str, kind: str, within_s: float
) -> None:
    found = spoilt(sailed, topic, kind)
    assert found.said
    assert found.named_s is not None and found.named_s < within_s
    assert found.used_again_s is not None and found.used_again_s < 5.0
    assert found.sound


def test_duplicates_are_named_and_move_nothing(sailed: Voyage) -> None:
    found = spoilt(sailed, "pressure", "duplicated")
    assert found.said == "duplicate"
    assert (found.drift, found.depth, found.absolute) == (0.0, 0.0, 0.0)


def test_frozen_actuators_are_named_where_they_used_to_change_all_the_time(sailed: Voyage) -> None:
    """The twin's autopilot changes tilt with each message; 20 of them at 10 Hz, and a step."""
    found = spoilt(sailed, "actuators", "frozen")
    assert found.said.startswith("frozen: 21 equal commands in a row")
    assert found.named_s is not None and found.named_s < 2.5
    assert found.worst < 4.0
    assert found.sound


def test_a_frozen_beacon_leaves_the_map_where_it_was(sailed: Voyage) -> None:
    """Until it is named it may pull by what is run meanwhile, 2 m, against two others and GPS: less than half of it."""
    found = spoilt(sailed, "lbl/range", "frozen")
    assert found.absolute < 1.0
    assert found.worst < 4.0


def test_after_a_biased_sensor_the_position_is_within_four_sigma_again(sailed: Voyage) -> None:
    """The largest of some 2,000 correlated errors over their sigma: about 20 independent ones, each under 4."""
    found = spoilt(sailed, "gps/fix", "bias")
    assert found.worst < 4.0
    assert found.sound


def test_the_table_has_every_sensor_of_the_front_half() -> None:
    assert {"imu/data", "pressure", "altitude", "gps/fix", "lbl/range", "actuators"} == set(SENSORS)
