"""Posteriors: of all the times that p is stated, p are right; and what the data can tell at all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fbn_bringup.evaluation.calibration import bins, expected_error
from fbn_global.naps import surplus_gains
from fbn_global.parameters import GlobalParameters, ScoringParameters
from fbn_testing.composite_world import World
from fbn_testing.ideal_observer import TRUTH, Belief, believe
from fbn_testing.matching_play import play
from fbn_testing.matching_worlds import drawn, rows_world


def test_a_bin_counts_what_was_stated_in_it_with_the_exact_bound() -> None:
    made = bins([(0.995, True)] * 20 + [(0.4, False)] * 3 + [(0.4, True)])
    assert [(b.count, b.stated, b.right) for b in made] == [
        (4, pytest.approx(0.4), 0.25),
        (20, pytest.approx(0.995), 1.0),
    ]
    # twenty of twenty: the 95 % bound of Clopper and Pearson is 0.025^(1/20)
    assert (made[1].low, made[1].high) == (pytest.approx(0.025 ** (1 / 20)), 1.0)
    assert made[0].honest and made[1].honest


def test_too_sure_is_not_honest() -> None:
    stated = [(0.97, True)] * 20 + [(0.97, False)] * 20
    assert not bins(stated)[0].honest
    assert expected_error(stated) == pytest.approx(0.47)


def test_the_farther_the_map_lies_off_the_less_can_be_told_of_its_rows() -> None:
    """At 10 m of 20 the shift by a row is as likely beforehand; beyond, likelier than the truth."""
    told = []
    for offset in (4.0, 8.0, 12.0):
        settings = replace(rows_world(1000, offset, 3), fix_sigma=0.1, map_error=0.05)
        told.append(believe(settings, World(settings).make(), GlobalParameters()).shifts[TRUTH])
    assert told[0] > told[1] > told[2]
    assert told[0] > 0.99


def test_the_observer_is_told_all_that_the_filter_finds_so_it_is_sure_where_the_filter_is() -> None:
    for seed in (1000, 1001):
        settings = rows_world(seed, 5.0, 3)
        run = World(settings).make()
        outcome = play(run, GlobalParameters())
        assert outcome.right
        assert believe(settings, run, GlobalParameters()).verdict(GlobalParameters().verdict) is True


@pytest.mark.parametrize(
    ("truth", "other", "null", "expected"),
    [(0.995, 0.001, 0.004, True), (0.001, 0.995, 0.004, False), (0.5, 0.499, 0.001, None), (0.992, 0.0, 0.008, None)],
)
def test_the_observer_decides_by_the_filters_own_rule(
    truth: float, other: float, null: float, expected: bool | None
) -> None:
    assert Belief({TRUTH: truth, (1, 0): other}, null).verdict(GlobalParameters().verdict) is expected


def test_a_pair_gains_less_where_objects_lie_close_together() -> None:
    """Three times as dense over a large sweep: a chance pair is three times as likely."""
    even, fields = (ScoringParameters(surplus_clustering=c, surplus_area=1e-3) for c in (1.0, 3.0))
    gain = surplus_gains(4, 2, 1e4, even) - surplus_gains(4, 2, 1e4, fields)
    assert gain == pytest.approx([1.0986, 1.0986], abs=1e-3)  # ln 3


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_of_all_the_times_that_it_is_nearly_sure_it_is_right() -> None:
    outcomes = [play(drawn(seed), GlobalParameters()) for seed in range(200)]
    made = bins([pair for o in outcomes for pair in o.calibration], (0.5, 0.9, 0.99, 1.0))
    assert all(b.high >= b.stated for b in made)
    assert sum(o.wrong_ever for o in outcomes) <= 2  # 1 in 100
