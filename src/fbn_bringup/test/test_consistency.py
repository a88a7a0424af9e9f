"""NEES, NIS and their bands against closed forms and drawn samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from fbn_bringup.evaluation import consistency as c
from fbn_bringup.evaluation.series import innovations
from fbn_common.records import Innovation, Verdict


def test_nees_of_whitened_errors_is_their_squared_length():
    p = np.array([[4.0, 1.0], [1.0, 2.0]])
    e = np.array([[1.0, -2.0], [0.5, 0.0]])
    assert c.nees(e, np.stack([p, p])) == pytest.approx([x @ np.linalg.inv(p) @ x for x in e])


def test_a_covariance_that_is_not_positive_definite_gives_nan_and_is_left_out():
    squares = c.nees(np.ones((2, 1)), np.array([[[-1.0]], [[4.0]]]))
    assert np.isnan(squares[0]) and squares[1] == pytest.approx(0.25)
    assert c.consistency("x", squares, 1).samples == 1


def test_bands_are_those_of_chi_square():
    result = c.consistency("x", np.full(50, 3.0), 3)
    assert (result.low, result.high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 150) / 150))
    assert result.ratio == 1.0 and result.consistent


def test_samples_of_the_right_covariance_are_consistent_and_of_a_third_of_it_are_not():
    rng = np.random.default_rng(3)
    squares = (rng.standard_normal((2000, 3)) ** 2).sum(axis=1)
    right, proud = c.consistency("right", squares, 3), c.consistency("proud", 3 * squares, 3)
    # standard error of the share: sqrt(0.05 * 0.95 / 2000) = 0.005; four of them
    assert right.inside == pytest.approx(0.95, abs=0.02)
    assert right.consistent and not proud.consistent and proud.ratio == pytest.approx(3 * right.ratio)


def test_a_sensors_report_counts_verdicts_and_reasons():
    z = np.zeros(1)
    table = innovations("deadreck", "depth", [
        Innovation(1, "base_link", "depth", 1.0, 1, Verdict.USED, "", z, z + 1),
        Innovation(2, "base_link", "depth", 30.0, 1, Verdict.GATED, "outside its gate", z, z + 1),
        Innovation(3, "base_link", "depth", 0.0, 0, Verdict.REFUSED, "not finite", z, z),
        Innovation(4, "base_link", "depth", 0.0, 0, Verdict.REFUSED, "not finite", z, z),
    ])  # fmt: skip
    report = c.sensor_report(table)
    assert report.verdicts == {"USED": 1, "GATED": 1, "REFUSED": 2, "LATE": 0}
    assert report.reasons == {"not finite": 2, "outside its gate": 1}
    assert report.nis.samples == 1 and report.total == 4


def test_no_samples_give_no_statistics():
    assert c.consistency("x", np.zeros(0), 1) is None
    assert c.consistency("x", np.array([np.nan]), 1) is None
