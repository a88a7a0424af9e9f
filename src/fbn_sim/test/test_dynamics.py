"""Motion against closed forms: terminal speed, energy, drift with the current, floating."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sim_cases import DEEP, at_depth, neutral_body, water

from fbn_common.lie import matrix_from_quaternion, rpy_from_matrix
from fbn_common.types import Array
from fbn_sim.dynamics import BOW_SHARE, actuate, step
from fbn_sim.sea import SeaTable
from fbn_sim.vehicle import Body, Vehicle, draw_body

DT = 0.02
RPM_1200 = 1200.0 * 2.0 * np.pi / 60.0


def run(state: Array, actuators: list[float], seconds: float, body: Body, sea: SeaTable) -> Array:
    held = np.array(actuators)
    for i in range(int(seconds / DT)):
        state = step(state, held, i * DT, DT, body, sea)
    return state


def test_the_terminal_speed_is_where_thrust_equals_drag() -> None:
    body, n = neutral_body(), 100.0
    state = run(at_depth(50.0), [n, 0.0, 0.0], 200.0, body, water())
    a, b = body.quadratic_drag[0], body.linear_drag[0] + body.thrust_inflow * n
    speed = (-b + np.sqrt(b * b + 4.0 * a * body.thrust * n * n)) / (2.0 * a)
    # the slowest mode decays with about (M + X) / (2 a u + b) = 5 s: after 200 s the rest is below exp(-40)
    assert state[7] == pytest.approx(speed, abs=1e-9)


def test_a_ranger_at_1200_rpm_makes_three_quarters_of_a_metre_a_second() -> None:
    state = run(at_depth(50.0), [RPM_1200, 0.0, 0.0], 200.0, neutral_body(), water())
    assert state[7] == pytest.approx(0.75, rel=0.01)


def test_individuals_differ_in_speed_by_a_few_per_cent() -> None:
    speeds = [run(at_depth(50.0), [RPM_1200, 0.0, 0.0], 60.0, draw_body(Vehicle(), s), water())[7] for s in range(20)]
    assert 0.01 < np.std(speeds) / np.mean(speeds) < 0.06


def test_without_drag_lift_and_weight_energy_is_kept() -> None:
    none = {"linear_drag": (0.0,) * 6, "quadratic_drag": (0.0,) * 6, "body_lift": 0.0, "fin_lift": 0.0}
    body = neutral_body(**none)
    state = at_depth(50.0, np.array([0.7, 0.1, -0.2, 0.5, 0.2, -0.3]))
    mass = body.rigid + body.added
    before = state[7:] @ mass @ state[7:]
    after = run(state, [0.0, 0.0, 0.0], 20.0, body, water())
    # Runge-Kutta's error per step is of order (rate dt)^5 / 120 = 1e-11, over 1000 steps
    assert after[7:] @ mass @ after[7:] == pytest.approx(before, rel=1e-7)


def test_a_drifting_body_takes_on_the_velocity_of_the_water() -> None:
    body = neutral_body()
    state = run(at_depth(50.0), [0.0, 0.0, 0.0], 600.0, body, water(0.3, -0.2))
    moving = matrix_from_quaternion(state[3:7]) @ state[7:10]
    np.testing.assert_allclose(moving, [0.3, -0.2, 0.0], atol=5e-3)  # quadratic drag dies slowly


def test_a_uniform_current_carries_the_path_and_changes_nothing_else() -> None:
    body, seconds, flow = neutral_body(), 30.0, np.array([0.3, -0.2, 0.0])
    turning = [RPM_1200, 0.2, -0.1]
    still = run(at_depth(50.0), turning, seconds, body, water())
    start = at_depth(50.0)
    start[7:10] = flow
    carried = run(start, turning, seconds, body, water(flow[0], flow[1]))
    np.testing.assert_allclose(carried[:3] - flow * seconds, still[:3], atol=1e-6)
    np.testing.assert_allclose(carried[3:7], still[3:7], atol=1e-7)


def test_positive_pan_turns_right_and_positive_tilt_raises_the_bow() -> None:
    body = neutral_body()
    start = at_depth(50.0, np.array([0.7, 0.0, 0.0, 0.0, 0.0, 0.0]))
    turned = rpy_from_matrix(matrix_from_quaternion(run(start, [RPM_1200, 0.3, 0.0], 3.0, body, water())[3:7]))
    raised = rpy_from_matrix(matrix_from_quaternion(run(start, [RPM_1200, 0.0, 0.3], 3.0, body, water())[3:7]))
    assert turned[2] < -0.05
    assert raised[1] < -0.02


def test_fins_turn_the_same_way_as_a_steered_propeller() -> None:
    body = neutral_body(steering="fins")
    start = at_depth(50.0, np.array([0.7, 0.0, 0.0, 0.0, 0.0, 0.0]))
    turned = rpy_from_matrix(matrix_from_quaternion(run(start, [RPM_1200, 0.2, 0.0], 3.0, body, water())[3:7]))
    raised = rpy_from_matrix(matrix_from_quaternion(run(start, [RPM_1200, 0.0, 0.2], 3.0, body, water())[3:7]))
    assert turned[2] < -0.05
    assert raised[1] < -0.02


def test_afloat_it_sinks_in_until_buoyancy_equals_weight() -> None:
    vehicle = dataclasses.replace(Vehicle(), excess_buoyancy=20.0, gravity_centre=(0.0, 0.0, -0.02))
    body = neutral_body()._replace(buoyancy=vehicle.mass * 9.80665 + 20.0, gravity_centre=np.array([0.0, 0.0, -0.02]))
    state = run(at_depth(0.1), [0.0, 0.0, 0.0], 120.0, body, water())
    share = np.roots([-2.0, 3.0, 0.0, -body.weight / body.buoyancy])
    s = next(float(r.real) for r in share if 0.0 <= r.real <= 1.0)
    assert state[2] == pytest.approx(body.radius * (1.0 - 2.0 * s), abs=2e-3)
    assert 0.0 < BOW_SHARE < 0.5


def test_an_actuator_lags_and_keeps_its_limits_of_rate_and_range() -> None:
    body = neutral_body()
    once = actuate(np.zeros(3), np.array([1.0, 0.01, 9.0]), DT, body)
    assert once[0] == pytest.approx(1.0 - np.exp(-DT / body.actuator_lag[0]))
    assert once[2] == pytest.approx(body.actuator_rate[2] * DT)
    held = np.zeros(3)
    for _ in range(500):
        held = actuate(held, np.array([1.0, 0.01, 9.0]), DT, body)
    assert held[2] == pytest.approx(body.actuator_limit[2])


def test_still_water_is_still() -> None:
    assert water().depth == DEEP
    state = run(at_depth(10.0), [0.0, 0.0, 0.0], 10.0, neutral_body(), water())
    np.testing.assert_allclose(state[7:], 0.0, atol=1e-12)
