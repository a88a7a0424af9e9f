"""Negative information: chances in closed form, geometry by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from fbn_common.records import SweptArea
from fbn_global.negative import gather, gaussian_points, log_missed, missed, scan_counts


@pytest.mark.parametrize(
    ("scans", "visibility", "promotion"), [(0, 0.5, 1), (6, 0.7, 7), (7, 0.7, 7), (40, 0.3, 7), (20, 0.9, 2)]
)
def test_the_chance_to_miss_is_the_binomial_of_too_few_detections(
    scans: int, visibility: float, promotion: int
) -> None:
    expected = binom.cdf(promotion - 1, scans, visibility)
    np.testing.assert_allclose(missed(float(scans), visibility, promotion), expected, rtol=1e-9, atol=1e-15)


def test_between_whole_scans_the_chance_is_between() -> None:
    assert missed(10.0, 0.5, 5) > missed(10.5, 0.5, 5) > missed(11.0, 0.5, 5)


def test_the_points_of_the_ellipse_have_the_moments_of_a_gaussian_cut_at_95_percent() -> None:
    """Per axis, of a 2-D Gaussian within 95 %: 1 - 0.05 * 5.99 / (2 * 0.95) = 0.842; four rings give 4 % less."""
    points = gaussian_points()
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose((points**2).mean(axis=0), 0.842, rtol=0.06)


def an_area(scans: float) -> SweptArea:
    """20 x 20 m, its lower corner at the base."""
    return SweptArea(1.0, 20, 20, np.zeros(2), np.full(400, scans))


def test_scans_are_counted_where_the_feature_lies_relative_to_the_base() -> None:
    sweeps = gather((an_area(9.0),))
    inside = scan_counts(np.array([[[10.0, 10.0]]]), np.full((1, 1, 1, 1), 1.0) * np.eye(2), sweeps)
    outside = scan_counts(np.array([[[-10.0, 10.0]]]), np.full((1, 1, 1, 1), 1.0) * np.eye(2), sweeps)
    edge = scan_counts(np.array([[[0.0, 10.0]]]), np.full((1, 1, 1, 1), 1.0) * np.eye(2), sweeps)
    assert inside.min() == 9.0
    assert outside.max() == 0.0
    np.testing.assert_allclose(edge.mean(), 4.5, atol=1.5)


def log_chance(places: list[float], detected: list[bool], existence: float = 0.8, floor: float = 1e-9) -> float:
    sweeps = gather(tuple(an_area(30.0) for _ in places))
    relative = np.array([[[x, 10.0] for x in places]])
    counts = scan_counts(relative, np.zeros((1, len(places), 2, 2)) + 0.01 * np.eye(2), sweeps)
    return float(log_missed(counts, np.array([detected]), np.array([0.67]), np.array([existence]), 7, floor)[0])


def test_a_feature_never_swept_says_nothing() -> None:
    assert log_chance([-30.0, -30.0], [False, False]) == 0.0


def test_a_feature_well_swept_and_not_seen_is_as_unlikely_as_its_absence() -> None:
    np.testing.assert_allclose(log_chance([10.0], [False]), np.log(0.2), rtol=1e-3)


def test_a_pass_in_which_it_was_seen_says_nothing_whatever_composite_saw_it() -> None:
    assert log_chance([10.0, 10.0], [False, True], existence=1.0) == 0.0


def test_a_later_pass_without_it_counts_although_it_was_seen_before() -> None:
    assert log_chance([10.0, -30.0, 10.0], [True, False, False], existence=1.0, floor=0.05) == pytest.approx(
        np.log(0.05), rel=1e-3
    )


def test_a_feature_half_likely_outside_the_sweep_is_missed_half_the_time() -> None:
    """The chance is averaged over its place, not taken of the mean number of scans (which would say 'surely seen')."""
    sweeps = gather((an_area(30.0),))
    counts = scan_counts(np.array([[[0.0, 10.0]]]), np.full((1, 1, 1, 1), 1.0) * np.eye(2), sweeps)
    chance = np.exp(log_missed(counts, np.zeros((1, 1), dtype=np.bool_), np.array([0.67]), np.array([1.0]), 7, 0.0)[0])
    np.testing.assert_allclose(chance, 0.5, atol=0.2)
