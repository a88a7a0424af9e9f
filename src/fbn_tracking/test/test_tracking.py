"""The tracker as a whole, in a synthetic world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_world import Run, World, corridor, play, simulate

from fbn_common.estimator import Level
from fbn_common.records import SonarDetection, Stage, Verdict
from fbn_common.sonar import polar
from fbn_tracking.estimator import Tracking
from fbn_tracking.parameters import CompositeParameters, FeatureParameters, TrackingParameters, blazed_array_pair
from fbn_tracking.solver import solve

SECOND, ARRAYS = 1_000_000_000, blazed_array_pair()


def _composites(outputs):
    return [o.record for o in outputs if o.topic == "tracking/composite"]


def _features(outputs):
    return [o.record for o in outputs if o.topic == "tracking/features"]


def _innovations(outputs, verdict=None):
    found = [o.record for o in outputs if o.topic == "tracking/innovations"]
    return [i for i in found if verdict is None or i.verdict is verdict]


def _pings_in_view(world, run, target):
    """At how many pings the target lay in the view of an array."""
    count = 0
    for R, p in run.poses:
        seen = [polar((R @ a.rotation_base_array).T @ (target - p - R @ a.position_base)) for a in ARRAYS.values()]
        count += any(
            a.range_min < r < a.range_max and a.bearing_min < phi < a.bearing_max and abs(theta) < a.lobe_width / 2
            for (r, phi, theta), a in zip(seen, ARRAYS.values(), strict=True)
        )
    return count


def _positions(run, composite):
    """Feature positions in the world: relative to the base's true place."""
    start = next(i for i, m in enumerate(run.motions) if m.stamp_ns == composite.start_ns)
    xyz = composite.mean[10:-3].reshape(-1, 3).copy()
    xyz[:, :2] += run.poses[start][1][:2]
    return xyz


@pytest.fixture(scope="module")
def mission():
    world = World(corridor(8), clutter=3.0, period=0.5)
    run = simulate(world, 240, 1001)
    tracker = Tracking()
    return world, run, tracker, play(tracker, run)


def test_every_target_passed_by_is_found_and_nothing_else(mission):
    world, run, _, outputs = mission
    found = np.vstack([_positions(run, c) for c in _composites(outputs)])
    gaps = np.linalg.norm(found[:, None, :2] - world.targets[None, :, :2], axis=2)
    assert gaps.min(axis=1).max() < 3.0  # no false feature among them; a base's own error adds to the feature's
    passed = world.targets[:, 0] < run.poses[-1][1][0] - 12.0
    seen = np.array([_pings_in_view(world, run, target) >= 20 for target in world.targets])
    assert (passed & seen).sum() >= 5
    assert (gaps.min(axis=0)[passed & seen] < 3.0).all()


def test_drift_is_learnt_from_the_features(mission):
    world, _, _, outputs = mission
    seen = [c for c in _composites(outputs) if len(c.features) >= 2]
    assert seen
    for c in seen:
        sigma = np.sqrt(np.diag(c.covariance)[-3:-1])
        assert (sigma < 0.5 * world.drift_sigma).all()
        assert (np.abs(c.mean[-3:-1] - world.drift[:2]) < 4 * sigma).all()


def test_every_ping_is_answered_with_the_features_of_now(mission):
    _, run, _, outputs = mission
    assert [f.stamp_ns for f in _features(outputs)] == [m.stamp_ns for m in run.motions]
    stages = {t.stage for f in _features(outputs) for t in f.features}
    assert stages == {Stage.INFANT, Stage.FEATURE, Stage.RETIRED}


def test_nothing_published_is_not_a_number(mission):
    _, _, _, outputs = mission
    for o in outputs:
        for name in ("mean", "covariance", "prior_mean", "prior_covariance", "innovation", "sigma"):
            value = getattr(o.record, name, None)
            assert value is None or np.isfinite(value).all()
        for t in getattr(o.record, "features", ()):
            assert not hasattr(t, "covariance") or np.isfinite(t.covariance).all()


def test_one_keeps_its_key_across_the_cuts(mission):
    world, run, _, outputs = mission
    owner: dict[int, int] = {}
    for c in _composites(outputs):
        for f, xyz in zip(c.features, _positions(run, c), strict=True):
            target = int(np.argmin(np.linalg.norm(world.targets[:, :2] - xyz[:2], axis=1)))
            assert owner.setdefault(f.key, target) == target
    assert len(owner) == len(set(owner.values()))  # and no target has two keys


def test_detection_counts_do_not_exceed_the_looks_that_could_see(mission):
    _, _, _, outputs = mission
    for c in _composites(outputs):
        for f in c.features:
            assert 0 < f.detections <= 2 * c.pings and f.expected <= 2 * c.pings
            assert c.start_ns - SECOND <= f.first_seen_ns <= f.last_seen_ns <= c.stamp_ns


def test_the_same_input_gives_the_same_bits(mission):
    _, run, _, outputs = mission
    again = play(Tracking(), run)
    assert len(again) == len(outputs)
    for a, b in zip(_composites(outputs), _composites(again), strict=True):
        assert a.mean.tobytes() == b.mean.tobytes() and a.covariance.tobytes() == b.covariance.tobytes()
    for a, b in zip(_innovations(outputs), _innovations(again), strict=True):
        assert (a.nis, a.reason) == (b.nis, b.reason)


def test_the_order_of_arrival_within_a_step_is_of_no_consequence():
    run = simulate(World(corridor(4), clutter=2.0), 60, 1002)
    backwards = Run(run.motions, run.scans[::-1], run.poses)
    one, other = play(Tracking(), run), play(Tracking(), backwards)
    for a, b in zip(_composites(one), _composites(other), strict=True):
        assert a.mean.tobytes() == b.mean.tobytes()


def test_motions_that_come_late_and_in_bursts_change_nothing():
    run = simulate(World(corridor(4), clutter=1.0), 60, 1003)
    smooth, tracker, burst = play(Tracking(), run), Tracking(), []
    for start in range(0, 60, 3):  # scans at once, their motions three at a time and in the wrong order
        for scan in (s for s in run.scans if s.ping in range(start, start + 3)):
            tracker.put("sonar/detections", scan)
        for motion in reversed(run.motions[start : start + 3]):
            tracker.put("deadreck/ping_motion", motion)
        burst += tracker.advance(run.motions[start + 2].stamp_ns)
    for a, b in zip(_composites(smooth), _composites(burst), strict=True):
        assert a.mean.tobytes() == b.mean.tobytes()


def test_infants_do_not_move_the_poses():
    world = World(corridor(4), detection_probability=1.0)
    run = simulate(world, 6, 1004)  # too few pings to graduate
    blind = Run(run.motions, [replace(s, detections=()) for s in run.scans], run.poses)
    seeing, other = Tracking(), Tracking()
    play(seeing, run)
    play(other, blind)
    assert len(seeing._nursery.infants) > 0 and not seeing._window.features
    for index in seeing._window.pings:
        a, b = (t._window.T(index) for t in (seeing, other))
        np.testing.assert_array_equal(a, b)


def test_a_feature_out_of_view_is_retired_and_reaches_the_composite():
    world = World(np.array([[30.0, 2.0, -3.0]]))
    run = simulate(world, 70, 1005)
    until_gone = CompositeParameters(pings=30, wait_pings=12)  # sooner, the cut would take the feature along in view
    outputs = play(Tracking(TrackingParameters(composite=until_gone)), run)
    seen = [f.features for f in _features(outputs)]
    assert any(t.stage is Stage.RETIRED for features in seen for t in features)
    assert sum(len(c.features) for c in _composites(outputs)) >= 1
    assert not seen[-1]  # and is forgotten with its window


@pytest.mark.parametrize("gap", [1.0, 2.0, 3.0])
def test_near_targets_do_not_melt(gap):
    targets = np.array([[30.0, 1.0, -4.0], [30.0 + 0.6 * gap, 1.0 + 0.8 * gap, -4.0]])
    run = simulate(World(targets, drift=(0.02, 0.0, 0.0)), 45, 1006)
    outputs = play(Tracking(), run)
    (c,) = _composites(outputs)[:1]
    xyz = _positions(run, c)
    xyz += targets.mean(axis=0) - xyz.mean(axis=0)  # a heading's error shifts both alike, by half a metre at 17 m
    gaps = np.linalg.norm(xyz[:, None, :2] - targets[None, :, :2], axis=2)
    assert len(c.features) == 2
    assert sorted(gaps.argmin(axis=1).tolist()) == [0, 1]
    apart = np.linalg.norm(xyz[0, :2] - xyz[1, :2])
    assert apart == pytest.approx(gap, abs=0.5)


def test_a_swimming_fish_is_no_feature():
    rng, run = np.random.default_rng(1007), simulate(World(np.zeros((0, 3)), drift_sigma=0.05), 40, 1007)
    scans = []
    for scan in run.scans:
        R, p = run.poses[scan.ping]
        at = np.array([25.0, 0.0, -2.2]) + np.array([0.1, 0.5, 0.0]) * scan.ping  # half a metre a second, athwart
        r, bearing = np.linalg.norm(at - p), np.pi / 2 - np.arctan2(*(R.T @ (at - p))[[1, 0]])
        turn = 0.19635 if scan.frame_id == "sonar_left" else -0.19635
        echo = SonarDetection(r + 0.03 * rng.normal(), bearing + turn, 0.05, 0.0175, 0.9)
        inside = scan.bearing_min < echo.bearing < scan.bearing_max
        scans.append(replace(scan, detections=(echo,) if inside else ()))
    tracker = Tracking()
    play(tracker, Run(run.motions, scans, run.poses))
    assert tracker._nursery.counts["graduated"] == 0


def test_thousands_of_echoes_are_bounded_and_said():
    rng, run = np.random.default_rng(1008), simulate(World(corridor(3)), 5, 1008)
    flood = tuple(SonarDetection(r, b, 0.05, 0.02, 0.5) for r, b in rng.uniform([4, 1.4], [40, 1.7], (4000, 2)))
    run.scans = [replace(s, detections=flood) for s in run.scans]
    tracker = Tracking()
    outputs = play(tracker, run)
    assert len(tracker._nursery.infants) <= tracker.parameters.infant.limit
    assert any("3960 echoes: beyond the 40 strongest" in i.reason for i in _innovations(outputs, Verdict.REFUSED))


def test_a_broken_chain_ends_the_window_and_starts_another():
    run = simulate(World(corridor(4)), 80, 1009)
    run.motions[40:42] = []
    tracker = Tracking()
    composites = _composites(play(tracker, run))
    (ended,) = (k for k, c in enumerate(composites) if c.stamp_ns == run.motions[39].stamp_ns)
    assert [k for k, c in enumerate(composites) if c.first] == [0, ended + 1]
    assert composites[ended + 1].start_ns == run.motions[40].stamp_ns


def test_a_ping_without_motion_is_late_and_the_others_unharmed():
    run = simulate(World(corridor(4)), 30, 1010)
    lost = run.motions.pop()
    tracker = Tracking()
    play(tracker, run)
    for scan in (s for s in run.scans if s.stamp_ns == lost.stamp_ns):
        tracker.put("sonar/detections", scan)
    assert _innovations(tracker.advance(lost.stamp_ns + 2 * SECOND), Verdict.LATE) == []
    late = _innovations(tracker.advance(lost.stamp_ns + 4 * SECOND), Verdict.LATE)
    assert {i.frame_id for i in late} == {"sonar_left", "sonar_right"}


def test_a_scan_later_than_its_motion_is_still_used():
    run = simulate(World(corridor(4), detection_probability=1.0), 12, 1011)
    tracker = Tracking()
    for k, motion in enumerate(run.motions):
        tracker.put("deadreck/ping_motion", motion)
        for scan in (s for s in run.scans if s.ping == k - 1):  # one ping late
            tracker.put("sonar/detections", scan)
        tracker.advance(motion.stamp_ns)
    assert tracker.health().values["scans"] == 22
    assert (
        sum(len(t.detections) for t in tracker._nursery.infants.values())
        + sum(len(t.detections) for t in tracker._window.features.values())
        == tracker.health().values["echoes"]
    )


def test_a_clock_that_jumps_back_resets_and_says_so():
    run = simulate(World(corridor(3)), 20, 1012)
    tracker = Tracking()
    play(tracker, run)
    answers = _innovations(tracker.advance(run.motions[0].stamp_ns), Verdict.REFUSED)
    assert "jumped back" in answers[0].reason
    assert tracker.health().values["clock_resets"] == 1 and tracker.health().level is Level.STALE
    assert _features(play(tracker, run))


def test_the_sonar_may_be_switched_off_and_on():
    run = simulate(World(corridor(8)), 120, 1013)
    run.scans = [s for s in run.scans if not 40 <= s.ping < 70]
    tracker = Tracking()
    composites = _composites(play(tracker, run))
    assert tracker.health().values.get("smoother_failures", 0) == 0
    assert composites[-1].features


def test_a_featureless_hour_throws_nothing_and_keeps_its_size():
    run = simulate(World(np.zeros((0, 3)), period=3.0), 1200, 1014)
    tracker = Tracking()
    composites = _composites(play(tracker, run))
    assert tracker.health().values.get("smoother_failures", 0) == 0
    assert len(tracker._window.pings) <= 90 and len(composites) >= 1200 // 90
    R = tracker._window.T(tracker._window.last)[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)  # rounding does not grow from window to window


def test_the_latest_pose_is_near_the_optimum_of_its_window_at_every_ping():
    run, tracker, gaps = simulate(World(corridor(8), clutter=2.0, period=0.5), 120, 1018), Tracking(), []
    for k, motion in enumerate(run.motions):
        play(tracker, Run([motion], [s for s in run.scans if s.ping == k], run.poses))
        window = tracker._window
        best = solve(window.system, window.estimate.state, (0,), exact=True).state
        gaps.append(np.linalg.norm(best.T[-1][:3, 3] - window.T(window.last)[:3, 3]))
    assert tracker.health().values["graduated"] > 2 and tracker.health().values["composites"] > 1
    assert np.median(gaps) < 0.01 and max(gaps) < 0.05  # m: one Gauss-Newton step from a step that was small


def test_a_numerical_failure_costs_the_features_of_the_window_but_not_the_motion():
    run = simulate(World(corridor(4), detection_probability=1.0), 40, 1015)
    tracker = Tracking(TrackingParameters(composite=CompositeParameters(pings=30, wait_pings=12)))  # no cut so soon
    play(tracker, Run(run.motions[:25], run.scans, run.poses))
    window = tracker._window
    assert window.features
    window.estimate.state.q[0] = np.nan
    outputs = play(tracker, Run(run.motions[25:28], run.scans, run.poses))
    assert [f.stamp_ns for f in _features(outputs)] == [m.stamp_ns for m in run.motions[25:28]]
    assert np.isfinite(window.T(window.last)).all()
    assert tracker.health().values["smoother_failures"] == 1 and tracker.health().level is Level.WARN


def test_the_linear_elevation_is_there_for_comparison():
    parameters = TrackingParameters(feature=FeatureParameters(elevation="linear"))
    outputs = play(Tracking(parameters), simulate(World(corridor(4)), 60, 1016))
    assert _composites(outputs)[0].features


@pytest.mark.parametrize(("looks", "expected"), [(4, 0), (5, 1)])
def test_what_has_left_the_view_needs_fewer_detections(looks, expected):
    run = simulate(World(np.array([[30.0, 2.0, -3.0]]), detection_probability=1.0), 25, 1018)
    run.scans = [s for s in run.scans if s.ping < looks]  # then nothing is looked at: nothing speaks against it
    tracker = Tracking()
    play(tracker, Run(run.motions[: looks + 1], run.scans, run.poses))
    assert tracker.health().values["features"] == 0  # in view: more may come
    play(tracker, Run(run.motions[looks + 1 :], run.scans, run.poses))
    assert tracker.health().values.get("graduated", 0) == expected


@pytest.mark.parametrize("seed", [1000, 1001, 1003])
def test_a_thing_keeps_its_track_while_the_smoother_learns_the_current_and_cuts(seed: int) -> None:
    """No noise, no clutter, 0.18 m/s that nobody knew: each target makes one track but for what its first look hides.

    Poses move by metres under the infants when a feature tells the drift, and at cuts; an infant left behind is
    unmatched, dies, and its target is born and promoted again.
    """
    world = World(corridor(), drift=(0.1, 0.15, 0.0), drift_sigma=0.12, noise=0.0)
    tracker = Tracking()
    play(tracker, simulate(world, 160, seed))
    values = tracker.health().values
    assert values["graduated"] <= len(world.targets)
    assert values["infants_born"] <= len(world.targets) + 3
