"""What is known of an elevation, put into a joint covariance: nothing lost, nothing twice."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_world import World, play, simulate

from fbn_tracking.elevation import likelier_side, told
from fbn_tracking.estimator import Tracking
from fbn_tracking.geometry import observe
from fbn_tracking.modes import Surroundings

PLACE, ROW = slice(2, 5), 4  # outputs: two of others, then a place; variables: five, theta the last


@pytest.fixture
def system():
    """A root of five variables' covariance, and five outputs of which three are a place."""
    rng = np.random.default_rng(3)
    return rng.normal(size=(5, 5)), rng.normal(size=(5, 5))


def _covariance(root, J, spread):
    given, column, beyond = told(root, J, ROW, PLACE, spread)
    S = np.column_stack((J @ given, column))
    out = S @ S.T
    out[PLACE, PLACE] += beyond
    return out


def test_a_spread_that_says_what_the_system_says_changes_nothing(system):
    root, J = system
    P = root @ root.T
    J[PLACE, :ROW] *= 0.0  # then theta alone moves it, and its own derivative is that
    along = J[PLACE, ROW]
    spread = P[ROW, ROW] * np.outer(along, along)
    np.testing.assert_allclose(_covariance(root, J, spread), J @ P @ J.T, atol=1e-12)


def test_the_place_varies_as_given_theta_and_as_over_theta_together(system):
    root, J = system
    P, wide = root @ root.T, np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -2.0], [0.5, -2.0, 30.0]])
    given = P - np.outer(P[:, ROW], P[ROW]) / P[ROW, ROW]  # conditional covariance, by the textbook
    expected = (J @ given @ J.T)[PLACE, PLACE] + wide
    np.testing.assert_allclose(_covariance(root, J, wide)[PLACE, PLACE], expected, atol=1e-12)


def test_what_is_learnt_of_theta_narrows_the_others_and_ignorance_never_widens_them(system):
    root, J = system
    P, others = root @ root.T, slice(0, 2)
    before = np.diag(J @ P @ J.T)[others]
    known = np.diag(_covariance(root, J, 1e-12 * np.eye(3)))[others]
    given = P - np.outer(P[:, ROW], P[ROW]) / P[ROW, ROW]
    np.testing.assert_allclose(known, np.diag(J @ given @ J.T)[others], rtol=1e-4)
    np.testing.assert_allclose(np.diag(_covariance(root, J, 1e6 * np.eye(3)))[others], before, rtol=1e-12)


def test_the_joint_stays_positive(system):
    root, J = system
    for size in (1e-6, 1.0, 1e6):
        assert np.linalg.eigvalsh(_covariance(root, J, size * np.diag([1.0, 0.1, 0.01])))[0] > 0.0


def _around():
    """One target a metre over the floor, seen from a level passage: its track, what surrounds it, its true place."""
    target = np.array([30.0, 3.0, -4.0])
    run = simulate(World(target[None], pitch=0.0, detection_probability=1.0, noise=0.0, drift=(0, 0, 0)), 14, 1017)
    tracker = Tracking()
    play(tracker, run)
    (track,) = (t for t in tracker.tracks if t.memory is None)
    window = tracker.window
    around = Surroundings(window.estimate.poses(), window.pings, np.zeros((2, 2)), tracker.parameters.feature)
    R, p = around.array(track.detections[0].look)
    return track, around, observe(R, p, target)[0]


def test_a_place_that_swung_over_the_lobes_middle_is_put_back_where_it_stands_on_the_floor():
    track, around, q = _around()
    mirrored = q * np.array([1.0, 1.0, -1.0])  # a metre from the surface instead of one from the floor
    np.testing.assert_allclose(likelier_side(track, mirrored, around), q, atol=1e-12)
    np.testing.assert_array_equal(likelier_side(track, q, around), q)
