"""Markers and transforms say where things are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from visualization_msgs.msg import Marker

from fbn_common import records as r
from fbn_common.lie import matrix_from_quaternion, matrix_from_rpy, quaternion_from_matrix
from fbn_ros.markers import markers_of
from fbn_ros.overlay_markers import OverlayMarkers
from fbn_ros.tf import map_odom, odom_base, tf_message
from fbn_testing.examples import example

RNG = np.random.default_rng(3)


def odometry(frame: str, position: list[float], yaw: float) -> r.Odometry:
    q = quaternion_from_matrix(matrix_from_rpy(np.array([0.0, 0.0, yaw])))
    return r.Odometry(7, frame, "base_link", r.Pose(np.array(position), q), np.zeros(6), np.eye(6), np.eye(6))


def test_map_to_odom_carries_the_dead_reckoned_pose_onto_the_map() -> None:
    on_map, reckoned = odometry("map", [10.0, 20.0, -3.0], 1.0), odometry("odom", [1.0, 2.0, -3.0], 0.25)
    found = map_odom(on_map, reckoned)
    carried = found.pose.position + matrix_from_quaternion(found.pose.orientation) @ reckoned.pose.position
    assert carried == pytest.approx(on_map.pose.position)
    assert (found.parent, found.child, found.stamp_ns) == ("map", "odom", 7)


def test_a_transform_becomes_a_message_of_tf() -> None:
    tf2 = SimpleNamespace(TFMessage=lambda transforms: transforms)
    (stamped,) = tf_message(tf2, odom_base(odometry("odom", [1.0, 2.0, 3.0], 0.0)))
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("odom", "base_link")
    assert (stamped.transform.translation.y, stamped.transform.rotation.w) == (2.0, 1.0)


def test_features_are_drawn_at_their_places_after_the_old_ones_are_removed() -> None:
    record = example(r.TrackedFeatures, RNG, 3)
    first, *others = markers_of(record).markers
    assert first.action == Marker.DELETEALL
    spheres = [m for m in others if m.type == Marker.SPHERE]
    assert [m.pose.position.x for m in spheres] == [f.position[0] for f in record.features]
    assert len({(m.ns, m.id) for m in others}) == len(others)


def test_an_ellipsoid_spans_two_standard_deviations_each_way() -> None:
    feature = example(r.TrackedFeature, RNG)
    feature = r.TrackedFeature(1, r.Stage.FEATURE, 3, 0, 0, feature.position, np.diag([4.0, 1.0, 0.25]))
    sphere = markers_of(r.TrackedFeatures(0, "odom", 3, (feature,))).markers[1]
    assert sorted((sphere.scale.x, sphere.scale.y, sphere.scale.z)) == pytest.approx([2.0, 4.0, 8.0])


def test_a_line_leads_to_where_a_feature_may_lie_instead_and_none_to_what_has_no_rival() -> None:
    known = replace(example(r.TrackedFeature, RNG), rival_probability=0.0)
    open_ = replace(known, key=2, rival_probability=0.25, rival_position=known.position + np.array([0.0, 0.0, 3.0]))
    markers = markers_of(r.TrackedFeatures(0, "odom", 3, (known, open_))).markers[1:]
    (line,) = (m for m in markers if m.type == Marker.LINE_STRIP)
    here, there = line.points
    assert (here.x, here.y) == (there.x, there.y) and there.z - here.z == pytest.approx(3.0)


@pytest.mark.parametrize("kind", [r.FeatureMap, r.MatchHypotheses])
def test_the_map_and_the_hypotheses_are_drawn_with_labels(kind: type[r.Record]) -> None:
    markers = markers_of(example(kind, RNG, 2)).markers
    assert sum(m.type == Marker.TEXT_VIEW_FACING for m in markers[1:]) == 2


def test_other_records_are_not_drawn() -> None:
    assert markers_of(example(r.Odometry, RNG)) is None


def test_a_composite_is_drawn_with_what_was_swept_and_its_way_from_where_it_began() -> None:
    base, p2 = r.Pose(np.array([10.0, 20.0, -3.0]), np.array([0.0, 0.0, 0.0, 1.0])), np.array([5.0, 1.0, -2.5])
    swept = r.SweptArea(2.0, 3, 2, np.array([-1.0, -1.0]), np.array([0.0, 4.0, 0.0, 0.0, 0.0, 2.0]))
    given = replace(example(r.CompositeMeasurement, RNG, 0), base_odom=base, swept=swept, features=())
    mean = np.concatenate(([-3.0, 0.0, 0.0, 0.0], p2, np.zeros(6)))
    cells, way = markers_of(replace(given, mean=mean, covariance=np.eye(13))).markers[1:]
    assert [(p.x, p.y) for p in cells.points] == [(12.0, 20.0), (14.0, 22.0)]  # middles of the cells that were seen
    assert cells.colors[0].a > cells.colors[1].a
    assert [(p.x, p.y, p.z) for p in way.points] == [(10.0, 20.0, -3.0), (15.0, 21.0, -2.5)]


def swept_once() -> tuple[r.CompositeMeasurement, r.FeatureMap, r.MatchHypotheses]:
    """A feature found 10 m ahead, by dead reckoning 5 m west of its place; 30 m of ground swept, two features on it."""
    level = np.array([0.0, 0.0, 0.0, 1.0])
    area = r.SweptArea(2.0, 15, 15, np.array([0.0, -15.0]), np.full(225, 20.0))
    mean = np.zeros(16)
    mean[10:13] = [10.0, 0.0, -4.0]
    pose = r.Pose(np.array([100.0, 0.0, -2.0]), level)
    seen = (r.CompositeFeature(7, 9, 12.0, 0, 10),)
    c = r.CompositeMeasurement(
        10, "odom", 0, 0, True, 20, 8.0, 300.0, seen, area, mean, np.eye(16), np.zeros(7), np.eye(7), pose, pose
    )
    places = {1: [115.0, 0.0, -4.0], 2: [120.0, 10.0, -4.0], 3: [200.0, 0.0, -4.0]}
    features = tuple(r.MapFeature(k, "", True, 0.9, 0.7, False, np.array(p)) for k, p in places.items())
    believed = r.FeatureMap(9, "map", 42.0, -71.0, 0.0, features, np.eye(9))
    on_map = r.Pose(np.array([105.0, 0.0, -2.0]), level)
    best = r.MatchHypothesis(5, 0, 3.0, 0.9, 4.0, -1.0, (1,), (7,), on_map, np.eye(6))
    null = r.MatchHypothesis(0, 0, 0.0, 0.1, 0.0, 0.0, (), (), on_map, np.eye(6))
    return c, believed, r.MatchHypotheses(10, "map", (best, null))


def test_a_hypothesis_is_drawn_with_what_was_swept_found_and_missed() -> None:
    composite, believed, answer = swept_once()
    overlays = OverlayMarkers()
    assert overlays.draw(answer) is None
    for record in (believed, composite):
        overlays.take(record)
    first, *others = overlays.draw(answer).markers
    assert first.action == Marker.DELETEALL
    by_name = {m.ns.removeprefix("hypothesis 0: "): m for m in others}
    assert len(by_name) == len(others)  # the null hypothesis says nothing to be drawn
    (found,) = by_name["tracked"].points
    assert (found.x, found.y, found.z) == (115.0, 0.0, -4.0)
    a, b = by_name["pairs"].points
    assert (a.x, a.y) == (b.x, b.y) == (115.0, 0.0)
    assert (by_name["missed"].pose.position.x, by_name["missed"].pose.position.y) == (120.0, 10.0)
    cells = np.array([[p.x, p.y] for p in by_name["swept"].points])
    # centres of 15 x 15 cells from (106, -14) on, drawn as the raster's cells around them, which begin at even metres
    assert cells.min(axis=0) == pytest.approx([107.0, -13.0])
    assert cells.max(axis=0) == pytest.approx([135.0, 15.0])
    assert len(by_name["swept"].colors) == len(cells)
    assert "0.90" in by_name["labels"].text and "1 missed" in by_name["labels"].text


def test_what_was_swept_in_an_older_chain_of_dead_reckoning_is_not_drawn() -> None:
    composite, believed, answer = swept_once()
    overlays = OverlayMarkers()
    for record in (believed, composite, replace(composite, stamp_ns=20, features=(), mean=np.zeros(13))):
        overlays.take(record)
    assert overlays.draw(answer) is None
    drawn = overlays.draw(replace(answer, stamp_ns=20)).markers
    assert not next(m for m in drawn if m.ns.endswith("tracked")).points
