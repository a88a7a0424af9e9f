"""The measurement model: axioms, and Jacobians against numerical derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbn_common.lie import matrix_from_rpy
from fbn_common.sonar import cartesian, polar
from fbn_tracking.geometry import (
    anchored_observation,
    cartesian_jacobian,
    elevation_shape,
    finite_slope,
    observe,
    polar_jacobian,
    theta_from_u,
    u_from_theta,
    world_point,
)

HALF_LOBE = 0.1745
places = st.tuples(st.floats(1.0, 60.0), st.floats(0.3, 2.8), st.floats(-1.0, 1.0))
angles = st.tuples(st.floats(-3.0, 3.0), st.floats(-1.2, 1.2), st.floats(-3.0, 3.0))


def numeric(function, x, step=1e-6):
    """Central differences: error of order step^2 f''' and 1e-16 f / step, so about 1e-9 of values of 10."""
    x = np.asarray(x, float)
    columns = [(function(x + step * d) - function(x - step * d)) / (2 * step) for d in np.eye(len(x))]
    return np.array(columns).T


@given(places)
def test_polar_and_cartesian_undo_each_other(q):
    q = np.array(q)
    point, _ = cartesian_jacobian(q)
    np.testing.assert_allclose(point, cartesian(*q), atol=1e-12)
    np.testing.assert_allclose(polar_jacobian(point)[0], q, atol=1e-9)
    np.testing.assert_allclose(polar_jacobian(point)[0], polar(point), atol=1e-9)


@given(places)
def test_jacobians_are_the_derivatives(q):
    q = np.array(q)
    np.testing.assert_allclose(cartesian_jacobian(q)[1], numeric(lambda x: cartesian_jacobian(x)[0], q), atol=1e-6)
    point, _ = cartesian_jacobian(q)
    np.testing.assert_allclose(polar_jacobian(point)[1], numeric(lambda x: polar_jacobian(x)[0], point), atol=1e-6)


@given(places, angles)
def test_a_world_point_is_seen_where_it_was_put(q, rpy):
    R, p, q = matrix_from_rpy(np.array(rpy)), np.array([3.0, -2.0, 1.0]), np.array(q)
    point, _ = world_point(R, p, q)
    np.testing.assert_allclose(observe(R, p, point)[0], q, atol=1e-8)


@given(st.floats(-30.0, 30.0), st.sampled_from([1e-10, 1e-3, 2e-3, 1e-2]), st.booleans())
def test_theta_of_u_is_the_inverse(u, alpha, cubic):
    a, c = elevation_shape(HALF_LOBE, alpha, cubic)
    theta = theta_from_u(u, a, c)
    assert u_from_theta(theta, a, c) == pytest.approx(u, abs=1e-9)


@pytest.mark.parametrize("cubic", [True, False])
def test_the_edge_of_the_lobe_is_one_sigma(cubic):
    a, c = elevation_shape(HALF_LOBE, 2e-3, cubic)
    assert u_from_theta(HALF_LOBE, a, c) == pytest.approx(1.0, abs=1e-12)


def test_in_the_middle_of_the_lobe_the_finite_slope_reaches_from_edge_to_edge():
    a, c = elevation_shape(HALF_LOBE, 2e-3, True)
    assert finite_slope(0.0, 1.0, a, c) == pytest.approx(HALF_LOBE, rel=1e-9)
    assert finite_slope(0.0, 1.0, a, c) < 1.0 / a  # the local slope, which is of no use there


def test_for_small_sigmas_the_finite_slope_is_the_local_one():
    a, c = elevation_shape(HALF_LOBE, 2e-3, True)
    local = 1.0 / (a + 3 * c * 0.1**2)
    # the next term of the mean slope is sigma^2 / 6 times the third derivative: under 1e-6 of it here
    assert finite_slope(0.1, 1e-4, a, c) == pytest.approx(local, rel=1e-6)


def _se3(rpy, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix_from_rpy(np.array(rpy)), p
    return T


@given(places, angles, angles)
def test_an_anchored_feature_is_seen_as_its_world_point(q, rpy_a, rpy_j):
    T_a, T_j = _se3(rpy_a, [1.0, 2.0, -3.0]), _se3(rpy_j, [0.5, -1.0, -2.0])
    mount = _se3([0.1, 0.2, 0.3], [0.6, 0.1, 0.0])
    z, *_ = anchored_observation(T_a, T_j, mount, mount, np.array(q))
    point = (T_a @ mount @ np.array([*cartesian(*q), 1.0]))[:3]
    A = T_j @ mount
    np.testing.assert_allclose(z, polar(A[:3, :3].T @ (point - A[:3, 3])), atol=1e-7)
