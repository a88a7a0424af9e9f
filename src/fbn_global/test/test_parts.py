"""Field, odometry, fixes, verdict, target: each against closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbn_common.geodesy import GeodeticPoint, geodetic_from_enu
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.parameters import ParameterError, load
from fbn_common.prior_map import PriorFeature, PriorMap
from fbn_common.records import Localization, Odometry, Pose
from fbn_common.types import NS, Array
from fbn_global.field import Field, build_field, instantiate
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.naps import surplus_gains, surplus_log
from fbn_global.odometry import History, Reckoned, carry, link, xy_jacobian
from fbn_global.parameters import GlobalParameters, PriorMapParameters, ScoringParameters, VerdictParameters
from fbn_global.reference_update import apply_fix, better_directions
from fbn_global.state import HEAD, Block, Kind, equate, start
from fbn_global.target import locate, rpy_inverse
from fbn_global.verdict import Mode, Verdict, judge

DATUM = GeodeticPoint(42.0, -71.0, 0.0)


def field_of(places: Array) -> Field:
    def feature(k: int, place: Array) -> PriorFeature:
        g = geodetic_from_enu(np.array([place[0], place[1], 0.0]), DATUM)
        return PriorFeature(k, g.latitude, g.longitude, float(place[2]), target=k == 1)

    prior = PriorMap(tuple(feature(k, p) for k, p in enumerate(places)))
    return build_field(prior, DATUM, PriorMapParameters())


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 40))
def test_the_maps_covariance_is_positive_definite_for_any_places(seed: int, n: int) -> None:
    field = field_of(np.random.default_rng(seed).uniform(-500, 500, (n, 3)))
    assert np.linalg.eigvalsh(field.covariance(np.arange(n), np.arange(n)))[0] > 0.0


def test_neighbours_on_the_map_know_each_other_better_than_their_place() -> None:
    """Var(x_i - x_j) = 2 s^2 d / (L + d) + 2 own^2: at 20 m, 1 km, 5 m and 0.5 m it is 1.48 m^2."""
    field = field_of(np.array([[0.0, 0, -4], [20.0, 0, -4]]))
    k = field.covariance(np.arange(2), np.arange(2))
    np.testing.assert_allclose(k[0, 0] + k[3, 3] - 2 * k[0, 3], 2 * 25 * 20 / 1020 + 2 * 0.25, rtol=1e-4)


def test_a_feature_added_late_is_as_if_it_had_been_there_from_the_start() -> None:
    field = field_of(np.random.default_rng(1).uniform(0, 80, (6, 3)))
    empty = start(np.zeros(6), np.eye(6), np.eye(3))
    early = instantiate(empty, field, np.arange(6))
    late = instantiate(empty, field, np.arange(3))
    noise = 0.1 * np.eye(3)
    early, late = (equate(s, Block(Kind.MAP, 0), Block(Kind.MAP, 2), noise).state for s in (early, late))
    late = instantiate(late, field, np.arange(6))
    for row in range(6):
        for one, other in zip(early.marginal(Block(Kind.MAP, row)), late.marginal(Block(Kind.MAP, row)), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)


def odometry(t: float, x: float, y: float, yaw: float) -> Odometry:
    rotation = quaternion_from_matrix(matrix_from_rpy(np.array([0.0, 0.0, yaw])))
    pose = Pose(np.array([x, y, -2.0]), rotation)
    return Odometry(round(t * NS), "odom", "base_link", pose, np.zeros(6), 0.01 * np.eye(6), np.eye(6))


def test_a_constant_drift_moves_the_link_by_drift_times_time() -> None:
    history = History(100.0)
    for t in range(11):
        history.add(odometry(t, 0.8 * t, 0.0, 0.0))
    first, last = history.at(0), history.at(10 * NS)
    assert first is not None
    assert last is not None
    tie = link(first, last, 0.01 * np.eye(3), 1e9, 0.0)
    np.testing.assert_allclose(tie.displacement, [8.0, 0.0])
    np.testing.assert_allclose(tie.drift_jacobian, [[10.0, 0, 10.0], [0, 10.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(tie.growth, 0.0, atol=1e-6)


def test_the_drifts_wandering_is_that_of_an_integrated_ornstein_uhlenbeck_process() -> None:
    """Var of the integral, given the start: by quadrature of the process's covariance."""
    tau, t = 50.0, 80.0
    s = np.linspace(0, t, 2001)
    a, b = np.meshgrid(s, s)
    kernel = np.exp(-np.abs(a - b) / tau) - np.exp(-(a + b) / tau)
    expected = np.trapezoid(np.trapezoid(kernel, s, axis=0), s)
    one = Reckoned(0, np.zeros(6), np.zeros(2), np.zeros(4))
    other = Reckoned(round(t * NS), np.zeros(6), np.zeros(2), np.zeros(4))
    tie = link(one, other, np.diag([1.0, 1.0, 0.0]), tau, 0.0)
    np.testing.assert_allclose(tie.growth, expected * np.eye(2), rtol=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_jacobians_of_the_link_are_the_numerical_derivatives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = Reckoned(0, np.array([*rng.uniform(-5, 5, 2), -2, 0, 0, rng.uniform(-3, 3)]), np.zeros(2), np.zeros(4))
    other = Reckoned(
        30 * NS, np.array([*rng.uniform(-30, 30, 2), -3, 0.1, 0.1, 1.0]), rng.uniform(-20, 20, 2), np.zeros(4)
    )
    tie = link(one, other, np.eye(3), 600.0, 0.01)
    state = start(rng.uniform(-1, 1, 6), np.eye(6), np.eye(3))
    _, rows = xy_jacobian(state, one, tie)
    pose, jacobian, _ = carry(state, one, other, tie)
    step = 1e-6
    for k in range(HEAD):
        moved = replace(state, mean=state.mean + step * np.eye(HEAD)[k])
        np.testing.assert_allclose((xy_jacobian(moved, one, tie)[0] - pose[:2]) / step, rows[:, k], atol=1e-4)
        np.testing.assert_allclose((carry(moved, one, other, tie)[0] - pose) / step, jacobian[:, k], atol=1e-4)


def test_a_fix_counts_only_where_it_is_better_than_what_is_known() -> None:
    own = np.diag([1.0, 100.0])
    directions = better_directions(4.0 * np.eye(2), own)
    assert len(directions) == 1
    np.testing.assert_allclose(directions[0] / directions[0][1], [0.0, 1.0], atol=1e-12)
    assert len(better_directions(200.0 * np.eye(2), own)) == 0


def test_a_fix_leaves_alone_the_axis_on_which_it_is_the_worse() -> None:
    spread = np.diag([1.0, 100.0, 1, 1, 1, 1])
    here = Reckoned(0, np.zeros(6), np.zeros(2), np.zeros(4))
    tie = link(here, here, np.eye(3), 600.0, 0.0)
    done = apply_fix(
        start(np.zeros(6), spread, np.eye(3)), here, tie, np.array([3.0, 3.0]), 4.0 * np.eye(2), 4.0 * np.eye(2)
    )
    np.testing.assert_allclose(done.state.covariance[0, 0], 1.0)
    np.testing.assert_allclose(done.state.covariance[1, 1], 400.0 / 104.0)
    np.testing.assert_allclose(done.state.mean[:2], [0.0, 300.0 / 104.0], atol=1e-12)


def test_the_targets_place_in_the_body_has_the_covariance_of_sampled_poses() -> None:
    field = field_of(np.array([[0.0, 0, -4], [30.0, 10.0, -4.0]]))
    spread = np.diag([0.04, 0.09, 0.01, 1e-4, 1e-4, 4e-4])
    pose = np.array([5.0, 2.0, -2.0, 0.05, -0.1, 0.7])
    h = Hypothesis(0, -1, start(pose, spread, 1e-12 * np.eye(3)), 0.0)
    here = Reckoned(0, pose, np.zeros(2), np.zeros(4))
    target = locate(h, field, 1, here, here, link(here, here, np.eye(3), 600.0, 0.0))
    rng = np.random.default_rng(0)
    poses = pose + rng.standard_normal((20_000, 6)) * np.sqrt(np.diag(spread))
    places = field.position[1] + rng.standard_normal((20_000, 3)) @ np.linalg.cholesky(target.covariance).T
    bodies = np.array([matrix_from_rpy(p[3:]).T @ (q - p[:3]) for p, q in zip(poses, places, strict=True)])
    np.testing.assert_allclose(target.body, bodies.mean(axis=0), atol=0.2)  # 5 m / sqrt(20000) * 4, and curvature
    np.testing.assert_allclose(target.body_covariance, np.cov(bodies.T), atol=1.0, rtol=0.05)


def test_the_body_rotation_of_small_angles_is_the_numerical_one() -> None:
    rpy, step = np.array([0.2, -0.3, 1.0]), 1e-7
    for k in range(3):
        turned = matrix_from_rpy(rpy).T @ matrix_from_rpy(rpy + step * np.eye(3)[k])
        vector = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / step
        np.testing.assert_allclose(vector, rpy_inverse(rpy)[:, k], atol=1e-6)


def test_what_a_pair_gains_is_the_difference_of_the_densities_of_what_is_left_unexplained() -> None:
    p = ScoringParameters()
    gains = surplus_gains(5, 3, 4000.0, p)
    expected = [surplus_log(4 - k, 4000.0, p) - surplus_log(5 - k, 4000.0, p) for k in range(3)]
    np.testing.assert_allclose(gains, expected, rtol=1e-12)


def mode(pairs: tuple[tuple[int, int], ...], posterior: float, x: float = 0.0) -> Mode:
    field = field_of(np.random.default_rng(1).uniform(0, 80, (8, 3)))
    state = instantiate(start(np.zeros(6), 1e-2 * np.eye(6), np.eye(3)), field, np.arange(8))
    state = replace(state, covariance=0.01 * np.eye(len(state.mean)))
    h = Hypothesis(1, 0, state, 0.0, pairs, score=Score(posterior=posterior))
    return Mode(h, np.array([x, 0.0]), posterior)


HERE, THERE = ((1, 1), (2, 2), (3, 3)), ((1, 2), (2, 3), (3, 4))


def verdicts(*updates: list[Mode]) -> list[Verdict]:
    out, now = [], Verdict()
    for k, found in enumerate(updates):
        null = 1.0 - sum(m.posterior for m in found)
        now = judge(now, found, null, k * NS, VerdictParameters(hold_updates=2))
        out.append(now)
    return out


def test_a_match_must_hold_before_it_is_declared_and_is_kept_with_hysteresis() -> None:
    sure, less = [mode(HERE, 0.9985)], [mode(HERE, 0.9)]
    less_sure = [mode(HERE, 0.6), mode(THERE, 0.4, 20.0)]
    found = verdicts(less, sure, sure, less, less_sure, [mode(HERE, 0.45)])
    states = [v.state for v in found]
    m, u, lost = Localization.MATCHED, Localization.UNMATCHED, Localization.LOST
    assert states == [u, u, m, m, m, lost]
    assert [v.posterior for v in found[3:]] == [0.9, 0.6, 0.45]  # what is believed of it is always told


def test_two_likely_places_are_ambiguous_and_named() -> None:
    verdict = verdicts([mode(HERE, 0.6), mode(THERE, 0.39, 20.0)])[0]
    assert verdict.state is Localization.AMBIGUOUS
    assert "(0, 0) 0.60" in verdict.reason
    assert "(20, 0) 0.39" in verdict.reason


def test_a_match_contradicted_by_a_better_place_is_lost_and_found_again_there() -> None:
    here, there = [mode(HERE, 0.999)], [mode(THERE, 0.999, 20.0)]
    m, u, lost = Localization.MATCHED, Localization.UNMATCHED, Localization.LOST
    assert [v.state for v in verdicts(here, here, there, there, there)] == [u, m, lost, lost, m]


def test_a_place_without_rival_is_no_match_while_chance_may_have_made_it() -> None:
    assert verdicts([mode(HERE, 0.992)], [mode(HERE, 0.992)])[-1].state is Localization.UNMATCHED


def test_too_few_features_are_no_match_however_sure() -> None:
    pair = [mode(HERE[:2], 0.9999)]
    assert verdicts(pair, pair, pair)[-1].state is Localization.UNMATCHED


def test_an_unknown_method_is_refused_with_the_choice() -> None:
    with pytest.raises(ParameterError, match="NAPS, POS, JCBB"):
        load(GlobalParameters, {"method": "BEST"})
