"""Infants: likeliest place with the poses fixed, slack for the drift, two elevations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from fbn_common.lie import matrix_from_rpy
from fbn_common.sonar import FRAME_BASE_LEVEL, polar
from fbn_tracking.gating import predict_points
from fbn_tracking.geometry import elevation_shape, world_point
from fbn_tracking.infants import cholesky_solve, fit, spread, symmetric_inverse

NONE3, SHAPE = np.zeros((3, 3)), elevation_shape(0.1745, 2e-3, True)


def _track(target, noise, seed=0, drift=(0.0, 0.0), n=12):
    """Arrays on a slightly pitching way along x, their echoes of one target, and the times."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 1.0
    R = np.array([matrix_from_rpy(np.array([0.0, 0.04 * np.sin(0.7 * k), 0.0])) @ FRAME_BASE_LEVEL for k in t])
    p = np.column_stack((0.8 * t, np.zeros(n), np.full(n, -2.0)))
    true_p = p + np.column_stack((np.outer(t, drift), np.zeros(n)))
    z = np.empty((n, 6))
    for k in range(n):
        r, phi, _ = polar(R[k].T @ (target - true_p[k]))
        z[k] = r + noise * 0.05 * rng.normal(), phi + noise * 0.0175 * rng.normal(), 0.05, 0.0175, *SHAPE
    return np.ascontiguousarray(R), p, t, z


def _residuals(x, R, p, t, z, slack_sigma):
    point, _ = world_point(R[0], p[0], x[:3])
    rows = [x[3:] / slack_sigma]
    for k in range(len(t)):
        r, phi, theta = polar(R[k].T @ (point - p[k] - np.array([x[3], x[4], 0.0]) * t[k]))
        rows.append([(r - z[k, 0]) / 0.05, (phi - z[k, 1]) / 0.0175, SHAPE[0] * theta + SHAPE[1] * theta**3])
    return np.concatenate(rows)


@pytest.mark.parametrize("seed", range(5))
def test_the_place_is_that_of_an_independent_least_squares(seed):
    R, p, t, z = _track(np.array([25.0, 2.0, -4.0]), 1.0, seed)
    start = np.array([z[0, 0], z[0, 1], 0.1])
    _, H, energy, _ = fit(start, R, p, t, z, np.eye(2) / 0.05**2, np.zeros(3), NONE3)
    other = least_squares(_residuals, np.array([*start, 0, 0]), args=(R, p, t, z, 0.05), xtol=1e-14, ftol=1e-14)
    assert energy == pytest.approx(2 * other.cost, rel=1e-4)  # stops at changes of 1e-5 of the energy
    np.testing.assert_allclose(H, other.jac.T @ other.jac, rtol=0.05, atol=0.02 * np.abs(H).max())


def test_either_start_finds_its_own_elevation():
    R, p, t, z = _track(np.array([20.0, 1.0, -4.0]), 0.0)
    found = [fit(np.array([z[0, 0], z[0, 1], s]), R, p, t, z, 1e6 * np.eye(2), np.zeros(3), NONE3) for s in (0.1, -0.1)]
    (down, _, e_down, _), (up, _, e_up, _) = found
    assert down[2] > 0.05 and e_down < e_up
    assert up[2] < 0.0 or up[2] == pytest.approx(down[2], abs=1e-3)  # from a pitching vehicle the wrong side may vanish


def test_a_drift_inside_its_prior_is_not_taken_for_the_targets_motion():
    target, drift = np.array([25.0, 2.0, -3.0]), (0.15, -0.1)
    R, p, t, z = _track(target, 0.0, drift=drift)
    start = np.array([z[0, 0], z[0, 1], 0.05])
    free = fit(start, R, p, t, z, np.eye(2) / 0.2**2, np.zeros(3), NONE3)
    held = fit(start, R, p, t, z, np.eye(2) / 0.001**2, np.zeros(3), NONE3)
    assert free[3] < 5.0 < 100.0 < held[3]
    np.testing.assert_allclose(free[0][3:], drift, atol=0.05)


def test_one_echo_reaches_over_the_whole_lobe():
    R, p, t, z = _track(np.array([25.0, 0.0, -2.0]), 0.0, n=1)
    x, H, *_ = fit(np.array([z[0, 0], z[0, 1], 0.0]), R, p, t, z, np.eye(2) / 0.01, np.zeros(3), NONE3)
    _, covariance = spread(x, H, R[0], p[0], *SHAPE)
    # one sigma of u is the edge of the lobe: 10 degrees at 25 m
    assert np.sqrt(covariance[2, 2]) == pytest.approx(25.0 * 0.1745, rel=0.01)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.05, rel=0.01)


def test_hand_made_linear_algebra_is_right():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(5, 5))
    H, g = A @ A.T + np.eye(5), rng.normal(size=5)
    np.testing.assert_allclose(cholesky_solve(H, g), np.linalg.solve(H, g), rtol=1e-10)
    np.testing.assert_allclose(symmetric_inverse(H), np.linalg.inv(H), rtol=1e-9, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_gives_nan_not_nonsense():
    assert np.isnan(cholesky_solve(-np.eye(2), np.ones(2))).all()


def test_the_prediction_goes_with_the_slack_that_was_found():
    """Once the slack widened the gate but did not move its middle, and tracks were lost to a current."""
    R, p, t, z = _track(np.array([25.0, 2.0, -3.0]), 0.0, drift=(0.15, -0.1), n=13)
    x, H, *_ = fit(
        np.array([z[0, 0], z[0, 1], 0.05]), R[:12], p[:12], t[:12], z[:12], np.eye(2) / 0.2**2, np.zeros(3), NONE3
    )
    point, covariance = spread(x, H, R[0], p[0], *SHAPE)
    predicted, S = predict_points(
        point[None], x[None, 3:], covariance[None], t[12:], np.zeros((1, 2)), R[12], p[12], *SHAPE
    )
    # the fit of echoes without noise misses the next one by what the priors on slack and lobe pull: under a sigma
    assert abs(predicted[0, 0] - z[12, 0]) < np.sqrt(S[0, 0, 0] + 0.05**2)
    assert abs(predicted[0, 0] - z[12, 0]) < 0.1 < 0.15 * 12
