"""The global filter as a whole: verdicts on drawn worlds, what is refused, and that nothing is invented."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fbn_common.estimator import Output
from fbn_common.prior_map import PriorMap
from fbn_common.records import (
    CompositeMeasurement,
    FeatureMap,
    Innovation,
    Localization,
    LocalizationStatus,
    MatchHypotheses,
    Odometry,
    PoseWithCovarianceStamped,
    Record,
    ReferenceFix,
    Verdict,
)
from fbn_common.types import NS
from fbn_global.estimator import Global
from fbn_global.parameters import GlobalParameters
from fbn_testing.composite_world import Run, Settings, World, charles_river
from fbn_testing.matching_play import is_right, play
from fbn_testing.matching_worlds import elsewhere, rows_world

LEGS = ((-40.0, 5.0), (80.0, 5.0), (80.0, 35.0), (40.0, 35.0))


def river(seed: int = 5, **changes: Any) -> Run:
    return World(replace(Settings(charles_river(seed), LEGS, seed=seed), **changes)).make()


def feed(estimator: Global, entries: Iterable[tuple[str, Record]]) -> list[Output]:
    outputs: list[Output] = []
    for topic, record in entries:
        estimator.put(topic, record)
        outputs += estimator.advance(record.stamp_ns)
    return outputs


def of(outputs: list[Output], kind: type[Any]) -> list[Any]:
    return [o.record for o in outputs if isinstance(o.record, kind)]


def flat(outputs: list[Output]) -> bytes:
    """All numbers of all records, bit by bit."""

    def numbers(value: Any) -> bytes:
        if isinstance(value, np.ndarray):
            return value.tobytes()
        if isinstance(value, tuple):
            return b"".join(map(numbers, value))
        if hasattr(value, "__dataclass_fields__"):
            return b"".join(numbers(getattr(value, name)) for name in value.__dataclass_fields__)
        return repr(value).encode()

    return b"".join(o.topic.encode() + numbers(o.record) for o in outputs)


def test_a_run_through_the_field_is_matched_rightly_and_the_target_is_near_its_place() -> None:
    run = river()
    outputs = feed(Global(GlobalParameters(), run.prior), run.entries)
    status, hypotheses = of(outputs, LocalizationStatus)[-1], of(outputs, MatchHypotheses)[-1]
    assert status.state is Localization.MATCHED
    assert is_right(hypotheses, 0, run)
    target = charles_river(5)[status.target_id]
    truth = run.truth[hypotheses.stamp_ns]
    away = np.hypot(*(target[:2] - truth[:2]))
    # relative to the vehicle the target is known to its own map error (0.5 m) and the track's: 1.5 m is 2.5 sigma
    assert abs(status.target_range - np.hypot(away, target[2] - truth[2])) < 1.5
    assert 0.0 < np.sqrt(np.trace(status.target_covariance_body)) < 3.0


def test_the_map_shifts_as_a_whole_with_the_vehicle() -> None:
    """The map lies 9 m off and dead reckoning starts within 2 m: after matching all features have moved by 9 m."""
    run = river(map_error=0.2, map_shift=(-9.0, 0.0))
    outputs = feed(Global(GlobalParameters(), run.prior), run.entries)
    features = [f for f in of(outputs, FeatureMap)[-1].features if f.prior]
    moved = np.array([f.position[:2] - charles_river(5)[f.id][:2] for f in features])
    assert np.abs(moved - moved.mean(axis=0)).max() < 2.0  # 0.5 m each, drawn independently: 4 sigma
    assert np.hypot(*moved.mean(axis=0)) < 5.0  # the fix's 2 m against the map's 9


def test_the_map_of_another_place_stays_unmatched() -> None:
    outcomes = [play(elsewhere(0), GlobalParameters())]
    assert not any(o.matched_ever for o in outcomes)


def test_in_a_regular_field_joint_compatibility_locks_on_the_wrong_row_where_naps_does_not() -> None:
    """The map lies 12 m off in rows 20 m apart: the wrong row is 8 m away, the nearer; only what was not seen tells."""
    runs = [World(rows_world(seed, 12.0, 5)).make() for seed in range(4)]
    jcbb = [play(run, GlobalParameters(method="JCBB")) for run in runs]
    naps = [play(run, GlobalParameters()) for run in runs]
    assert sum(o.wrong_ever for o in jcbb) >= 2
    assert not any(o.wrong_ever for o in naps)


def test_of_two_hypotheses_that_say_the_same_one_is_kept() -> None:
    """Over three lanes the same features come back under new keys: recognised as found before, or as the map's."""
    run = World(replace(Settings(charles_river(5), (*LEGS, (40.0, 5.0), (80.0, 5.0)), seed=5))).make()
    outputs = feed(Global(GlobalParameters(), run.prior), run.entries)
    told = of(outputs, MatchHypotheses)
    for message in told:
        accounts = [frozenset(zip(h.feature_keys, h.map_ids, strict=True)) for h in message.hypotheses]
        assert len(set(accounts)) == len(accounts)
    # what was seen again is told as well: more keys than features of the map
    assert len(told[-1].hypotheses[0].map_ids) > len(set(told[-1].hypotheses[0].map_ids))
    assert all(h.posterior <= 1.0 for message in told for h in message.hypotheses)
    assert all(s.posterior <= 1.0 for s in of(outputs, LocalizationStatus))


def test_without_a_map_it_navigates_and_says_so() -> None:
    run = river()
    outputs = feed(Global(GlobalParameters()), run.entries)
    assert of(outputs, LocalizationStatus)[-1].reason == "no prior map"
    assert of(outputs, PoseWithCovarianceStamped)


def test_before_the_first_fix_no_pose_is_published_and_nothing_is_matched() -> None:
    run = river()
    outputs = feed(Global(GlobalParameters(), run.prior), [e for e in run.entries if e[0] != "reference/fix"])
    assert not of(outputs, PoseWithCovarianceStamped)
    assert not of(outputs, Odometry)
    assert {s.state for s in of(outputs, LocalizationStatus)} == {Localization.UNMATCHED}


def test_the_same_log_gives_the_same_bits_whatever_the_order_of_arrival_within_a_step() -> None:
    run = river()
    results = []
    for turn in (1, -1):
        estimator, outputs = Global(GlobalParameters(), run.prior), []
        for t in range(100 * NS, 190 * NS, NS):
            for topic, record in [e for e in run.entries if t < e[1].stamp_ns + NS <= t + NS][::turn]:
                estimator.put(topic, record)
            outputs += estimator.advance(t)
        results.append(flat(outputs))
    assert len(results[0]) > 10_000
    assert results[0] == results[1]


@pytest.mark.parametrize("crossings", [6, pytest.param(100, marks=pytest.mark.campaign)])
def test_covariances_stay_positive_definite_over_hours(crossings: int) -> None:
    """Back and forth, 100 s each (in the campaign for close to three hours), with a fix every half hour."""
    legs = tuple((80.0 * (k % 2), 20.0) for k in range(crossings))
    run = river(legs=legs, seed=7, fix_every=150)
    estimator = Global(GlobalParameters(), run.prior)
    for topic, record in run.entries:
        estimator.put(topic, record)
        if topic != "deadreck/odometry":
            estimator.advance(record.stamp_ns)
    assert estimator._bank is not None
    for h in estimator._bank.all:
        spread = np.sqrt(np.diag(h.state.covariance))
        correlation = h.state.covariance / np.outer(spread, spread)
        assert np.linalg.eigvalsh(correlation)[0] > 0.0
        assert len(h.state.mean) < 400


def test_repeated_fixes_do_not_make_it_surer_than_one_fix() -> None:
    run = river(fix_every=1)
    outputs = feed(Global(GlobalParameters()), run.entries)
    fixes = [i for i in of(outputs, Innovation) if i.sensor == "reference_fix"]
    variances = [p.covariance[0, 0] for p in of(outputs, PoseWithCovarianceStamped)]
    assert {i.verdict for i in fixes} == {Verdict.USED, Verdict.REFUSED}
    # a fix is used only when the filter is worse than it, 2 m: together they are no better than 2 m / sqrt(2)
    assert min(variances) > 0.99 * 2.0


@pytest.mark.parametrize("lost", [3, 6])
def test_a_lost_composite_is_bridged_and_said_so(lost: int) -> None:
    run = river(clutter=0.0)
    entries = [e for e in run.entries if not (isinstance(e[1], CompositeMeasurement) and e[1].sequence == lost)]
    outputs = feed(Global(GlobalParameters()), entries)
    assert any("bridged" in i.reason for i in of(outputs, Innovation))
    last = of(outputs, PoseWithCovarianceStamped)[-1]
    error = last.pose.position - run.truth[last.stamp_ns][:3]
    spread = last.covariance[:2, :2]
    assert error[:2] @ np.linalg.solve(spread, error[:2]) < 13.8  # 99.9 % of chi-square 2


def test_a_composite_seen_before_is_refused_by_reason_and_changes_nothing() -> None:
    run = river()
    composites = [e for e in run.entries if isinstance(e[1], CompositeMeasurement)]
    estimator = Global(GlobalParameters(), run.prior)
    feed(estimator, run.entries)
    before = flat([Output("", h.state) for h in estimator._bank.all])  # type: ignore[union-attr, arg-type]
    estimator.put(*composites[3])
    outputs = estimator.advance(run.entries[-1][1].stamp_ns)
    refused = [i for i in of(outputs, Innovation) if i.verdict is Verdict.REFUSED]
    assert "covered already" in refused[0].reason
    assert before == flat([Output("", h.state) for h in estimator._bank.all])  # type: ignore[union-attr, arg-type]


@pytest.mark.parametrize("bad", ["nan", "inf", "negative", "asymmetric"])
def test_a_broken_fix_is_refused_and_counted(bad: str) -> None:
    covariance = {
        "nan": np.full((2, 2), np.nan),
        "inf": np.full((2, 2), np.inf),
        "negative": -np.eye(2),
        "asymmetric": np.array([[1.0, 0.9], [0.0, 1.0]]),
    }[bad]
    estimator = Global(GlobalParameters())
    estimator.put("reference/fix", ReferenceFix(NS, "map", np.zeros(2), covariance, np.eye(2)))
    answers = of(estimator.advance(2 * NS), Innovation)
    assert [a.verdict for a in answers] == [Verdict.REFUSED]
    assert estimator.health().values["count reference/fix refused"] == 1


def test_a_fix_waits_for_the_odometry_of_its_time_and_is_refused_without() -> None:
    estimator = Global(GlobalParameters())
    estimator.put("reference/fix", ReferenceFix(NS, "map", np.zeros(2), np.eye(2), np.eye(2)))
    assert not of(estimator.advance(2 * NS), Innovation)
    assert "no odometry" in of(estimator.advance(10 * NS), Innovation)[0].reason


def test_a_clock_that_goes_back_starts_it_anew() -> None:
    run = river()
    estimator = Global(GlobalParameters(), run.prior)
    feed(estimator, run.entries)
    outputs = estimator.advance(50 * NS)
    assert "clock went back" in of(outputs, Innovation)[0].reason
    again = feed(estimator, run.entries)
    assert of(again, LocalizationStatus)[-1].state is Localization.MATCHED


def test_no_number_published_is_not_a_number() -> None:
    run = river()
    for output in feed(Global(GlobalParameters(), run.prior), run.entries):
        record = output.record
        for name in record.__dataclass_fields__:
            value = getattr(record, name)
            if isinstance(value, np.ndarray | float):
                assert np.isfinite(value).all(), (output.topic, name)


def test_an_empty_map_matches_nothing() -> None:
    run = river()
    outputs = feed(Global(GlobalParameters(), PriorMap(())), run.entries)
    assert {s.state for s in of(outputs, LocalizationStatus)} == {Localization.UNMATCHED}


def test_a_composite_that_contradicts_its_base_is_gated_and_bridged() -> None:
    """One window's drift is said to be 1 m/s off, at a sigma of 0.03: no chance, so it is not believed."""
    run = river(clutter=0.0)
    entries = list(run.entries)
    at = next(k for k, e in enumerate(entries) if isinstance(e[1], CompositeMeasurement) and e[1].sequence == 4)
    composite = entries[at][1]
    assert isinstance(composite, CompositeMeasurement)
    mean = composite.mean.copy()
    mean[-3] += 1.0
    entries[at] = (entries[at][0], replace(composite, mean=mean))
    outputs = feed(Global(GlobalParameters()), entries)
    assert [i.stamp_ns for i in of(outputs, Innovation) if i.verdict is Verdict.GATED] == [composite.stamp_ns]
    last = of(outputs, PoseWithCovarianceStamped)[-1]
    error = last.pose.position[:2] - run.truth[last.stamp_ns][:2]
    assert error @ np.linalg.solve(last.covariance[:2, :2], error) < 13.8  # 99.9 % of chi-square 2


def test_a_tracker_that_starts_anew_with_its_old_keys_is_not_taken_for_the_old_one() -> None:
    """The second run's keys and sequences are the first's again; the match is kept, and still right."""
    run, again = river(clutter=0.0), river(seed=5, clutter=0.0)
    end = max(record.stamp_ns for _, record in run.entries)
    shift = end - 100 * NS + 5 * NS
    later = [(t, moved(r, shift)) for t, r in again.entries if t in ("tracking/composite", "deadreck/odometry")]
    estimator = Global(GlobalParameters(), run.prior)
    feed(estimator, run.entries)
    outputs = feed(estimator, later)
    assert not [i for i in of(outputs, Innovation) if i.sensor == "composite" and i.verdict is not Verdict.USED]
    for h in of(outputs, MatchHypotheses)[-1].hypotheses[:1]:
        assert all(again.key_feature[k] >= 0 for k in h.feature_keys)


def moved(record: Record, shift_ns: int) -> Record:
    if isinstance(record, CompositeMeasurement):
        return replace(record, stamp_ns=record.stamp_ns + shift_ns, start_ns=record.start_ns + shift_ns)
    return replace(record, stamp_ns=record.stamp_ns + shift_ns)
