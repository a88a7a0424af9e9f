"""The other elevation of what is shown: where a thing may lie instead, and how likely that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_world import World, play, simulate

from fbn_common.records import Stage
from fbn_tracking.estimator import Tracking
from fbn_tracking.geometry import observe
from fbn_tracking.modes import Surroundings
from fbn_tracking.parameters import FeatureParameters
from fbn_tracking.publish import rival_of, tracked_features
from fbn_tracking.track import Track

TARGET, DEPTH = np.array([30.0, 3.0, -4.0]), 2.0  # m: one over the bed, two under the vehicle


def _passage(pings: int) -> tuple[Tracking, Track]:
    """A level passage without noise, and the one track it made."""
    run = simulate(World(TARGET[None], pitch=0.0, detection_probability=1.0, noise=0.0, drift=(0, 0, 0)), pings, 1017)
    tracker = Tracking()
    play(tracker, run)
    (track,) = (t for t in tracker.tracks if t.memory is None)
    return tracker, track


def _feature() -> tuple[Track, np.ndarray, Surroundings]:
    """A feature that graduated with both elevations, its true r, phi, theta, and the poses."""
    tracker, track = _passage(14)
    window = tracker.window
    around = Surroundings(window.estimate.poses(), window.pings, np.zeros((2, 2)), tracker.parameters.feature)
    track.modes = [track.modes[0]] * 2
    return track, observe(*around.array(track.detections[0].look), TARGET)[0], around


def test_an_infant_is_shown_with_its_other_elevation_and_the_odds_of_that() -> None:
    tracker, track = _passage(5)
    mode, up = track.modes[0], np.array([0.0, 0.0, 3.0])
    track.modes = [mode, replace(mode, point=mode.point + up, cost=mode.cost + np.log(9.0))]  # one to nine
    (shown,) = tracked_features(tracker.window, tracker._nursery, None, 5, "odom").features
    assert shown.stage is Stage.INFANT and shown.rival_probability == pytest.approx(0.1)
    np.testing.assert_allclose(shown.rival_position - shown.position, up, atol=0.01)  # m: level to a few mrad


def test_what_ranges_leave_open_of_a_feature_is_as_likely_as_the_prior_of_heights_has_it() -> None:
    track, q, around = _feature()
    rival = rival_of(track, q, around)
    odds = (1.0 + (1.0 / 1.5) ** 2) / (1.0 + (5.0 / 1.5) ** 2)  # Cauchy at 1.5 m: one over the bed against five
    np.testing.assert_allclose(rival.point, [TARGET[0], TARGET[1], -2.0 * DEPTH - TARGET[2]], atol=0.05)
    # Poses smoothed to a mrad of pitch move u of either side by 0.02 apart, at 14 echoes: 0.1 of the log odds.
    assert rival.probability == pytest.approx(odds / (1.0 + odds), rel=0.1)


def test_what_has_one_elevation_or_an_unlikely_other_has_no_rival() -> None:
    track, q, around = _feature()
    bold = replace(around, feature=FeatureParameters(mode_gap=1.0))  # drops what is less likely than one to e
    assert rival_of(track, q, bold).probability == 0.0
    assert rival_of(track, q * np.array([1.0, 1.0, 0.0]), around).probability == 0.0  # amid the lobe both are one
    track.modes = track.modes[:1]
    assert rival_of(track, q, around).probability == 0.0
