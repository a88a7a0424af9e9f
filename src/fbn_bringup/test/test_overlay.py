"""What the report lays on the map: hypotheses, sweeps, and features that should have been seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fbn_bringup.evaluation.run import Run, collect
from fbn_bringup.report.overlay import overlays, stated_posterior
from fbn_common import records as r
from fbn_common.sweep import CELL, Raster, missed, swept


def told(story, tell, truth_of, rival: float) -> Run:
    """The story, with a second hypothesis of this posterior one place along the row: 20 s of way to the west."""
    items = []
    for log_ns, topic, record in tell(story()):
        if isinstance(record, r.MatchHypotheses):
            best, null = record.hypotheses
            pose = replace(best.pose, position=best.pose.position - np.array([16.0, 0.0, 0.0]))
            ids = tuple(m - 1 for m in best.map_ids)
            other = replace(best, id=2, posterior=rival, map_ids=ids, pose=pose)
            record = replace(record, hypotheses=(best, other, null))
        items.append((log_ns, topic, record))
    return collect(items, truth=truth_of(story()))


def test_each_likely_hypothesis_has_its_own_overlay_and_a_small_one_none(story, tell, truth_of):
    both = overlays(told(story, tell, truth_of, 0.3), most=3)
    assert [(o.dive, o.hypothesis) for o in both] == [(d, h) for d in (1, 2, 3) for h in (1, 2)]
    alone = overlays(told(story, tell, truth_of, 0.001), most=3)
    assert [o.hypothesis for o in alone] == [1, 1, 1]


def test_under_a_hypothesis_shifted_along_the_row_what_was_tracked_lies_there(story, tell, truth_of):
    best, other = overlays(told(story, tell, truth_of, 0.3), most=2)[2:4]  # of the second dive
    np.testing.assert_allclose(other.tracked_xy - best.tracked_xy, np.tile([-16.0, 0.0], (4, 1)), atol=1e-6)


def test_the_place_is_drawn_as_likely_as_the_status_says_not_as_any_one_hypothesis(story, tell, truth_of):
    run = told(story, tell, truth_of, 0.3)
    time, posterior = stated_posterior(run)
    statuses = run.of("global/status", r.LocalizationStatus)
    np.testing.assert_allclose(60e9 * time, [s.stamp_ns - run.start_ns for s in statuses], atol=1e3)
    assert posterior.tolist() == [s.posterior for s in statuses] and len(posterior) > 1


def composite(base: tuple[float, float], scans: np.ndarray, cell: float) -> r.CompositeMeasurement:
    area = r.SweptArea(cell, scans.shape[1], scans.shape[0], np.array([-10.0, 0.0]), scans.ravel())
    pose = r.Pose(np.array([*base, -2.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    empty = (np.zeros(13), np.eye(13), np.zeros(7), np.eye(7))
    return r.CompositeMeasurement(10, "odom", 0, 0, True, 2, 1.0, 300.0, (), area, *empty, pose, pose)


def test_sweeps_add_up_where_they_overlap_whatever_their_cells() -> None:
    """A grid of 1 m cells and one of 2 m over the same ground: each place of the raster has the scans of both."""
    fine, coarse = composite((10.0, 0.0), np.full((8, 8), 3.0), 1.0), composite((10.0, 0.0), np.full((4, 4), 5.0), 2.0)
    raster = swept([fine, coarse], lambda points: points[:, :2])
    assert raster is not None
    assert CELL == 2.0
    np.testing.assert_allclose(raster.scans, 8.0)
    np.testing.assert_allclose(raster.corner, [0.0, 0.0])
    assert swept([composite((0.0, 0.0), np.zeros((3, 3)), 1.0)], lambda points: points[:, :2]) is None


@pytest.mark.parametrize(("scans", "expected"), [(7.0, (0,)), (6.0, ())])
def test_a_feature_scanned_often_enough_and_not_seen_is_missed(scans: float, expected: tuple[int, ...]) -> None:
    raster = Raster(np.zeros(2), np.full((2, 2), scans))
    places = np.array([[1.0, 1.0], [3.0, 3.0], [50.0, 1.0]])  # unseen, seen, outside
    assert missed(raster, places, {1}) == expected
