"""What ``fbn design`` says: numbers by exact geometry, a passage counted another way, advice that is true."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbn_bringup.design.advice import advice, slope_sigma
from fbn_bringup.design.case import Case, make_case, terms
from fbn_bringup.design.passage import passage
from fbn_bringup.report.design_figure import draw
from fbn_bringup.shipped import config_file
from fbn_common.parameters import ParameterError
from fbn_common.sonar import SonarArray, polar

SEA = {"water_depth": 10.0, "vehicle_depth": 7.0, "target_depth": 9.0, "current": 0.1}
CALM = {"wave_height": 0.0, "wave_period": 3.0}


def _ranger(**changes: Any) -> Case:
    return replace(make_case(config_file("ranger"), **SEA, **CALM), **changes)


def _one_array(**changes: Any) -> Case:
    array = SonarArray(mount_xyz=(0.0, 0.0, 0.0), bearing_min=0.6, bearing_max=2.5)
    return _ranger(arrays={"sonar": array}, **changes)


def test_a_case_is_the_vehicles_own_speed_turns_and_sonar() -> None:
    """By hand from ranger.yaml, blueview_p900_45.yaml and the Ranger's dynamics (0.25 and 1.5, sine of 30 degrees)."""
    case = _ranger()
    assert (case.speed, case.ping_rate, case.array.range_max) == (0.75, 4.0, 40.0)
    assert case.wavelength == pytest.approx(1500.0 / 900e3) and list(case.arrays) == ["sonar_left", "sonar_right"]
    assert case.turn_rate == pytest.approx(0.25 * 0.5 / 1.5) and case.acceleration == pytest.approx(0.75 * 0.27)
    assert terms(case)[0].value == pytest.approx(0.75 / (1500.0 / 900e3 * 4.0))


def test_a_term_is_seen_after_the_time_in_which_it_grows_to_the_noise() -> None:
    """Exact geometry at that time: ahead, at broadside, in a turn, in acceleration, in a wave."""
    case = _ranger(wave_height=0.6, wave_period=4.0)
    after, sigma, v = [t.after for t in terms(case)], case.array.range_sigma, case.speed
    assert v * after[0] == pytest.approx(sigma)
    assert np.hypot(4.0, v * after[1]) - 4.0 == pytest.approx(sigma, rel=0.01)  # next order: (v t / 2 r)^2 = 0.6 %
    radius = v / case.turn_rate
    assert radius * (1.0 - np.cos(case.turn_rate * after[2])) == pytest.approx(sigma, rel=0.01)
    assert 0.5 * case.acceleration * after[3] ** 2 == pytest.approx(sigma)
    assert v / 4.0 * after[4] == pytest.approx(case.array.bearing_sigma)
    assert case.turn_rate * after[5] == pytest.approx(case.array.bearing_sigma)
    wave = case.motion.wave
    reach = wave.deep_speed(-case.vehicle_depth) / wave.frequency
    if reach > sigma:
        assert reach * np.sin(wave.frequency * after[6]) == pytest.approx(sigma)
    assert np.isinf(terms(_ranger(wave_height=0.01))[7].after)  # 1 cm of wave never shows in 5 cm of noise


def test_a_passage_ends_where_the_target_leaves_the_lobe_and_counts_the_pings_between() -> None:
    """A target straight ahead and 2 m below leaves a lobe of +-10 deg at 2 m / sin(10 deg)."""
    case = _one_array(speed=0.5, current=0.0)
    seen, step = passage(case, 0.0), 0.5 / 4.0
    edge = 2.0 / np.sin(case.array.lobe_width / 2.0)
    assert edge <= seen.last <= edge + step
    assert 40.0 - step <= seen.first <= 40.0
    way = np.sqrt(40.0**2 - 4.0) - np.sqrt(edge**2 - 4.0)
    assert seen.pings == pytest.approx(way / step, abs=1.0)
    assert seen.detections == pytest.approx(0.67 * seen.pings)


def test_a_passages_sigmas_are_the_cramer_rao_bound() -> None:
    """The same information by numerical derivatives of range, bearing and angle about the axis."""
    case = _one_array(speed=0.5, current=0.0)
    seen, array, target = passage(case, 3.0), case.array, np.array([0.0, 3.0, -2.0])
    total = np.zeros((3, 3))
    sigma = np.array([array.range_sigma, array.bearing_sigma])
    for x in np.arange(-40.0, 40.0, 0.5 / 4.0):
        at = np.array([x, 0.0, 0.0])
        r, phi, theta = polar(array.rotation_base_array.T @ (target - at))
        if not (4.0 <= r <= 40.0 and 0.6 <= phi <= 2.5 and abs(theta) <= array.lobe_width / 2.0):
            continue
        J = np.empty((3, 3))
        for k, e in enumerate(1e-5 * np.eye(3)):
            there, back = (np.array(polar(array.rotation_base_array.T @ (target + s * e - at))) for s in (1, -1))
            J[:, k] = (there - back) / 2e-5
        if not total.any():
            total += np.outer(J[2], J[2]) * 12.0 / array.lobe_width**2  # variance of the uniform: w^2 / 12
        total += 0.67 * (J[:2].T / sigma**2) @ J[:2]
    P = np.linalg.inv(total)
    assert seen.sigma_vertical == pytest.approx(np.sqrt(P[2, 2]), rel=1e-4)
    assert seen.sigma_horizontal == pytest.approx(np.sqrt(np.linalg.eigvalsh(P[:2, :2])[1]), rel=1e-4)


def test_the_rate_of_a_track_is_known_as_least_squares_says() -> None:
    """Spread of the slopes of 4,000 lines through noise; its own relative error is 1 / sqrt(8,000)."""
    case, rng = _ranger(), np.random.default_rng(3)
    t = np.arange(27) / (4.0 * 0.67)  # an infant's life of 10 s
    slopes = np.polyfit(t, 0.05 * rng.normal(size=(27, 4000)), 1)[0]
    assert slope_sigma(case) == pytest.approx(slopes.std(), rel=4.0 / np.sqrt(8000.0))


def test_what_the_advice_says_of_the_head_is_true() -> None:
    case = _one_array(speed=0.5, current=0.0)
    (text,) = [a for a in advice(case, 0.0) if "turned down" in a]
    degrees = float(text.split("turned down by ")[1].split()[0]) + 1.0  # said in whole degrees
    tilted = replace(case.array, mount_rpy=(0.0, np.deg2rad(degrees), 0.0))
    assert passage(replace(case, arrays={"sonar": tilted}), 0.0).last == pytest.approx(4.0, abs=0.2)


def test_the_advice_to_slow_down_gives_the_detections_that_a_feature_needs() -> None:
    case = _one_array(ping_rate=0.2, speed=1.0, current=0.1)
    (text,) = [a for a in advice(case, 0.0) if "a feature needs" in a]
    now = passage(case, 0.0).detections
    # whole pings: one too many or too few, 0.67 detections, grows with the change that is advised, and comes once more
    about = pytest.approx(7.0, abs=0.67 * (7.0 / now + 1.0))
    slower, rate = (float(text.split(word)[1].split()[0]) for word in ("go at ", "ping at "))
    assert now < 7.0 and slower < 1.0 and rate > 0.1
    assert passage(replace(case, speed=slower), 0.0).detections == about
    assert passage(replace(case, ping_rate=rate), 0.0).detections == about


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"target_depth": 0.5, "vehicle_depth": 9.5, "offset": 30.0}, "never comes into view"),
        ({"ping_rate": 30.0}, "returns 18.8 times a second at most"),
        ({"current": 1.0}, "cannot go against it"),
        ({"speed": 0.1}, "hides in the noise of 5 cm"),
        ({"wave_height": 1.0, "wave_period": 8.0}, "Waves show in the ranges"),
    ],
)
def test_what_does_not_go_is_said(changes: dict[str, float], said: str) -> None:
    offset = changes.pop("offset", 3.0)
    assert any(said in line for line in advice(_ranger(**changes), offset))


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"vehicle_depth": 12.0}, "--altitude"), ({"target_depth": -1.0}, "--target-depth"), ({"speed": 0.0}, "--speed")],
)
def test_a_case_that_cannot_be_names_the_option(changes: dict[str, float], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        _ranger(**changes)


def test_the_command_prints_all_numbers_and_advice(fbn: Any) -> None:
    status, out, _ = fbn("design", "ranger", "--depth", "5")
    assert status == 0 and "Advice" in out and all(f"N{i}" in out for i in range(1, 9))


def test_as_json_it_says_the_same(fbn: Any) -> None:
    status, out, _ = fbn("design", "ranger", "--speed", "1.5", "--json")
    found = json.loads(out)
    assert status == 0 and found["numbers"]["N1"]["value"] == pytest.approx(1.5 / (1500.0 / 900e3 * 4.0))
    assert found["passage"]["pings"] > 0 and found["advice"]


def test_without_a_vehicle_it_lists_vehicles_and_sonars(fbn: Any) -> None:
    status, out, _ = fbn("design")
    assert status == 0 and "blueview_p900_130" in out and "remus100" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("iver2",), "--sonar"),
        (("iver2", "--sonar", "p900"), "blueview_p900_45"),
        (("submarine",), "ranger"),
        (("ranger", "--altitude", "20"), "--altitude"),
        (("ranger", "--ping-rate", "0"), "--ping-rate"),
    ],
)
def test_a_wrong_argument_is_answered_with_the_remedy(fbn: Any, arguments: tuple[str, ...], said: str) -> None:
    status, _, err = fbn("design", *arguments)
    assert status == 1 and said in err and "Traceback" not in err


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    draw(_ranger(), 3.0, tmp_path / "design.png")
    assert (tmp_path / "design.png").stat().st_size > 20_000
