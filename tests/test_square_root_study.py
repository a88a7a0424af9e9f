"""Square root against information form, where the condition number and the answer are known."""

from __future__ import annotations

import numpy as np
import pytest

from fbn_common.types import Array
from fbn_testing.feature_runs import hear
from fbn_testing.square_root import (
    corner_by_cholesky,
    corner_by_qr,
    errors,
    information_condition,
    inverse,
    reference_corner,
    root_conditions,
)
from fbn_testing.square_root_study import examine, linearised, windows

M, N, KEPT = 60, 24, 7


def system(condition: float) -> tuple[Array, Array]:
    """A Jacobian (M, N) of this condition number, and the exact covariance of its last variables."""
    rng = np.random.default_rng(1)
    U, V = (np.linalg.qr(rng.normal(size=(n, N)))[0] for n in (M, N))
    s = np.geomspace(1.0, 1.0 / condition, N)
    return (U * s) @ V.T, ((V / s**2) @ V.T)[-KEPT:, -KEPT:]


def test_all_ways_give_the_known_covariance_and_condition_numbers() -> None:
    A, exact = system(1e3)
    assert root_conditions(A)[0] == pytest.approx(1e3, rel=1e-9)  # eps * 1e3 and some
    assert information_condition(A, np.float64) == pytest.approx(1e6, rel=1e-6)  # eps * 1e6 and some
    corners = (reference_corner(A, KEPT), corner_by_qr(A, KEPT, np.float64), corner_by_cholesky(A, KEPT, np.float64))
    for corner in corners:
        S = inverse(corner)
        assert np.allclose((S @ S.T).astype(float), exact, rtol=0.0, atol=1e-8 * np.abs(exact).max())  # as above


def test_the_reference_is_beyond_double_precision() -> None:
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no extended precision on this machine")
    A, _ = system(1e3)
    corner = reference_corner(A, N)  # all of R
    apart = corner.T @ corner - A.astype(np.longdouble).T @ A.astype(np.longdouble)
    assert np.abs(apart).max() < 100 * np.finfo(np.longdouble).eps  # entries of A^T A are at most 1; 24 reflections


def test_single_precision_loses_the_condition_number_by_qr_and_its_square_by_cholesky() -> None:
    A, _ = system(1e3)
    A = A.astype(np.float32).astype(float)  # so that only the arithmetic is in question
    S, eps = inverse(reference_corner(A, KEPT)), float(np.finfo(np.float32).eps)
    root, information = (errors(A, KEPT, S, by_qr, np.float32).worst for by_qr in (True, False))
    assert root < 20 * eps * 1e3  # 20: growth with the size; a variance has twice the error of its root
    assert information > 0.01 * eps * 1e6 > root  # a hundredth: rounding errors average out


def test_where_the_information_matrix_is_singular_to_rounding_the_square_root_still_stands() -> None:
    A, _ = system(1e5)
    A = A.astype(np.float32).astype(float)
    S = inverse(reference_corner(A, KEPT))
    root, information = (errors(A, KEPT, S, by_qr, np.float32) for by_qr in (True, False))
    assert not root.failed and root.worst < 20 * np.finfo(np.float32).eps * 1e5
    assert information.failed or information.worst > 0.5  # 1e10 is more than 1 / eps


@pytest.mark.campaign
def test_on_the_trackers_own_windows_the_information_form_is_never_the_better_one() -> None:
    for length, window in windows(hear("depth_of_features", 1000)):
        for case in examine(linearised(window), length):
            root, information = case.errors["square root"], case.errors["information"]
            assert not root.failed and (information.failed or information.worst > root.worst)
