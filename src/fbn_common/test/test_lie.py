"""Rotations against the axioms, numerical derivatives and an independent library (scipy)."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fbn_common import lie
from fbn_common.types import Array

COMPONENT = st.floats(-1.8, 1.8)  # |theta| < 3.12: inside the ball of radius pi, where Log is one to one
ANGLE = st.floats(-3.1, 3.1)
VECTORS = st.builds(lambda x, y, z: np.array([x, y, z]), COMPONENT, COMPONENT, COMPONENT)
SMALL = st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-5, 1e-4, 1e-3])
NEAR_ZERO = st.builds(lambda v, s: v * s, VECTORS, SMALL)
THETAS = st.one_of(VECTORS, NEAR_ZERO)
PITCH = st.floats(-1.5, 1.5)
RPYS = st.builds(lambda r, p, y: np.array([r, p, y]), ANGLE, PITCH, ANGLE)


@given(THETAS)
def test_exp_agrees_with_an_independent_implementation(theta: Array) -> None:
    np.testing.assert_allclose(lie.so3_exp(theta), Rotation.from_rotvec(theta).as_matrix(), atol=1e-12)


@given(THETAS)
def test_log_undoes_exp(theta: Array) -> None:
    # near pi the conditioning of Log through the quaternion is benign: a few eps
    np.testing.assert_allclose(lie.so3_log(lie.so3_exp(theta)), theta, atol=1e-9)


def test_log_is_defined_at_half_a_turn_about_every_axis() -> None:
    for axis in np.eye(3):
        theta = lie.so3_log(lie.so3_exp(np.pi * axis))
        np.testing.assert_allclose(np.abs(theta), np.pi * axis, atol=1e-7)


@given(THETAS, VECTORS)
def test_exp_of_opposite_vectors_are_inverse(theta: Array, v: Array) -> None:
    np.testing.assert_allclose(lie.so3_exp(theta) @ lie.so3_exp(-theta) @ v, v, atol=1e-12)


@given(THETAS, VECTORS)
def test_right_jacobian_is_the_derivative_of_exp(theta: Array, direction: Array) -> None:
    h = 1e-6  # central difference: error h^2 / 6 |third derivative| < 1e-11, rounding eps / h = 2e-10
    plus, minus = lie.so3_exp(theta + h * direction), lie.so3_exp(theta - h * direction)
    numeric = lie.so3_log(np.ascontiguousarray(minus.T @ plus)) / (2 * h)
    jr = lie.so3_right_jacobian(np.asarray(theta, float))
    np.testing.assert_allclose(jr @ direction, numeric, atol=2e-5)


@given(THETAS)
def test_right_jacobian_inverse_is_its_inverse(theta: Array) -> None:
    product = lie.so3_right_jacobian(theta) @ lie.so3_right_jacobian_inverse(theta)
    np.testing.assert_allclose(product, np.eye(3), atol=1e-8)


@given(RPYS)
def test_roll_pitch_yaw_round_trip(rpy: Array) -> None:
    np.testing.assert_allclose(lie.rpy_from_matrix(lie.matrix_from_rpy(rpy)), rpy, atol=1e-9)


@given(RPYS)
def test_roll_pitch_yaw_are_the_fixed_axis_angles_of_ros(rpy: Array) -> None:
    np.testing.assert_allclose(lie.matrix_from_rpy(rpy), Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-12)


def test_positive_pitch_lowers_the_bow_and_positive_yaw_turns_left() -> None:
    bow = np.array([1.0, 0, 0])
    assert (lie.matrix_from_rpy(np.array([0, 0.1, 0])) @ bow)[2] < 0
    assert (lie.matrix_from_rpy(np.array([0, 0, 0.1])) @ bow)[1] > 0


@given(RPYS, VECTORS)
def test_rpy_jacobian_is_the_derivative_of_the_angles(rpy: Array, direction: Array) -> None:
    rpy = rpy * np.array([1.0, 0.8, 1.0])  # pitch within 1.2 rad, away from the singularity
    h, rotation = 1e-6, lie.matrix_from_rpy(rpy)
    plus = lie.rpy_from_matrix(rotation @ lie.so3_exp(h * direction))
    minus = lie.rpy_from_matrix(rotation @ lie.so3_exp(-h * direction))
    numeric = (plus - minus + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(lie.rpy_jacobian(rpy) @ direction, numeric / (2 * h), atol=1e-6)


@given(THETAS)
def test_quaternion_round_trip_with_positive_scalar(theta: Array) -> None:
    rotation = lie.so3_exp(theta)
    q = lie.quaternion_from_matrix(rotation)
    assert q[3] >= 0
    np.testing.assert_allclose(lie.matrix_from_quaternion(q), rotation, atol=1e-12)


@given(st.floats(-100.0, 100.0))
def test_wrap_keeps_the_direction_and_lands_in_the_half_open_interval(angle: float) -> None:
    wrapped = lie.wrap(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-12)
