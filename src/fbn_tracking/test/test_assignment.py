"""One-to-one assignment against enumeration."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from fbn_tracking.assignment import assign


def _best(costs, new):
    m, n = costs.shape
    options = itertools.product(range(-1, m), repeat=n)
    fair = (o for o in options if len({i for i in o if i >= 0}) == sum(i >= 0 for i in o))
    return min(sum(new if i < 0 else costs[i, j] for j, i in enumerate(o)) for o in fair)


@pytest.mark.parametrize("seed", range(20))
def test_the_total_is_the_least_of_all_one_to_one_assignments(seed):
    rng = np.random.default_rng(seed)
    costs = rng.uniform(0, 20, (rng.integers(1, 4), rng.integers(1, 5)))
    costs[rng.random(costs.shape) < 0.3] = np.inf
    found = assign(costs, 10.0)
    assert len(set(found.values())) == len(found)
    total = sum(costs[found[j], j] if j in found else 10.0 for j in range(costs.shape[1]))
    assert total == pytest.approx(_best(costs, 10.0))


def test_two_near_targets_keep_an_echo_each():
    assert assign(np.array([[1.0, 2.0], [1.5, 9.0]]), 14.0) == {0: 1, 1: 0}


def test_nothing_comes_of_nothing():
    assert assign(np.zeros((0, 3)), 1.0) == {}
    assert assign(np.zeros((3, 0)), 1.0) == {}
