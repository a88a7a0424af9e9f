"""The motion check: chi-square for what rests, refusal of what moves, with exact geometry and no position given."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from synthetic_world import World, play, simulate

from fbn_common.estimator import Output
from fbn_common.lie import matrix_from_rpy
from fbn_common.records import CompositeMeasurement, SonarDetection
from fbn_common.sonar import SonarArray, polar
from fbn_common.types import Array
from fbn_tracking.estimator import Tracking
from fbn_tracking.geometry import elevation_shape
from fbn_tracking.motion_check import MotionCheck, apparent_velocity, balances, check_motion, needed
from fbn_tracking.parameters import InfantParameters, TrackingParameters, blazed_array_pair

HALF = 0.1745  # rad, of the lobe
ARRAY = SonarArray(mount_rpy=(0.0, 0.0, 0.19635))


@dataclass(frozen=True)
class Trial:
    """A way past one thing, echoes of two pings in three, and dead reckoning with drift and noise."""

    n: int = 10
    drift: float = 0.03  # m/s, sigma of each axis
    thing: tuple[float, float] = (0.0, 0.0)  # m/s
    speed: float = 0.8
    noise: float = 1.0  # scales echoes' and way's noise
    curvature: float = 0.0  # m, radius of the thing


def _echoes(trial: Trial, rng: np.random.Generator) -> tuple[Array, ...] | None:
    """t, R, p, z, walk of one draw; None where the thing leaves the lobe or comes nearer than 4 m."""
    times = np.cumsum(np.concatenate(([0], rng.geometric(0.67, trial.n - 1)))).astype(float)
    pings = int(times[-1]) + 1
    drift = np.append(trial.drift * rng.normal(size=2), 0.0)
    turn_rate, phase = 0.03 * rng.normal(), rng.uniform(0.0, 6.0)
    x, x_reckoned, yaw, yaw_reckoned, poses = np.zeros(3), np.zeros(3), 0.0, 0.0, []
    for k in range(pings):
        tilt = (0.02 * np.sin(0.9 * k + phase), 0.03 * np.sin(0.5 * k + phase))
        R, R_reckoned = (matrix_from_rpy(np.array([*tilt, a])) @ ARRAY.rotation_base_array for a in (yaw, yaw_reckoned))
        poses.append((R, x, R_reckoned, x_reckoned))
        step = np.array([trial.speed, 0.0, 0.0])
        x = x + matrix_from_rpy(np.array([*tilt, yaw])) @ step
        way = matrix_from_rpy(np.array([*tilt, yaw_reckoned])) @ step
        x_reckoned = x_reckoned + way - drift + trial.noise * 0.02 * rng.normal(size=3)
        yaw, yaw_reckoned = yaw + turn_rate, yaw_reckoned + turn_rate + trial.noise * 0.003 * rng.normal()
    r, azimuth, elevation = rng.uniform(15.0, 38.0), 0.19635 + rng.uniform(-0.15, 0.15), rng.uniform(-HALF, HALF)
    place = r * np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    z, shape = np.empty((trial.n, 6)), elevation_shape(HALF, 2e-3, True)
    for i, t in enumerate(times):
        R, x, *_ = poses[int(t)]
        q = polar(R.T @ (place + np.array([*trial.thing, 0.0]) * t - x))
        if abs(q[2]) > 1.2 * HALF or q[0] < 4.0:
            return None
        noise = trial.noise * rng.normal(size=2) * [0.05, 0.0175]
        z[i] = q[0] - trial.curvature + noise[0], q[1] + noise[1], 0.05, 0.0175, *shape
    R_all, p_all = (np.array([poses[int(t)][i] for t in times]) for i in (2, 3))
    return times, R_all, p_all, z, np.outer(times, [0.02**2, 0.003**2])


def _drawn(trial: Trial, seed: int) -> tuple[Array, ...]:
    """The first draw of this seed, or of one after it, that stays in view."""
    for more in range(100):
        made = _echoes(trial, np.random.default_rng(seed + 1000 * more))
        if made is not None:
            return made
    raise AssertionError("nothing stays in view")


def _checks(trial: Trial, draws: int, seed: int) -> list[MotionCheck]:
    rng = np.random.default_rng(seed)
    made = [_echoes(trial, rng) for _ in range(draws)]
    found = [check_motion(*echoes, trial.drift**2 * np.eye(2)) for echoes in made if echoes is not None]
    return [c for c in found if c is not None]


@pytest.mark.parametrize(("n", "drift"), [(7, 0.03), (10, 0.03), (10, 0.1)])
def test_what_rests_is_refused_as_often_as_stated_and_no_more(n: int, drift: float) -> None:
    """The statistic's mean is 2 and its tails are those of chi-square, within four sigmas of their own counts."""
    statistics = np.array([c.statistic for c in _checks(Trial(n, drift), 1000, 11)])
    assert len(statistics) > 500
    # variance of chi-square with 2 dof is 4
    assert statistics.mean() == pytest.approx(2.0, abs=4.0 * 2.0 / np.sqrt(len(statistics)))
    for probability, bound in ((0.9, 4.605), (0.99, 9.210)):
        expected = (1.0 - probability) * len(statistics)
        assert abs((statistics > bound).sum() - expected) < 4.0 * np.sqrt(expected * probability)


@pytest.mark.parametrize("heading", np.arange(0.0, 2.0 * np.pi, np.pi / 3.0))
def test_a_fish_of_a_foot_a_second_is_refused_within_seven_detections_whichever_way_it_swims(heading: float) -> None:
    """0.3 m/s, where the drift is known to 3 cm/s.

    By the ranges' line through 7 echoes over 9 s its speed is known to about 2 cm/s, across by bearings at 25 m to
    about 6 cm/s: four sigmas at least, and 99 % of static things stay under three.
    """
    swimming = Trial(7, 0.03, (0.3 * np.cos(heading), 0.3 * np.sin(heading)))
    checks = _checks(swimming, 80, 5)
    assert np.mean([c.moving(0.99) for c in checks]) > 0.9
    mean = np.mean([c.velocity for c in checks], axis=0)
    spread = np.std([c.velocity for c in checks], axis=0) / np.sqrt(len(checks))
    np.testing.assert_allclose(mean, swimming.thing, atol=4.0 * spread.max() + 0.015)  # half a lobe's cosine of 0.8 m/s


def test_what_goes_with_the_vehicle_is_refused() -> None:
    """Echoes of itself, or of the beam's edge on a level bed, keep their range while the vehicle goes."""
    rng = np.random.default_rng(2)
    made = [e for e in (_echoes(Trial(8), rng) for _ in range(40)) if e is not None]
    for t, R, p, z, walk in made:
        still = z.copy()
        still[:, :2] = z[0, :2] + rng.normal(size=(len(t), 2)) * [0.05, 0.0175]
        check = check_motion(t, R, p, still, walk, 0.1**2 * np.eye(2))
        assert check is not None and check.moving(0.999)


def test_an_unknown_current_is_not_taken_for_motion_but_hides_a_fish() -> None:
    """Of 0.3 m/s with a drift known to 0.2 m/s nobody can say whose it is; the check says so by not refusing."""
    checks = _checks(Trial(10, 0.2, (0.3, 0.0)), 200, 3)
    assert np.mean([c.moving(0.99) for c in checks]) < 0.5


def test_ranges_balance_whatever_the_things_curvature() -> None:
    """Free of noise, the range balance of a sphere is constant: to third order of a step, (V dt)^3 / 12 r^2 each."""
    for radius in (0.0, 5.0):
        t, R, p, z, _ = _drawn(Trial(8, 0.0, noise=0.0, curvature=radius), 4)
        b, _, by_theta, by_square = balances(t, R, p, z, True)
        design = np.column_stack((np.ones(8), by_theta[:8], by_square[:8]))  # what is not known: level, elevation
        left = b[:8] - design @ np.linalg.lstsq(design, b[:8], rcond=None)[0]
        assert np.abs(left).max() < 0.02


def test_slopes_of_the_balances_are_their_derivatives_by_the_things_velocity() -> None:
    """Two things, one at rest: the balances' difference, over the velocity of the other."""
    for i in range(2):
        small = np.eye(2)[i] * 1e-3
        at_rest = _drawn(Trial(8, 0.0, noise=0.0), 9)
        moved = _drawn(Trial(8, 0.0, (small[0], small[1]), noise=0.0), 9)
        b0, slopes, *_ = balances(*at_rest[:4], True)
        b1 = balances(*moved[:4], True)[0]
        # the elevation, which the balances leave out, takes a cosine of at most 1.5 % from them, and turns with range
        np.testing.assert_allclose((b1 - b0) / 1e-3, slopes[:, i], atol=0.03 * np.abs(slopes).max())


def test_terms_that_a_tracks_time_does_not_show_are_left_out_and_no_others() -> None:
    """At rest nothing bends or turns; under way ranges bend by V^2 t^2 / 2r = 0.3 m in these 7 s, and bearings move."""
    t, R, p, z, _ = _drawn(Trial(7, 0.0, noise=0.0), 6)
    assert needed(t, R, p, z) == (True, True)
    rest = np.repeat(R[:1], 7, axis=0), np.repeat(p[:1], 7, axis=0)
    assert needed(t, *rest, z) == (False, False)
    alike = check_motion(t, *rest, np.repeat(z[:1], 7, axis=0), np.zeros((7, 2)), 1e-4 * np.eye(2))
    assert alike is not None and alike.dof == 1 and alike.statistic < 1e-6  # rounding


def test_what_is_left_out_shifts_the_answer_by_less_than_a_sigma() -> None:
    """First order alone, where the numbers allow it: adrift at 6 mm/s; no noise but that which is stated."""
    shifts = []
    for seed in range(40):
        made = _drawn(Trial(7, 0.0, speed=0.006, noise=0.0), seed)
        if not needed(*made[:4])[0]:
            (one, P), (two, _) = (apparent_velocity(*made, order, True) for order in (False, True))
            shifts.append(float((one - two) @ np.linalg.solve(P, one - two)))
    assert len(shifts) > 10 and max(shifts) < 1.0


def test_few_echoes_and_echoes_of_one_moment_are_not_judged() -> None:
    t, R, p, z, walk = _drawn(Trial(7), 1)
    assert check_motion(t[:3], R[:3], p[:3], z[:3], walk[:3], np.eye(2)) is None
    assert check_motion(np.zeros(7), R, p, z, walk, np.eye(2)) is None


def _with_fish(seed: int, still: float, drift_sigma: float = 0.08) -> tuple[Tracking, list[Output]]:
    """The tracker after it met a lone fish of 0.3 m/s, the drift being known as well as said [m/s] and none."""
    world = World(np.array([[-50.0, 0.0, -3.0]]), drift=(0.0, 0.0, 0.0), drift_sigma=drift_sigma, period=0.5)
    run, rng = simulate(world, 90, seed), np.random.default_rng(seed)
    for k, (R, p) in enumerate(run.poses):
        place = np.array([30.0 + 0.15 * k, 1.0, -2.5])  # 0.3 m/s ahead
        for i, array in enumerate(blazed_array_pair().values()):
            r, phi, theta = polar((R @ array.rotation_base_array).T @ (place - p - R @ array.position_base))
            inside = 4.0 < r < 40.0 and array.bearing_min < phi < array.bearing_max and abs(theta) < HALF
            if inside and rng.random() < world.detection_probability:
                noise = rng.normal(size=2) * [0.05, 0.0175]
                echo = SonarDetection(r + noise[0], phi + noise[1], 0.05, 0.0175, 0.8)
                run.scans[2 * k + i] = replace(run.scans[2 * k + i], detections=(echo,))
    tracker = Tracking(TrackingParameters(infant=InfantParameters(still_probability=still)))
    return tracker, play(tracker, run)


def _promoted(seed: int, still: float) -> int:
    """How often the tracker makes a feature of it."""
    values = _with_fish(seed, still)[0].health().values
    assert values.get("motion_refusals", 0) if still < 0.999 else True  # nothing is refused in silence
    return int(values.get("graduated", 0))


def test_the_tracker_makes_no_feature_of_a_fish_that_passed_for_a_static_thing_before() -> None:
    """What its energy as a static thing leaves open, since a drift of 0.3 m/s is no more than four sigmas of many."""
    assert [_promoted(seed, 0.99) for seed in range(1000, 1004)] == [0] * 4
    assert sum(_promoted(seed, 1.0 - 1e-15) for seed in range(1000, 1004)) >= 4


def test_a_fish_that_was_promoted_is_taken_out_again_and_dead_reckoning_believed() -> None:
    """Every infant passes here.  At 6 cm/s of drift, 0.3 m/s cost (0.3/0.06)^2 = 25 of two degrees, 13.8 being allowed.

    With the fish in it, a composite would say that the vehicle went 0.3 m/s more than dead reckoning, which is exact.
    """
    for seed in range(1000, 1004):
        tracker, outputs = _with_fish(seed, 1.0 - 1e-15, 0.06)
        composites = [o.record for o in outputs if isinstance(o.record, CompositeMeasurement)]
        assert tracker.health().values["features_taken_out"] >= 1
        assert composites and not any(c.features for c in composites)
        for c in composites:
            assert np.abs(c.mean[-3:]).max() < 1e-4  # m/s: depth alone tells of surge, by pitch, sigma 6e-4
