"""Scenarios: what is in the files, what is refused, and that a seed makes a mission, bit for bit."""

from __future__ import annotations

import ast
import dataclasses
from importlib import resources
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from sim_cases import short_mission

import fbn_sim
from fbn_common.parameters import ParameterError
from fbn_common.records import Record
from fbn_common.sonar_file import load_sonar
from fbn_common.types import Array
from fbn_sim.motion import SimulationError
from fbn_sim.scenario import load_scenario, scenario_names
from fbn_sim.simulation import Simulation, simulate
from fbn_sim.world import MapErrors, correlated_errors

ESTIMATORS = {"fbn_predict", "fbn_deadreck", "fbn_reference", "fbn_tracking", "fbn_global", "gtsam"}


def same(a: object, b: object) -> bool:
    """Equal to the last bit, whatever it is made of."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.tobytes() == b.tobytes()
    if dataclasses.is_dataclass(a):
        names = [f.name for f in dataclasses.fields(a)]
        return type(a) is type(b) and all(same(getattr(a, n), getattr(b, n)) for n in names)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def of(simulation: Simulation, topic: str) -> tuple[Record, ...]:
    return tuple(e.record for e in simulation.entries if e.topic == topic)


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_loads_and_says_what_it_is_about(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.about


def test_the_same_seed_makes_the_same_mission_bit_for_bit() -> None:
    again = simulate(load_scenario("charles_river_2006", {"mission.limit": 160.0}), 1)
    first = short_mission()
    assert same(first.entries, again.entries)
    assert same(first.prior_map, again.prior_map)


def test_another_seed_makes_another_mission() -> None:
    assert not same(of(short_mission(), "pressure"), of(short_mission(2), "pressure"))


@pytest.mark.parametrize("sensor", ["compass", "pressure", "altimeter", "gps", "actuators", "sonar"])
def test_switching_off_one_sensor_changes_no_other(sensor: str) -> None:
    whole, less = short_mission(), short_mission(1, ((f"sensors.{sensor}.timing.rate", 0.0),))
    gone = {e.topic for e in whole.entries} - {e.topic for e in less.entries}
    assert len(gone) == 1
    assert same(tuple(e for e in whole.entries if e.topic not in gone), less.entries)


def test_the_log_is_in_the_order_of_logging_and_no_record_comes_before_it_was_measured() -> None:
    entries = short_mission().entries
    assert all(a.log_time_ns <= b.log_time_ns for a, b in pairwise(entries))
    assert all(e.log_time_ns >= e.record.stamp_ns for e in entries)


def test_the_vehicle_dives_as_told() -> None:
    simulation = short_mission()
    (dive,) = simulation.dives
    depth = -simulation.truth.at((dive.start_ns + dive.end_ns) // 2).position[0, 2]
    assert depth == pytest.approx(2.5, abs=0.3)


def test_the_pilot_navigates_without_truth_and_so_goes_astray() -> None:
    motion = short_mission().truth.motion
    error = np.linalg.norm(motion.pilot_xy[-1] - motion.position[-1, :2])
    assert 0.3 < error < 30.0


def test_a_feature_is_missing_on_the_map_but_never_the_target() -> None:
    scenario = load_scenario("charles_river_2006", {"mission.limit": 10.0, "prior_map.missing": 11})
    (only,) = simulate(scenario, 3).prior_map.features
    assert only.target
    assert only.name == scenario.world.target


def test_map_errors_have_the_covariance_stated() -> None:
    errors = MapErrors(sigma=5.0, correlation_length=100.0)
    places = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 400.0, 0.0]])
    rng = np.random.default_rng(0)
    drawn: Array = np.array([correlated_errors(places, errors, rng)[:, 0] for _ in range(20_000)])
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    # 20,000 draws: a covariance of 25 to 25 sqrt(2 / 20,000) = 0.25, times four
    np.testing.assert_allclose(np.cov(drawn.T), 25.0 / (1.0 + distance / 100.0), atol=1.0)


def test_an_unknown_key_is_refused_with_the_near_one() -> None:
    with pytest.raises(ParameterError, match=r"did you mean 'sea\.wave_height'"):
        load_scenario("charles_river_2006", {"sea.wave_hight": 1.0})


def test_an_unknown_scenario_is_refused_with_those_there_are() -> None:
    with pytest.raises(ParameterError, match="charles_river_2006"):
        load_scenario("thames_1851")


def test_a_fault_of_no_sensor_is_refused() -> None:
    with pytest.raises(ParameterError, match="no sensor's topic"):
        load_scenario("charles_river_2006", {"faults.x.topic": "wind", "faults.x.kind": "nan"})


def test_a_scenario_from_a_file_is_the_users_own(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\nmission:\n  legs:\n    wait: {seconds: 5.0}\n")
    simulation = simulate(load_scenario(file), 1)
    assert simulation.truth.motion.time_s[-1] == pytest.approx(5.0, abs=0.2)
    file.write_text("mission: [1, 2")
    with pytest.raises(ParameterError, match="not readable as YAML"):
        load_scenario(file)


def test_running_aground_is_said() -> None:
    deep = {"world.depth": 2.0, "mission.limit": 160.0}
    with pytest.raises(SimulationError, match="touched the bed"):
        simulate(load_scenario("charles_river_2006", deep), 1)


def test_a_fault_in_the_scenario_reaches_the_log_and_no_other_sensor() -> None:
    fault = (("faults.f.topic", "altitude"), ("faults.f.kind", "dropped"), ("faults.f.start", 50.0))
    broken, whole = short_mission(1, fault), short_mission()
    assert len(of(broken, "altitude")) < len(of(whole, "altitude")) / 2
    assert same(of(broken, "pressure"), of(whole, "pressure"))


def test_the_simulator_knows_nothing_of_the_estimators() -> None:
    imported: set[str] = set()
    for path in Path(fbn_sim.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {a.name.split(".")[0] for a in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
    assert not imported & ESTIMATORS


def test_a_scenario_fits_any_sonar_file_by_name_or_by_a_path_beside_it(tmp_path: Path) -> None:
    """Arrays, and what the file says of the simulation, under what the scenario says itself."""
    named = load_scenario("charles_river_2006", {"sensors.sonar.head.sonar": "blueview_p450_90"}).sensors.sonar
    assert list(named.arrays) == ["sonar_left_2", "sonar_left", "sonar_right", "sonar_right_2"]
    assert all(a.mount_xyz == (0.6, 0.0, 0.0) for a in named.arrays.values())
    assert named.absorption == load_sonar("blueview_p450_90").simulation["absorption"]
    (tmp_path / "mine.yaml").write_text(
        resources.files("fbn_common").joinpath("data/sonars/generic_forward_looking.yaml").read_text()
    )
    (tmp_path / "scenario.yaml").write_text(
        "sensors: {sonar: {head: {sonar: mine.yaml}, level: 20.0}}\nmission: {legs: {fix: {seconds: 9.0, speed: 0.0}}}"
    )
    beside = load_scenario(tmp_path / "scenario.yaml").sensors.sonar
    assert list(beside.arrays) == ["sonar"] and beside.level == 20.0


def test_all_arrays_of_a_wide_sonar_report() -> None:
    wide = short_mission(1, (("sensors.sonar.head.sonar", "blueview_p900_130"),))
    scans = [r for _, topic, r in wide.records() if topic == "sonar/detections"]
    assert {s.frame_id for s in scans} == set(load_sonar("blueview_p900_130").arrays)
