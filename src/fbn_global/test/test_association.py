"""Which pairs a hypothesis may make: sets from its anchors, what excludes a pair, what comes into its state."""

from __future__ import annotations

import numpy as np
import pytest

from fbn_common.geodesy import GeodeticPoint, geodetic_from_enu
from fbn_common.prior_map import PriorFeature, PriorMap
from fbn_common.records import CompositeFeature, CompositeMeasurement, Pose, SweptArea
from fbn_common.types import NS, Array
from fbn_global.association import Associator
from fbn_global.bank import Bank
from fbn_global.field import Field, build_field, instantiate
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.memory import Memory
from fbn_global.parameters import GlobalParameters
from fbn_global.state import Block, Kind, append, start

DATUM = GeodeticPoint(42.0, -71.0, 0.0)
PLACES = np.array([[0.0, 0.0, -4.0], [17.0, 3.0, -4.0], [31.0, -6.0, -4.0], [48.0, 11.0, -4.0], [250.0, 0.0, -4.0]])
OFF = np.array([4.0, -3.0, 0.0])  # the map lies off by this much, less than its sigma of 5 m


def field() -> Field:
    points = [geodetic_from_enu(np.array([x, y, 0.0]), DATUM) for x, y, _ in PLACES]
    features = tuple(PriorFeature(k, g.latitude, g.longitude, -4.0) for k, g in enumerate(points))
    return build_field(PriorMap(features), DATUM, GlobalParameters().prior)


def composite(sequence: int, keys: tuple[int, ...], low: Array, size: int) -> CompositeMeasurement:
    """One that saw these keys and swept a square of so many cells of 2 m from a corner on, twenty scans each."""
    seen = tuple(CompositeFeature(k, 12, 18.0, sequence * NS, (sequence + 1) * NS) for k in keys)
    area = SweptArea(2.0, size, size, low, np.full(size * size, 20.0))
    pose, n = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])), 13 + 3 * len(keys)
    gaussian = (np.zeros(n), np.eye(n), np.zeros(7), np.eye(7))
    return CompositeMeasurement(
        (sequence + 1) * NS, "odom", sequence, sequence * NS, False, 24, 9.0, 600.0, seen, area, *gaussian, pose, pose
    )


def found(keys: tuple[int, ...], places: Array, xy_sigma: float = 0.5) -> Hypothesis:
    """A hypothesis without pairs: the vehicle at the origin, and these features seen from it, 0.3 m each."""
    state = start(np.zeros(6), np.diag([xy_sigma**2] * 2 + [0.01] * 4), 1e-4 * np.eye(3))
    for key, place in zip(keys, places, strict=True):
        cross = np.zeros((3, len(state.mean)))
        at = [0, 1, *(c for c in range(9, len(state.mean)) if (c - 9) % 3 < 2)]
        for axis in (0, 1):
            cross[axis, [c for c in at if (c if c < 2 else (c - 9) % 3) == axis]] = xy_sigma**2
        own = np.diag([xy_sigma**2 + 0.09] * 2 + [0.25])
        state = append(state, (Block(Kind.FOUND, key),), place, own, cross)
    return Hypothesis(0, -1, state, 0.0, score=Score(posterior=1.0))


def associator(*composites: CompositeMeasurement) -> Associator:
    memory = Memory()
    for c in composites:
        memory.add(c, np.zeros(2))
    return Associator(GlobalParameters(), memory)


WIDE = np.array([-20.0, -40.0])


def test_the_likeliest_set_pairs_what_lies_alike_though_the_map_is_off() -> None:
    a = associator(composite(0, (1, 2, 3), WIDE, 50))
    best, *others = a.sets(found((1, 2, 3), PLACES[:3] + OFF), field(), set())
    assert sorted(best.pairs) == [(1, 0), (2, 1), (3, 2)]
    assert all(other.log_ratio < best.log_ratio for other in others)


def test_a_set_that_is_known_is_not_given_again() -> None:
    a = associator(composite(0, (1, 2, 3), WIDE, 50))
    known = frozenset({(1, 0), (2, 1), (3, 2)})
    assert all(frozenset(s.pairs) != known for s in a.sets(found((1, 2, 3), PLACES[:3] + OFF), field(), {known}))


@pytest.mark.parametrize(("together", "expected"), [(True, 1), (False, 2)])
def test_two_features_seen_at_one_time_are_not_one_of_the_map(together: bool, expected: int) -> None:
    """Two found at one place: of one composite they are two objects, of two composites the same seen again."""
    sight = [(1, 2)] if together else [(1,), (2,)]
    a = associator(*(composite(k, keys, WIDE, 50) for k, keys in enumerate(sight)))
    here = np.array([PLACES[0] + OFF, PLACES[0] + OFF])
    best = a.sets(found((1, 2), here), field(), set())[0]
    assert len([pair for pair in best.pairs if pair[1] == 0]) == expected


def test_what_is_far_outside_the_gate_is_no_candidate() -> None:
    """Four sigma of map and vehicle, 20 m: the feature 250 m away can't be meant; with xy hardly known it can."""
    a = associator(composite(0, (1,), WIDE, 50))
    assert 4 not in a.candidates(found((1,), PLACES[:1]), field())
    assert 4 in a.candidates(found((1,), PLACES[:1], 200.0), field())


def test_a_hypothesis_is_extended_by_what_its_pairs_make_plain() -> None:
    a, f = associator(composite(0, (1, 2, 3, 4), WIDE, 50)), field()
    h = a.paired(found((1, 2, 3, 4), PLACES[:4] + OFF), ((1, 0), (2, 1)), f)
    longer = a.extended(h.with_state(instantiate(h.state, f, np.arange(5))), f)
    assert sorted(longer.pairs) == [(1, 0), (2, 1), (3, 2), (4, 3)]


def test_features_of_the_map_come_into_the_state_where_it_was_swept_and_only_there() -> None:
    a, f = associator(composite(0, (), WIDE, 40)), field()  # to x = 60 m, and 15 m of reach
    state = append(found((), PLACES[:0]).state, (Block(Kind.ORIGIN, 0),), np.zeros(2), np.eye(2), np.zeros((2, 9)))
    reached = a.in_reach(Hypothesis(0, -1, state, 0.0), f)
    assert reached.state.ids(Kind.MAP) == (0, 1, 2, 3)


def test_joint_compatibility_takes_one_set_as_if_it_were_sure() -> None:
    a = associator(composite(0, (1, 2, 3), WIDE, 50))
    pairs = a.jointly_compatible(found((1, 2, 3), PLACES[:3] + OFF), field())
    assert sorted(pairs) == [(1, 0), (2, 1), (3, 2)]


@pytest.mark.parametrize(("xy_sigma", "children"), [(40.0, True), (1.0, False)])
def test_a_hypothesis_that_lost_its_place_has_children_and_one_that_knows_it_has_none(
    xy_sigma: float, children: bool
) -> None:
    """It matched two features of the map before; now three are seen 17 m from where dead reckoning has them."""
    f, p = field(), GlobalParameters()
    h = found((1, 2, 3), PLACES[:3] + np.array([17.0, 0.0, 0.0]), xy_sigma)
    bank = Bank(h.state, p)
    bank.memory.add(composite(0, (1, 2, 3), WIDE, 50), np.zeros(2))
    before = Associator(p, bank.memory).paired(found((-1,), PLACES[3:4], 0.1), ((-1, 3),), f)
    rows = before.state.marginal(Block(Kind.MAP, 3))
    state = append(h.state, (Block(Kind.MAP, 3),), rows[0], rows[1], np.zeros((3, len(h.state.mean))))
    score = Score(positive=8.0, posterior=0.99)
    bank.rivals = [Hypothesis(7, 0, state, 8.0, ((-1, 3),), score=score)]
    bank._next = 8
    bank.associate(f)
    born = [r for r in bank.rivals if r.parent == 7]
    assert bool(born) is children
    if children:
        best = max(born, key=lambda r: r.score.posterior)
        assert set(best.pairs) == {(-1, 3), (1, 0), (2, 1), (3, 2)}
