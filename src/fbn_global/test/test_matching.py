"""Pairs, sets of pairs, joint compatibility: against plain numpy and by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbn_common.types import Array
from fbn_global.jcbb import chi_square_99, jcbb
from fbn_global.matching import Problem
from fbn_global.state import Block, Kind, append, equate, start
from fbn_testing.plain_jcbb import PlainJcbb, crossing

NOISE = np.diag([0.25, 0.25, 1.0])


def joint(seed: int, found: int, maps: int, offset: Array) -> tuple[Array, Array]:
    """Found features upon map features but for an offset and noise, with the common error in the covariance."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(0, 80, (maps, 2)), np.full(maps, -4.0)])
    seen = places[:found] + offset + np.array([0.2, 0.2, 0.5]) * rng.standard_normal((found, 3))
    x = np.concatenate([seen.ravel(), places.ravel()])
    p = np.zeros((len(x), len(x)))
    common = np.diag([9.0, 9.0, 0.25])
    for i, j in itertools.product(range(found), range(found)):
        p[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = common
    p += np.diag([*([0.04, 0.04, 0.25] * found), *([0.1, 0.1, 0.25] * maps)])
    return x, p


def problem(x: Array, p: Array, found: int) -> Problem:
    maps = len(x) // 3 - found
    together = np.ones((found, found), dtype=np.bool_)
    allowed = np.ones((found, maps), dtype=np.bool_)
    return Problem(x, p, found, allowed, together, np.zeros(maps), np.full(found, np.log(1e4)), NOISE, 16.0)


def test_a_grown_set_finds_the_common_shift_from_any_true_anchor() -> None:
    x, p = joint(1, 5, 9, np.array([4.0, -3.0, 0.0]))
    task = problem(x, p, 5)
    for i in range(5):
        assert sorted(task.grow((i, i)).pairs) == [(k, k) for k in range(5)]


def test_the_log_ratio_of_a_set_is_the_log_density_of_all_its_differences_at_once() -> None:
    """Chain rule: pair by pair, each given the ones before, makes the joint density of the stacked differences."""
    x, p = joint(2, 3, 4, np.array([2.0, 1.0, 0.0]))
    grown = problem(x, p, 3).grow((0, 0))
    h = np.zeros((9, len(x)))
    for row, (i, j) in enumerate(grown.pairs):
        h[3 * row : 3 * row + 3, 3 * i : 3 * i + 3] = np.eye(3)
        h[3 * row : 3 * row + 3, 9 + 3 * j : 12 + 3 * j] = -np.eye(3)
    s = h @ p @ h.T + np.kron(np.eye(3), NOISE)
    r = h @ x
    expected = -0.5 * (r @ np.linalg.solve(s, r) + np.linalg.slogdet(2 * np.pi * s)[1]) + 3 * np.log(1e4)
    np.testing.assert_allclose(grown.log_ratio, expected, rtol=1e-9)


def test_two_objects_seen_at_one_time_are_never_one_feature_of_the_map() -> None:
    x, _ = joint(3, 1, 1, np.zeros(3))
    x = np.concatenate([x[:3], x[:3] + 0.1, x[3:]])
    p = np.diag(np.full(9, 0.1))
    both = problem(x, p, 2)
    assert len(both.grow().pairs) == 1
    apart = both._replace(together=np.eye(2, dtype=np.bool_))
    assert len(apart.grow().pairs) == 2


def test_true_anchors_are_the_best_supported() -> None:
    x, p = joint(4, 6, 12, np.array([5.0, 2.0, 0.0]))
    assert {i == j for i, j in problem(x, p, 6).anchors(2.0, 6)} == {True}


def brute_force(x: Array, p: Array, found: int, maps: int, dims: int, noise: Array) -> tuple[int, float]:
    """Number of pairs and distance of the best jointly compatible set, by trying all."""
    best = (0, 0.0)
    for choice in itertools.product(range(-1, maps), repeat=found):
        pairs = [(i, j) for i, j in enumerate(choice) if j >= 0]
        if not pairs or len({j for _, j in pairs}) < len(pairs):
            continue
        h = np.zeros((dims * len(pairs), len(x)))
        for row, (i, j) in enumerate(pairs):
            h[dims * row : dims * row + dims, dims * i : dims * i + dims] = np.eye(dims)
            h[dims * row : dims * row + dims, dims * (found + j) : dims * (found + j) + dims] = -np.eye(dims)
        r = h @ x
        d2 = float(r @ np.linalg.solve(h @ p @ h.T + np.kron(np.eye(len(pairs)), noise), r))
        if d2 < chi_square_99(dims * len(pairs)) and (len(pairs) > best[0] or (len(pairs) == best[0] and d2 < best[1])):
            best = (len(pairs), d2)
    return best


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(1, 4))
def test_branch_and_bound_finds_what_trying_all_sets_finds(seed: int, found: int, maps: int) -> None:
    """True for sets all of whose prefixes are compatible; the search prunes the others, as the method does."""
    rng = np.random.default_rng(seed)
    n = 2 * (found + maps)
    root = rng.standard_normal((n, n)) / np.sqrt(n)
    p = 4.0 * root @ root.T + 0.5 * np.eye(n)
    x = np.concatenate([rng.uniform(0, 8, 2 * found), rng.uniform(0, 8, 2 * maps)])
    noise = 0.2 * np.eye(2)
    result = jcbb(x, p, found, np.ones((found, maps), dtype=np.bool_), noise, 2, 100_000)
    count, distance = brute_force(x, p, found, maps, 2, noise)
    pairs = sum(a >= 0 for a in result.assigned)
    assert result.complete
    assert pairs <= count
    if pairs == count:
        assert result.distance >= distance - 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_branch_and_bound_is_the_plain_one_faster(seed: int) -> None:
    x, p, gate = crossing(seed, 6, 30, 3.0)
    result = jcbb(x, p, 6, gate, 0.25 * np.eye(2), 2, 1_000_000)
    plain = PlainJcbb(x, p, 6, gate, 0.25 * np.eye(2), 2)
    plain.search([], 0, 0.0)
    assert list(result.assigned) == plain.best
    np.testing.assert_allclose(result.distance, plain.distance, rtol=1e-9)


def test_branch_and_bound_stops_at_its_limit_and_says_so() -> None:
    x = np.random.default_rng(0).uniform(0, 20, 2 * 16)
    p = 4.0 * np.eye(2 * 16)
    result = jcbb(x, p, 8, np.ones((8, 8), dtype=np.bool_), np.eye(2), 2, 50)
    assert not result.complete
    assert result.nodes <= 60


def test_equating_two_points_in_the_kernel_is_the_states_own_update() -> None:
    x, p = joint(5, 2, 2, np.array([1.0, 0.0, 0.0]))
    blocks = (Block(Kind.FOUND, 1), Block(Kind.FOUND, 2), Block(Kind.MAP, 0), Block(Kind.MAP, 1))
    state = append(start(np.zeros(6), np.eye(6), np.eye(3)), blocks, x, p, np.zeros((12, 9)))
    one = equate(state, blocks[0], blocks[2], NOISE)
    both = equate(one.state, blocks[1], blocks[3], NOISE)
    grown = problem(x, p, 2).grow((0, 0))
    np.testing.assert_allclose(grown.log_ratio, one.log_likelihood + both.log_likelihood + 2 * np.log(1e4), rtol=1e-9)
