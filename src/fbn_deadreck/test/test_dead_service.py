"""The dead service: a chain of its increments and earth measurements is as sure as the filter itself."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from fbn_common.estimator import Output
from fbn_common.lie import matrix_from_quaternion, matrix_from_rpy
from fbn_common.motion_ekf.adopt import gained_information
from fbn_common.motion_ekf.core import State
from fbn_common.motion_ekf.layout import (
    DAMPING,
    DEVIATION,
    THRUST,
    WATER,
    X_PARAMETERS,
    X_ROTATION,
    X_SIZE,
    X_VELOCITY,
)
from fbn_common.motion_ekf.measure import deviation_waves
from fbn_common.motion_ekf.propagate import rotation_of
from fbn_common.records import PingMotion, Pose
from fbn_common.types import Array
from fbn_deadreck.dead_service import earth_covariance, lasting_errors, pushed
from fbn_deadreck.estimator import Deadreck
from fbn_predict.twin import Arrivals, Twin, on_time

Sailed = Callable[[Arrivals], tuple[list[Output], Deadreck]]


def pings(outputs: list[Output]) -> list[PingMotion]:
    return [o.record for o in outputs if isinstance(o.record, PingMotion)]


def state(pose: Pose) -> Array:
    """A filter state with this pose."""
    x = np.zeros(X_SIZE)
    x[:3] = pose.position
    x[X_ROTATION : X_ROTATION + 9] = matrix_from_quaternion(pose.orientation).ravel()
    return x


def chained(covariance: Array, before: PingMotion, step: PingMotion) -> Array:
    """Covariance (6, 6) of the pose after one increment of the chain."""
    x, rotation = state(before.pose), matrix_from_quaternion(step.increment.orientation)
    f = pushed(x, step.increment.position, rotation)
    g = np.eye(6)
    g[:3, :3] = matrix_from_quaternion(before.pose.orientation)
    return f @ covariance @ f.T + g @ step.increment_covariance @ g.T


def test_every_ping_is_answered_once_and_the_chain_has_no_gap(
    voyage: tuple[list[Output], Deadreck], twin: Twin
) -> None:
    chain = pings(voyage[0])
    assert len(chain) >= 120
    assert chain[0].previous_ns == chain[0].stamp_ns
    assert all(b.previous_ns == a.stamp_ns for a, b in pairwise(chain))


def test_the_chain_reproduces_the_filters_covariance_of_z_roll_pitch_yaw(voyage: tuple[list[Output], Deadreck]) -> None:
    chain = pings(voyage[0])
    start = np.linalg.inv(chain[0].earth_information)
    np.testing.assert_allclose(start, chain[0].earth_covariance, rtol=1e-9)
    earth = chain[0].earth_covariance
    for before, after in pairwise(chain):
        pose = np.eye(6) * 1e-12  # x and y do not reach z and attitude
        to_body = np.linalg.inv(earth_jacobian(before.pose))
        pose[2:, 2:] = to_body @ earth @ to_body.T
        predicted = earth_covariance(state(after.pose), chained(pose, before, after))
        earth = np.linalg.inv(np.linalg.inv(predicted) + after.earth_information)
        scale = np.sqrt(np.diagonal(after.earth_covariance))
        np.testing.assert_allclose(
            earth / np.outer(scale, scale), after.earth_covariance / np.outer(scale, scale), atol=0.01
        )


def earth_jacobian(pose: Pose) -> Array:
    from fbn_common.lie import rpy_from_matrix, rpy_jacobian

    j = np.eye(4)
    j[1:, 1:] = rpy_jacobian(rpy_from_matrix(matrix_from_quaternion(pose.orientation)))
    return j


def test_composed_increments_give_the_filters_poses(voyage: tuple[list[Output], Deadreck]) -> None:
    for before, after in pairwise(pings(voyage[0])):
        rotation = matrix_from_quaternion(before.pose.orientation)
        np.testing.assert_allclose(
            before.pose.position + rotation @ after.increment.position, after.pose.position, atol=1e-9
        )


@pytest.mark.parametrize("horizon_s", [10.0, 20.0, 40.0])
def test_relative_position_grows_as_the_filters_own(sailed: Sailed, twin: Twin, horizon_s: float) -> None:
    # A straight leg: the filter's own growth is P carried on with the pose set exact; the chain's is white noise
    # and drift.  Horizontal variances agree within 20 %.
    outputs, deadreck = sailed([a for a in on_time(twin) if a[0] < twin.stamp_ns[0] + 50_500_000_000])
    chain = pings(outputs)
    after = [p for p in chain if p.stamp_ns <= chain[-1].stamp_ns][-12:]
    n = round(horizon_s / 0.703)
    white = np.mean([p.increment_covariance for p in after], axis=0)
    t = n * 0.703
    rotation = matrix_from_quaternion(after[-1].pose.orientation)
    drift = after[-1].drift_covariance
    j = np.column_stack((np.eye(3)[:, :2], rotation[:, 0])) * t
    own = n * rotation @ white[:3, :3] @ rotation.T + j @ drift @ j.T
    expected = own_growth(deadreck, t)
    assert np.trace(own[:2, :2]) == pytest.approx(np.trace(expected[:2, :2]), rel=0.2)


def own_growth(deadreck: Deadreck, seconds: float) -> Array:
    """Covariance (3, 3) of position after so long, from a pose known exactly, by repeating the last motion."""
    ekf = deadreck.ekf
    t, x, p, sensors = ekf.state.copy()
    p[:6, :] = 0.0
    p[:, :6] = 0.0
    p[:6, :6] = 1e-12 * np.eye(6)
    before = State(t - 500_000_000, x, p, sensors)
    start = x.copy()
    for _ in range(round(seconds / 0.5)):  # the last half second, again and again
        after = ekf.open_loop(before, t)
        after.x[X_ROTATION : X_ROTATION + 9] = start[X_ROTATION : X_ROTATION + 9]  # straight on
        after.covariance[3:6, :] = 0.0
        after.covariance[:, 3:6] = 0.0
        after.covariance[3:6, 3:6] = 1e-12 * np.eye(3)
        before = State(t - 500_000_000, after.x, after.covariance, after.sensors)
    return before.covariance[:3, :3]


def test_no_information_comes_from_a_direction_that_lost_it() -> None:
    before, after = np.diag([1.0, 1.0, 4.0]), np.diag([0.5, 2.0, 4.0])
    np.testing.assert_allclose(gained_information(before, after), np.diag([1.0, 0.0, 0.0]), atol=1e-12)


def test_pings_of_two_arrays_at_one_stamp_get_one_answer(sailed: Sailed, twin: Twin) -> None:
    arrivals = [a for a in on_time(twin) if a[0] < twin.stamp_ns[0] + 8_000_000_000]
    twice = sorted([*arrivals, *(a for a in arrivals if a[1] == "sonar/detections")], key=lambda a: a[0])
    stamps = [p.stamp_ns for p in pings(sailed(twice)[0])]
    assert len(stamps) == len(set(stamps)) > 3


def test_each_ping_states_the_compass_deviation_and_all_of_yaws_doubt_is_more(
    voyage: tuple[list[Output], Deadreck],
) -> None:
    """The deviation is considered, never estimated: what the parameter says, but for the coefficients' mixture."""
    deviation = voyage[1].own.compass.deviation
    for ping in pings(voyage[0]):
        assert ping.heading_deviation == pytest.approx(deviation, rel=0.1)
        assert ping.earth_covariance[3, 3] > 0.8 * ping.heading_deviation**2


def test_lasting_errors_are_those_of_the_ground_velocity_at_the_true_heading(
    voyage: tuple[list[Output], Deadreck],
) -> None:
    """Errors drawn from the filter's covariance, small, put through the definition: what the increments lack at the
    true heading, and how far that is from the stated one.  Linear to 1e-3 of the sigmas, as small as they are drawn."""
    deadreck, rng, small = voyage[1], np.random.default_rng(4), 1e-3
    t, x, p, sensors = deadreck.ekf.state.copy()
    x[X_PARAMETERS + 12 : X_PARAMETERS + 14] = [0.3, -0.2]  # m/s of current, so that turning it counts
    stated = lasting_errors(State(t, x, p, sensors))
    at = [DAMPING, THRUST, WATER, WATER + 1, *range(DEVIATION, DEVIATION + 5)]
    errors = small * rng.multivariate_normal(np.zeros(9), p[np.ix_(at, at)], 4000, method="cholesky")
    R = rotation_of(x)
    water, through = x[X_PARAMETERS + 12 : X_PARAMETERS + 15], R.T @ x[X_PARAMETERS + 12 : X_PARAMETERS + 15]
    speed, waves = x[X_VELOCITY] - through[0], deviation_waves(R)
    drawn = np.empty((len(errors), 4))
    for row, e in zip(drawn, errors, strict=True):
        yaw = -waves @ e[4:]  # the compass's reading stays: yaw and deviation err against one another
        true = matrix_from_rpy(np.array([0.0, 0.0, yaw])) @ R
        ratio = (1.0 + e[1] / x[X_PARAMETERS + 9]) / (1.0 + e[0] / x[X_PARAMETERS + 3])
        lacks = true @ np.array([speed * (ratio - 1.0), 0.0, 0.0])  # forward, of the body
        over_ground = water + np.array([e[2], e[3], 0.0]) - true @ through  # of the water, at the true heading
        row[:] = *over_ground[:2], (true.T @ lacks)[0], yaw
    covariance = drawn.T @ drawn / len(drawn) / small**2
    ours = np.zeros((4, 4))
    ours[:3, :3], ours[3, 3], ours[3, :3], ours[:3, 3] = (
        stated.drift, stated.heading**2, stated.heading_drift, stated.heading_drift,
    )  # fmt: skip
    sigma = np.sqrt(np.diag(ours))
    # a covariance of 4000 draws is good to 1/sqrt(4000) = 1.6 %, of a variance to 2.2 %; four sigmas
    np.testing.assert_allclose(covariance / np.outer(sigma, sigma), ours / np.outer(sigma, sigma), atol=0.09)
