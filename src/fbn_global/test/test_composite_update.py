"""Composites against one big linear Gaussian: exact, nothing counted twice, malformed ones refused by reason."""

from __future__ import annotations

from dataclasses import replace
from math import exp
from typing import Any

import numpy as np
import pytest

from fbn_common.records import CompositeMeasurement
from fbn_common.types import Array
from fbn_global.composite_update import CompositeError, take_apart, take_up
from fbn_global.state import DRIFT, LOCAL, POSE, Block, Kind, State, decay_drift, restart, start
from fbn_testing.composite_world import Settings, World, charles_river

KEY_SIGMA = 0.05
START = np.diag([4.0, 4.0, 1.0, 1.0, 1.0, 1.0])
SETTINGS = Settings(charles_river(3), ((-30.0, 5.0), (30.0, 8.0)), seed=3)


def composites(settings: Settings = SETTINGS) -> list[CompositeMeasurement]:
    return [r for _, r in World(settings).make().entries if isinstance(r, CompositeMeasurement)]


def filtered(chain: list[CompositeMeasurement], s: Settings = SETTINGS) -> State:
    """The filter's state after a chain."""
    state = start(np.zeros(6), START, np.eye(3))
    decay = exp(-s.window_s / s.drift_time)
    for composite in chain:
        snippet = take_apart(composite)
        if composite.first:
            state, snippet = restart(state, LOCAL, snippet.u, snippet.u_covariance), snippet.without_information()
        else:
            state = decay_drift(state, decay, s.drift_sigma**2 * np.eye(3))
        state = take_up(state, snippet, {}, KEY_SIGMA).state
    return state


class Batch:
    """All windows as one information matrix: per window base xy, base z and attitude, drift, P2, features."""

    def __init__(self, chain: list[CompositeMeasurement], s: Settings) -> None:
        self.index: dict[Any, int] = {}
        for k, c in enumerate(chain):
            names = [("pose", k + 1, axis) for axis in range(6)] + [("drift", k, axis) for axis in range(3)]
            names += [("feature", k, f.key, axis) for f in c.features for axis in range(3)]
            for name in [("pose", 0, axis) for axis in range(6)] + names:
                self.index.setdefault(name, len(self.index))
        n = len(self.index)
        self.information, self.pull = np.zeros((n, n)), np.zeros(n)
        self.add([[("pose", 0, 0)], [("pose", 0, 1)]], np.ones((2, 1)), np.zeros(2), np.linalg.inv(START[:2, :2]))
        first: dict[int, int] = {}
        for k, c in enumerate(chain):
            self.composite(k, c)
            decay = exp(-s.window_s / s.drift_time)
            for axis in range(3):
                if k:
                    weight = np.array([[1.0 / ((1.0 - decay**2) * s.drift_sigma**2)]])
                    self.add(
                        [[("drift", k, axis), ("drift", k - 1, axis)]], np.array([[1.0, -decay]]), np.zeros(1), weight
                    )
            for f in c.features:
                k0 = first.setdefault(f.key, k)
                for axis in range(3 if k0 != k else 0):
                    pair = [("feature", k, f.key, axis), ("feature", k0, f.key, axis)]
                    self.add([pair], np.array([[1.0, -1.0]]), np.zeros(1), np.eye(1) / KEY_SIGMA**2)
        self.covariance = np.linalg.inv(self.information)
        self.mean = self.covariance @ self.pull

    def add(self, rows: list[list[Any]], values: Array, z: Array, weight: Array) -> None:
        h = np.zeros((len(rows), len(self.pull)))
        for r, (names, row) in enumerate(zip(rows, values, strict=True)):
            h[r, [self.index[n] for n in names]] = row
        self.information += h.T @ weight @ h
        self.pull += h.T @ weight @ z

    def composite(self, k: int, c: CompositeMeasurement) -> None:
        names: list[list[Any]] = [[("pose", k, axis)] for axis in (2, 3, 4, 5)]
        names += [[("pose", k + 1, axis)] + ([("pose", k, axis)] if axis < 2 else []) for axis in range(6)]
        for f in c.features:
            names += [[("feature", k, f.key, a)] + ([("pose", k, a)] if a < 2 else []) for a in range(3)]
        names += [[("drift", k, axis)] for axis in range(3)]
        signs = [np.array([1.0, -1.0][: len(row)]) for row in names]
        self.add(names, signs, c.mean, np.linalg.inv(c.covariance))  # type: ignore[arg-type]
        if not c.first:
            base = [*names[:4], *names[-3:]]
            self.add(base, [np.ones(1)] * 7, c.prior_mean, -np.linalg.inv(c.prior_covariance))  # type: ignore[arg-type]

    def marginal(self, names: list[Any]) -> tuple[Array, Array]:
        at = [self.index[n] for n in names]
        return self.mean[at], self.covariance[np.ix_(at, at)]


def test_a_chain_of_composites_gives_what_one_batch_of_them_gives() -> None:
    chain = composites()
    state, batch = filtered(chain), Batch(chain, SETTINGS)
    last = len(chain)
    mean, covariance = batch.marginal(
        [("pose", last, a) for a in range(6)] + [("drift", last - 1, a) for a in range(3)]
    )
    # both solve one linear system; the batch inverts information of condition up to 1e9: 1e-16 * 1e9
    np.testing.assert_allclose(np.concatenate([state.mean[POSE], state.mean[DRIFT]]), mean, atol=1e-6)
    np.testing.assert_allclose(state.covariance[:9, :9], covariance, atol=1e-6, rtol=1e-5)
    first = {f.key: k for k, c in reversed(list(enumerate(chain))) for f in c.features}
    assert first
    for key, k in first.items():
        mean, covariance = batch.marginal([("feature", k, key, a) for a in range(3)])
        found, spread = state.marginal(Block(Kind.FOUND, key))
        np.testing.assert_allclose(found, mean, atol=1e-6)
        np.testing.assert_allclose(spread, covariance, atol=1e-6, rtol=1e-5)


def test_a_composite_that_learnt_nothing_of_its_base_leaves_base_and_drift_alone() -> None:
    """Its only knowledge of base and drift is the prior put in: the filter's own must not shrink by it again."""
    composite = composites()[1]
    n = len(composite.mean)
    u = np.r_[0:4, n - 3 : n]
    w = np.arange(4, n - 3)
    covariance = composite.covariance.copy()
    gain = np.linalg.solve(covariance[np.ix_(u, u)], covariance[np.ix_(u, w)]).T
    rest = covariance[np.ix_(w, w)] - gain @ covariance[np.ix_(u, w)]
    prior = composite.prior_covariance
    covariance[np.ix_(u, u)], covariance[np.ix_(w, u)] = prior, gain @ prior
    covariance[np.ix_(u, w)], covariance[np.ix_(w, w)] = (gain @ prior).T, rest + gain @ prior @ gain.T
    snippet = take_apart(replace(composite, covariance=covariance))
    state = restart(start(np.zeros(6), START, np.eye(3)), LOCAL, composite.prior_mean, prior)
    after = take_up(state, snippet, {}, KEY_SIGMA).state
    np.testing.assert_allclose(after.covariance[DRIFT, DRIFT], state.covariance[DRIFT, DRIFT], rtol=1e-6)


def test_the_base_is_informed_the_same_across_the_turn_of_yaw() -> None:
    """The same composite with all yaws a turn on: angles are equal modulo a turn, so is the result."""
    chain = composites()
    state = filtered(chain[:2])
    turned = replace(chain[2], mean=chain[2].mean.copy(), prior_mean=chain[2].prior_mean.copy())
    for vector, at in ((turned.mean, 3), (turned.mean, 9), (turned.prior_mean, 3)):
        vector[at] += 2 * np.pi
    one = take_up(state, take_apart(chain[2]), {}, KEY_SIGMA).state
    other = take_up(state, take_apart(turned), {}, KEY_SIGMA).state
    np.testing.assert_allclose(other.mean, one.mean, atol=1e-9)
    np.testing.assert_allclose(other.covariance, one.covariance, atol=1e-12)


def test_the_pose_is_as_uncertain_as_it_is_wrong_over_many_runs() -> None:
    """NEES of the pose after 10 windows over 60 runs: chi-square of 360 dof, 99.9 % inside 1 +- 3.3 sqrt(2 / 360)."""
    nees = []
    for seed in range(60):
        s = replace(SETTINGS, seed=seed, clutter=0.0)
        world = World(s)
        chain = [r for _, r in world.make().entries if isinstance(r, CompositeMeasurement)]
        state, truth = filtered(chain, s), world.run.truth[chain[-1].stamp_ns]
        origin = np.array([-30.0, 5.0]) + 2.0 * np.random.default_rng(seed).standard_normal(2)  # START's own error
        error = state.mean[POSE] - truth
        error[:2] += origin
        error[3:] = (error[3:] + np.pi) % (2 * np.pi) - np.pi
        nees.append(error @ np.linalg.solve(state.covariance[POSE, POSE], error))
    assert abs(np.mean(nees) / 6 - 1.0) < 3.3 * np.sqrt(2 / 360)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda c: {"mean": c.mean[:-1]}, "need"),
        (lambda c: {"mean": np.full_like(c.mean, np.nan)}, "not finite"),
        (lambda c: {"covariance": -c.covariance}, "not positive definite"),
        (lambda c: {"covariance": np.full_like(c.covariance, np.inf)}, "not finite"),
        (lambda c: {"prior_covariance": np.zeros((7, 7))}, "not positive definite"),
        (lambda c: {"start_ns": c.stamp_ns}, "duration"),
        (lambda c: {"drift_time_constant": 0.0}, "drift time constant"),
    ],
)
def test_a_malformed_composite_is_refused_by_reason(change: Any, reason: str) -> None:
    composite = composites()[1]
    with pytest.raises(CompositeError, match=reason):
        take_apart(replace(composite, **change(composite)))
