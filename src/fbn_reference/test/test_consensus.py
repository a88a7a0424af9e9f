"""Which beacons are believed: sets of ranges without noise, whose answer is known."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from fbn_common.types import Array
from fbn_reference import consensus as module
from fbn_reference.consensus import Consensus, Heard, consensus

GATE, MARGIN, SIGMA = 1e-4, 9.2, 0.6
BEACONS = {"a": (100.0, 80.0), "b": (-90.0, 100.0), "c": (20.0, -120.0), "d": (-80.0, -60.0)}
WIDE, UNKNOWN = 20.0**2 * np.eye(2), 1000.0**2 * np.eye(2)
LIE = 50.0  # m; by 30 m c would put the vehicle where it mirrors itself in a and d: nothing could tell
TRUE = np.array([14.0, -9.0])  # m, the position's error


def heard(name: str, lie: float = 0.0, count: int = 3, place: tuple[float, float] | None = None) -> Heard:
    """Ranges from a beacon 5 m under the vehicle, which is taken to be at the origin."""
    beacon = np.array([*(place or BEACONS[name]), -5.0])
    distance = float(np.linalg.norm(np.array([*TRUE, 0.0]) - beacon)) + lie
    return Heard(name, beacon, np.zeros((count, 3)), np.full(count, distance), np.full(count, SIGMA**2))


def agreed(prior: Array, *of: Heard) -> Consensus:
    found = consensus(prior, of, GATE, MARGIN)
    assert found is not None
    return found


@pytest.mark.parametrize("liar", BEACONS)
@pytest.mark.parametrize("prior", [WIDE, UNKNOWN], ids=["wide", "unknown"])
def test_of_four_beacons_the_one_that_lies_is_found_whatever_the_order(liar: str, prior: Array) -> None:
    honest = tuple(sorted(set(BEACONS) - {liar}))
    for order in permutations(BEACONS):
        found = agreed(prior, *(heard(n, LIE if n == liar else 0.0) for n in order))
        assert found.believed == honest
        assert not found.undecided
        # ranges without error: only the prior pulls, 16.6 m of 20 m against 0.6 m, of which a, c, d have least:
        # seen from there at 46, -87 and 208 deg, 0.6 of a beacon's information in one direction
        np.testing.assert_allclose(found.fit.offset, TRUE, atol=16.6 * (SIGMA / 20.0) ** 2 / 0.6)


def test_beacons_that_agree_are_all_believed() -> None:
    assert agreed(WIDE, *(heard(n) for n in BEACONS)).believed == tuple(BEACONS)


def test_one_beacon_alone_is_believed() -> None:
    assert agreed(WIDE, heard("a")).believed == ("a",)


def test_of_two_that_contradict_neither_is_believed() -> None:
    """Their circles miss one another by 60 m, 71 standard deviations of both."""
    found = agreed(WIDE, heard("a", -30.0), heard("d", -30.0))
    assert found.believed == ()
    assert found.undecided == ("a", "d")


def test_of_three_with_one_that_lies_none_is_believed_as_each_two_agree() -> None:
    found = agreed(UNKNOWN, heard("a", 30.0), heard("b"), heard("c"))
    assert found.believed == ()
    assert found.undecided == ("a", "b", "c")


def test_two_beacons_alone_do_not_tell_on_which_side_of_them_the_vehicle_is() -> None:
    found = agreed(UNKNOWN, heard("a"), heard("b"))
    assert found.mirrored
    assert found.believed == ()
    assert agreed(WIDE, heard("a"), heard("b")).believed == ("a", "b")  # the mirrored place is 200 m off


def test_one_outlier_of_three_replies_does_not_make_a_liar() -> None:
    spoilt = heard("a")
    spoilt.ranges[0] += 50.0
    assert agreed(WIDE, spoilt, heard("b"), heard("c")).believed == ("a", "b", "c")


def test_where_the_prior_rejects_every_beacon_nothing_is_decided() -> None:
    sure = 0.01 * np.eye(2)
    assert consensus(sure, [heard("a", 30.0)], GATE, MARGIN) is None


def test_nine_beacons_with_two_liars_cost_no_more_than_63_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []
    fit = module.fit
    monkeypatch.setattr(module, "fit", lambda *args: (tried.append(1), fit(*args))[1])
    angles = np.linspace(0.0, 6.0, 9)
    places = [(float(100.0 * np.cos(a)), float(100.0 * np.sin(a))) for a in angles]
    of = [heard(f"{i}", 30.0 if i in (2, 8) else 0.0, 3, p) for i, p in enumerate(places)]
    assert agreed(UNKNOWN, *of).believed == tuple(str(i) for i in (0, 1, 3, 4, 5, 6, 7))
    assert len(tried) <= 2**module.MOST  # the sets, and the fit of those believed
