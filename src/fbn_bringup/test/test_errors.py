"""Errors of a run whose errors are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from fbn_bringup.evaluation.evaluate import error_tracks, evaluate, target_errors
from fbn_bringup.evaluation.run import RunError, collect
from fbn_bringup.evaluation.truth import TrueFeature, Truth
from fbn_common import records as r


def test_every_dive_is_found_with_its_length_and_depth(story, tell, truth_of):
    s = story()
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    assert [d.number for d in result.dives] == [1, 2, 3]
    # cut at the samples (0.2 s) where the depth changes
    assert [d.duration_s for d in result.dives] == pytest.approx([120.0] * 3, abs=0.41)
    assert [d.deepest_m for d in result.dives] == pytest.approx([2.0] * 3)


def test_drift_is_velocity_error_over_speed(story, tell, truth_of):
    s = story(drift=(0.03, 0.04))
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    percent = 100 * 0.05 / s.speed  # of constant velocities, wherever the leg is cut
    assert [d.deadreck.percent for d in result.dives] == pytest.approx([percent] * 3, rel=1e-6)
    assert result.mission_drift.percent == pytest.approx(percent, rel=1e-6)


def test_the_maps_own_displacement_is_not_an_error_on_the_map(story, tell, truth_of):
    s = story(map_shift=(6.0, -8.0), on_map=(0.3, 0.4))
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    assert [d.on_map_m for d in result.dives] == pytest.approx([0.5] * 3, abs=1e-9)
    assert result.dives[-1].absolute_m == pytest.approx(np.hypot(6.3, -7.6), abs=1e-9)


def test_reference_error_is_absolute(story, tell, truth_of):
    s = story(reference_error=(1.0, 0.5))
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    assert result.dives[0].reference_m == pytest.approx(np.hypot(1.0, 0.5), abs=1e-9)


def test_a_datum_from_a_first_fix_moves_truth_into_the_runs_map(story, tell, truth_of):
    s = story()
    moved = Truth((truth_of(s).datum[0] + 1e-4, *truth_of(s).datum[1:]), s.features())
    offset = moved.offset_to(r.Datum(0, "map", *truth_of(s).datum))
    # one minute of latitude is a nautical mile, within the ellipsoid's 0.5 %
    assert offset == pytest.approx([0.0, 1e-4 * 60 * 1852, 0.0], rel=5e-3, abs=1e-6)
    run = collect(tell(s), truth=moved)
    assert run.true_track.position[0] == pytest.approx(offset, abs=1e-9)
    assert run.truth.features[0].position == pytest.approx(s.features()[0].position + offset)


def test_the_targets_error_is_that_of_its_place_from_the_vehicle(story, tell, truth_of):
    s = story(on_map=(0.3, 0.4))
    _, errors, _ = target_errors(collect(tell(s), truth=truth_of(s)))
    assert len(errors) and errors == pytest.approx(np.tile([-0.3, -0.4, 0.0], (len(errors), 1)), abs=1e-9)


def test_without_truth_only_inner_consistency_is_said(story, tell):
    items = [item for item in tell(story()) if not item[1].startswith("truth")]
    result = evaluate(collect(items))
    assert not result.has_truth and not result.errors and result.mission_drift is None
    assert result.sensors and all(d.on_map_m is None for d in result.dives)


def test_surfacing_shows_dead_reckonings_drift_without_truth(story, tell):
    s = story(drift=(0.03, 0.04))
    items = [item for item in tell(s) if not item[1].startswith("truth")]
    found = evaluate(collect(items)).surfacings
    assert len(found) == 3
    # the fixes of the synthetic log lie on a sphere: 0.3 % of the way; dead reckoning sees its own, longer way
    way = np.hypot(s.speed + 0.03, 0.04)
    assert [f.percent for f in found] == pytest.approx([100 * 0.05 / way] * 3, abs=0.4)


def test_a_bag_without_estimates_is_refused_with_the_remedy(story, tell):
    items = [item for item in tell(story()) if item[1] in ("altitude", "gps/fix")]
    with pytest.raises(RunError, match="fbn replay"):
        evaluate(collect(items, name="log"))


def test_namespaces_are_taken_off(story, tell, truth_of):
    s = story()
    items = [(t, f"/ranger/{topic}", record) for t, topic, record in tell(s)]
    assert evaluate(collect(items, truth=truth_of(s))).dives[0].on_map_m == pytest.approx(0.5, abs=1e-9)


def test_error_series_keep_the_estimates_stamps(story, tell, truth_of):
    s = story()
    run = collect(tell(s), truth=truth_of(s))
    series = error_tracks(run).series["reference/odometry"]
    assert np.array_equal(series.track.stamp_ns, run.tracks["reference/odometry"].stamp_ns)
    assert np.abs(series.rotation).max() < 1e-12


def test_a_true_feature_that_the_map_lacks_has_no_map_id():
    truth = Truth((0, 0, 0), (TrueFeature(0, np.zeros(3), None, False), TrueFeature(1, np.ones(3), 7, True)))
    assert list(truth.on_map()) == [7]
