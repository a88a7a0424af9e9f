"""Every factor's Jacobian against numerical derivatives, and its residual against its own definition."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fbn_testing import gtsam_window as factors
from fbn_testing.gtsam_window import DRIFT, feature_key, pose_key
from fbn_tracking.factors import whitener

Z = np.array([20.0, 1.5, 0.05, 0.02, 0.3, 170.0])


def _pose(rng):
    return gtsam.Pose3(gtsam.Rot3.RzRyRx(*(0.4 * rng.normal(size=3))), 3.0 * rng.normal(size=3))


@pytest.fixture
def values():
    rng, values = np.random.default_rng(7), gtsam.Values()
    for index in range(3):
        values.insert(pose_key(index), _pose(rng))
    values.insert(DRIFT, rng.normal(size=3))
    values.insert(feature_key(1), np.array([20.0, 1.5, 0.1]))
    return values


def _cases():
    rng = np.random.default_rng(11)
    R = np.ascontiguousarray(gtsam.Rot3.RzRyRx(0.1, 0.2, 0.3).matrix())
    mounts = [np.ascontiguousarray(_pose(rng).matrix()) for _ in range(2)]
    yield "link", factors.link_factor(0, 1, rng.normal(size=3), R, 0.7, rng.normal(size=(6, 6)))
    yield "earth", factors.earth_factor(0, rng.normal(size=4), rng.normal(size=(4, 4)))
    yield "base", factors.base_factor(0, rng.normal(size=7), rng.normal(size=(7, 7)))
    yield "gauge", factors.gauge_factor(0, rng.normal(size=2))
    yield "first detection", factors.first_detection_factor(1, Z, 0.3)
    yield "detection", factors.detection_factor(0, 2, 1, *mounts, Z)
    yield "detection of another array of the same ping", factors.detection_factor(0, 0, 1, *mounts, Z)


def _moved(values, key, step):
    moved = gtsam.Values(values)
    if gtsam.symbolChr(key) == ord("x"):
        moved.update(key, values.atPose3(key).retract(step))
    else:
        moved.update(key, values.atPoint3(key) + step)
    return moved


def _numeric(factor, values, step=1e-6):
    columns = []
    for key in factor.keys():  # noqa: SIM118
        size = 6 if gtsam.symbolChr(key) == ord("x") else 3
        for d in step * np.eye(size):
            high, low = _moved(values, key, d), _moved(values, key, -d)
            columns.append((factor.unwhitenedError(high) - factor.unwhitenedError(low)) / (2 * step))
    return np.array(columns).T


@pytest.mark.parametrize(("name", "factor"), list(_cases()), ids=lambda x: x if isinstance(x, str) else "")
def test_the_jacobian_is_the_derivative(name, factor, values):
    linear = factor.linearize(values)
    A, b = (np.array(x) for x in linear.jacobian())
    # central differences of 1e-6: relative error about 1e-9 of the largest entry
    np.testing.assert_allclose(A, _numeric(factor, values), atol=1e-7 * np.abs(A).max())
    np.testing.assert_allclose(-b, factor.unwhitenedError(values), atol=1e-12)


def test_the_link_is_at_rest_where_pose_follows_pose_by_increment_and_drift():
    pose, drift, dt = gtsam.Pose3(gtsam.Rot3.Yaw(0.5), np.array([1.0, 2.0, -3.0])), np.array([0.1, -0.2, 0.05]), 2.0
    inc, R_inc = np.array([1.0, 0.1, 0.0]), np.ascontiguousarray(gtsam.Rot3.Yaw(0.2).matrix())
    R = pose.rotation().matrix()
    step = inc + (R.T @ np.array([0.1, -0.2, 0.0]) + np.array([0.05, 0, 0])) * dt
    values = gtsam.Values()
    values.insert(pose_key(0), pose)
    values.insert(pose_key(1), pose.compose(gtsam.Pose3(gtsam.Rot3(R_inc), step)))
    values.insert(DRIFT, drift)
    assert factors.link_factor(0, 1, inc, R_inc, dt, np.eye(6)).error(values) < 1e-28


def test_an_information_without_rank_gives_rows_that_say_nothing():
    information = np.diag([4.0, 0.0, 1.0, 0.0])
    W = whitener(information)
    np.testing.assert_allclose(W.T @ W, information, atol=1e-15)


def test_a_yaw_across_the_cut_is_a_small_residual():
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3(gtsam.Rot3.Yaw(np.pi - 0.01), np.zeros(3)))
    e = factors.earth_factor(0, np.array([0, 0, 0, -np.pi + 0.01]), np.eye(4)).unwhitenedError(values)
    np.testing.assert_allclose(e[3], -0.02, atol=1e-12)
