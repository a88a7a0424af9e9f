"""The vehicle's equations: terminal speed, signs, symmetries, and Jacobians against numerical derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbn_common.lie import matrix_from_rpy, so3_exp
from fbn_common.types import Array
from fbn_predict.dynamics import model_of
from fbn_predict.parameters import Doubt, Dynamics, prior
from fbn_predict.sensitivity import COLUMNS, new_scratch, step

RANGER = Dynamics()
FINNED = Dynamics(fin_torque=1.0, fin_lift=1.0, angular_actuation=(-0.5, 1.7, 1.7), quadratic_damping=(0.2, 0.5, 0.5))
DT = 0.01
RATE = RANGER.propeller_reference


def stepped(
    d: Dynamics, velocity: Array, rotation: Array, p: Array, actuators: Array, depth: float = 3.0
) -> tuple[Array, Array]:
    y, s = np.empty(12), np.empty((12, COLUMNS))
    step(velocity, np.ascontiguousarray(rotation), p, actuators, depth, DT, model_of(d), y, s, True, new_scratch())
    return y, s


def settled(
    d: Dynamics, actuators: list[float], seconds: float = 60.0, water: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> tuple[Array, Array]:
    p = prior(d, Doubt()).mean
    p[12:] = water
    velocity, rotation = np.zeros(6), np.eye(3)
    for _ in range(round(seconds / DT)):
        y, _ = stepped(d, velocity, rotation, p, np.array(actuators))
        velocity, rotation = y[6:], rotation @ so3_exp(y[3:6])
    return velocity, rotation


def test_ranger_reaches_three_quarters_of_a_metre_a_second_at_1200_rpm() -> None:
    velocity, _ = settled(replace(RANGER, angular_actuation=(0.0, 0.25, 0.25), buoyancy=0.0), [RATE, 0, 0, 0, 0])
    assert velocity[0] == pytest.approx(0.75, abs=1e-5)  # 60 s are 16 time constants: exp(-16) = 1e-7


def test_half_the_propeller_rate_gives_half_the_speed() -> None:
    velocity, _ = settled(replace(RANGER, buoyancy=0.0, angular_actuation=(0.0, 0.25, 0.25)), [RATE / 2, 0, 0, 0, 0])
    assert velocity[0] == pytest.approx(0.375, abs=1e-5)


def test_a_steered_propeller_slows_the_vehicle_by_the_power_of_the_force_that_is_left() -> None:
    straight = replace(RANGER, buoyancy=0.0, angular_actuation=(0.0, 0.0, 0.0), lateral_actuation=0.0)
    velocity, _ = settled(straight, [RATE, 0.5, 0.3, 0, 0])
    assert velocity[0] == pytest.approx(0.75 * (np.cos(0.5) * np.cos(0.3)) ** 0.4, abs=1e-5)


@pytest.mark.parametrize(("dynamics", "actuators"), [(RANGER, [RATE, 0.1, 0, 0, 0]), (FINNED, [RATE, 0, 0, 0.1, 0])])
def test_positive_pan_and_positive_rudder_turn_the_bow_right(dynamics: Dynamics, actuators: list[float]) -> None:
    velocity, _ = settled(dynamics, actuators, 10.0)
    assert velocity[5] < -0.005  # yaw is positive to the left


@pytest.mark.parametrize(("dynamics", "actuators"), [(RANGER, [RATE, 0, 0.1, 0, 0]), (FINNED, [RATE, 0, 0, 0, 0.1])])
def test_positive_tilt_and_positive_plane_raise_the_bow(dynamics: Dynamics, actuators: list[float]) -> None:
    _, rotation = settled(dynamics, actuators, 3.0)
    assert rotation[2, 0] > 0.01  # the bow points up; pitch is negative


def test_a_still_vehicle_drifts_with_the_water() -> None:
    velocity, rotation = settled(replace(RANGER, buoyancy=0.0), [0, 0, 0, 0, 0], 120.0, (0.2, -0.1, 0.0))
    np.testing.assert_allclose(rotation @ velocity[:3], [0.2, -0.1, 0.0], atol=1e-6)


def test_a_heeled_vehicle_rights_itself() -> None:
    p, velocity, rotation = prior(RANGER, Doubt()).mean, np.zeros(6), matrix_from_rpy(np.array([0.5, -0.3, 1.0]))
    for _ in range(3000):
        y, _ = stepped(RANGER, velocity, rotation, p, np.zeros(5))
        velocity, rotation = y[6:], rotation @ so3_exp(y[3:6])
    np.testing.assert_allclose(rotation[2], [0.0, 0.0, 1.0], atol=1e-3)


angles = st.floats(-1.0, 1.0)
numbers = st.lists(st.floats(-1.0, 1.0), min_size=28, max_size=28).map(np.array)


@given(numbers)
def test_turning_the_world_changes_nothing_but_the_water(x: Array) -> None:
    p = prior(RANGER, Doubt()).mean
    p[12:] = 0.3 * x[:3]
    rotation, turn = matrix_from_rpy(x[3:6]), matrix_from_rpy(np.array([0.0, 0.0, 3.0 * x[6]]))
    actuators = np.array([RATE, 0.3 * x[7], 0.3 * x[8], 0, 0])
    y, _ = stepped(RANGER, x[9:15], rotation, p, actuators)
    turned = p.copy()
    turned[12:] = turn @ p[12:]
    y_turned, _ = stepped(RANGER, x[9:15], turn @ rotation, turned, actuators)
    np.testing.assert_allclose(y_turned, y, atol=1e-12)  # only rounding differs


@given(numbers, st.sampled_from([RANGER, FINNED]))
def test_jacobians_equal_numerical_derivatives(x: Array, dynamics: Dynamics) -> None:
    p = prior(dynamics, Doubt()).mean * (1.0 + 0.2 * x[:15])
    p[12:] = 0.3 * x[12:15]
    velocity, rotation = np.array([0.7, 0.2, 0.2, 0.3, 0.3, 0.3]) * (1.5 + x[15:21]), matrix_from_rpy(x[21:24])
    actuators = np.array([RATE, 0.4 * x[24], 0.4 * x[25], 0.4 * x[26], 0.4 * x[27]])

    def outcome(d: Array) -> Array:
        y, _ = stepped(dynamics, velocity + d[:6], rotation @ so3_exp(d[6:9].copy()), p + d[9:], actuators)
        return y

    _, s = stepped(dynamics, velocity, rotation, p, actuators)
    h = 1e-6  # central difference: error h^2 = 1e-12 of the third derivative, rounding 1e-16 / h = 1e-10
    numeric = np.column_stack([(outcome(h * e) - outcome(-h * e)) / (2 * h) for e in np.eye(COLUMNS)])
    np.testing.assert_allclose(s, numeric, atol=2e-8)
