"""The compass's deviation: what is known of yaw besides it, and what it does to a composite."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_world import World, corridor, play, simulate

from fbn_common.lie import (
    matrix_from_quaternion,
    matrix_from_rpy,
    quaternion_from_matrix,
    rpy_from_matrix,
    so3_exp,
)
from fbn_common.records import Pose
from fbn_tracking.estimator import Tracking
from fbn_tracking.heading import (
    carried,
    deviation_variance,
    drift_prior,
    given_deviation,
    information_given_deviation,
    regression,
    turned,
    turned_prior,
)
from fbn_tracking.window import Base

DEVIATION = 0.026


@pytest.fixture(scope="module")
def pings():
    """Two pings of a pitching, turning vehicle."""
    motions = simulate(World(corridor(2), yaw_rate=0.2, pitch=0.2), 5, 1001).motions
    covariance = np.diag([0.05, 0.01, 0.012, 0.03]) ** 2
    covariance[1, 3] = covariance[3, 1] = 1e-5
    return [replace(m, earth_covariance=covariance) for m in motions[2:4]]


def test_a_chain_of_increments_and_information_has_the_covariance_given_the_deviation(pings):
    before, after = pings
    white = np.diag([0.02, 0.02, 0.02, 0.01, 0.01, 0.03]) ** 2  # more than a ping leaves unknown: all is learnt anew
    known = given_deviation(before.earth_covariance, DEVIATION**2)
    predicted = carried(before, after, known, white)
    information = information_given_deviation(before, after, white, DEVIATION**2)
    chained = np.linalg.inv(np.linalg.inv(predicted) + information)
    expected = given_deviation(after.earth_covariance, DEVIATION**2)
    np.testing.assert_allclose(chained, expected, rtol=1e-9, atol=1e-15)


def test_carrying_is_the_derivative_of_carrying(pings):
    before, after = pings
    R_step = matrix_from_quaternion(after.increment.orientation)

    def ahead(earth, error):
        R = matrix_from_rpy(np.ascontiguousarray(earth[1:]))
        z = earth[0] + (R @ (after.increment.position + error[:3]))[2]
        return np.array([z, *rpy_from_matrix(np.ascontiguousarray(R @ R_step @ so3_exp(error[3:])))])

    R0 = matrix_from_quaternion(before.pose.orientation)
    earth = np.array([0.0, *rpy_from_matrix(np.ascontiguousarray(R0))])
    end = matrix_from_quaternion(before.pose.orientation) @ R_step
    after = replace(after, pose=Pose(after.pose.position, quaternion_from_matrix(np.ascontiguousarray(end))))
    h = 1e-6
    F = np.array([(ahead(earth + d, np.zeros(6)) - ahead(earth - d, np.zeros(6))) / (2 * h) for d in h * np.eye(4)]).T
    G = np.array([(ahead(earth, d) - ahead(earth, -d)) / (2 * h) for d in h * np.eye(6)]).T
    covariance, white = before.earth_covariance, np.diag([0.02, 0.03, 0.04, 0.004, 0.005, 0.03]) ** 2
    # central differences are good to h^2 and rounding / h, some 1e-9 of a derivative of at most 1
    np.testing.assert_allclose(
        carried(before, after, covariance, white), F @ covariance @ F.T + G @ white @ G.T, atol=1e-9
    )


def test_no_more_deviation_is_taken_off_than_there_is():
    tight = np.diag([0.05, 0.01, 0.01, 0.01]) ** 2
    assert deviation_variance(tight, DEVIATION) == pytest.approx(0.9 * 0.01**2)
    assert np.linalg.eigvalsh(given_deviation(tight, DEVIATION**2)).min() > 0.0
    assert deviation_variance(tight, 0.0) == 0.0


def test_the_whole_composite_turns_about_its_base():
    rng = np.random.default_rng(0)
    mean = rng.normal(size=16) * 10.0
    angle = 1e-5
    R = np.array([[1.0, -angle], [angle, 1.0]])
    moved = mean.copy()
    moved[[3, 9]] += angle
    moved[4:6], moved[10:12] = R @ mean[4:6], R @ mean[10:12]
    expected = np.outer(moved - mean, moved - mean)
    base = Base(np.eye(4), np.zeros(7), np.eye(7), True, angle**2)
    np.testing.assert_allclose(turned(mean, np.zeros((16, 16)), base)[1], expected, atol=1e-16)


def test_what_a_window_learns_of_the_drift_tells_of_the_deviation_as_their_joint_gaussian_says(pings):
    """GPS on one heading learnt the two together; then the drift alone is measured, and all else that turns is known.

    Independent computation: the Kalman update of (drift, deviation) by that measurement.
    """
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4)) * np.array([[0.05], [0.04], [0.02], [DEVIATION]])
    joint = root @ root.T  # drift 3, deviation
    motion = replace(
        pings[0],
        drift_covariance=joint[:3, :3],
        heading_deviation=float(np.sqrt(joint[3, 3])),
        heading_drift=joint[:3, 3],
    )
    noise, seen = np.diag([0.01, 0.02, 0.02]) ** 2, np.array([0.03, -0.05, 0.01])
    gain = joint[:, :3] @ np.linalg.inv(joint[:3, :3] + noise)
    expected, left = gain @ seen, joint - gain @ joint[:3]

    prior = np.zeros((7, 7))
    prior[4:, 4:] = drift_prior(motion)
    base = Base(np.eye(4), np.zeros(7), prior, False, float(joint[3, 3]), regression(motion, float(joint[3, 3])))
    mean, covariance = np.zeros(13), np.zeros((13, 13))
    mean[4:6], mean[-3:], covariance[-3:, -3:] = [20.0, 5.0], expected[:3], left[:3, :3]
    out, spread = turned(mean, covariance, base)
    # the prior's 1e-8 m^2/s^2, which keep it invertible, are 1e-4 of the least variance here
    np.testing.assert_allclose(out[[3, 9]], expected[3], rtol=1e-3)
    np.testing.assert_allclose(out[4:6] - mean[4:6], expected[3] * np.array([-5.0, 20.0]), rtol=1e-3)
    np.testing.assert_allclose(spread[3, 3], left[3, 3], rtol=1e-3)
    np.testing.assert_allclose(spread[3, -3:], left[3, :3], rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(turned_prior(base)[3:, 3:][:, [1, 2, 3, 0]][[1, 2, 3, 0]], joint, rtol=1e-3, atol=2e-8)


def test_a_correlation_beyond_one_is_taken_for_one(pings):
    """A rounding of the publisher's must not make a variance negative."""
    motion = replace(pings[0], heading_deviation=DEVIATION, heading_drift=np.array([1.1 * DEVIATION * 0.1, 0.0, 0.0]))
    by_drift = regression(motion, DEVIATION**2)
    assert by_drift @ drift_prior(motion) @ by_drift == pytest.approx(DEVIATION**2)


def test_features_do_not_average_the_deviation_away():
    run = simulate(World(corridor(8), period=0.5, detection_probability=0.95, deviation=DEVIATION), 160, 1004)
    composites = [o.record for o in play(Tracking(), run) if o.topic == "tracking/composite"]
    assert any(len(c.features) >= 3 for c in composites)
    for c in composites:
        assert c.covariance[3, 3] > DEVIATION**2 < c.covariance[9, 9]
        assert c.prior_covariance[3, 3] > DEVIATION**2
        assert np.linalg.eigvalsh(c.covariance).min() > -1e-9
