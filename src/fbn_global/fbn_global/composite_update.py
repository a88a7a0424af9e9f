"""A composite measurement as what it adds to a state: information on its base, then pose and features after it.

Given base (z, roll, pitch, yaw) and drift ``u``, the composite's P2 and features ``w`` are independent of all that
the state knows else: the state takes up the conditional ``w = w0 + G (u - u0) + e``, ``Cov(e) = C_ww - G C_uw``,
``G = C_wu C_uu^-1``.  What it says of ``u`` itself is its information less that of the prior put into it,
``C_uu^-1 - C_p^-1``; so nothing is counted twice.  Directions in which that is not positive carry none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fbn_common.records import CompositeMeasurement
from fbn_common.types import Array
from fbn_global.state import (
    HEAD,
    LOCAL,
    XY,
    Block,
    Conditioned,
    Kind,
    State,
    advance_head,
    condition,
    conditional,
    equate,
    remove,
)

_LEAST = 1e-9  # information gained, relative to the prior's, below which a direction counts as empty


class CompositeError(ValueError):
    """A composite measurement that can't be used, and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Snippet:
    """A composite taken apart; ``u`` is base z, roll, pitch, yaw and drift, ``w`` is P2 and the features."""

    composite: CompositeMeasurement
    u: Array  # (7,)
    u_covariance: Array  # (7, 7)
    w: Array  # (6 + 3 n,)
    gain: Array  # (6 + 3 n, 7)
    noise: Array  # (6 + 3 n, 6 + 3 n)
    seen: Array  # (k, 7): directions of u in which the composite adds information
    values: Array  # (k,): measured along them, relative to the prior's mean
    variances: Array  # (k,)

    @property
    def keys(self) -> tuple[int, ...]:
        return tuple(f.key for f in self.composite.features)

    def without_information(self) -> Snippet:
        """The same with nothing to say of its base: for a state that took base and drift from it whole."""
        return replace(self, seen=self.seen[:0], values=self.values[:0], variances=self.variances[:0])


def take_apart(composite: CompositeMeasurement) -> Snippet:
    """The parts of a composite; CompositeError says what is malformed."""
    n = len(composite.features)
    mean, covariance = composite.mean, composite.covariance
    if mean.shape != (13 + 3 * n,) or covariance.shape != (13 + 3 * n, 13 + 3 * n):
        raise CompositeError(f"{n} features need {13 + 3 * n} numbers, got {mean.shape} and {covariance.shape}")
    if composite.prior_mean.shape != (7,) or composite.prior_covariance.shape != (7, 7):
        raise CompositeError("the prior needs 7 numbers and their covariance")
    if len({f.key for f in composite.features}) != n:
        raise CompositeError("a key occurs twice")
    if not composite.drift_time_constant > 0.0 or composite.start_ns >= composite.stamp_ns:
        raise CompositeError("duration and drift time constant must be positive")
    for name, matrix in (("covariance", covariance), ("prior covariance", composite.prior_covariance)):
        _check_definite(name, matrix)
    if not (np.isfinite(mean).all() and np.isfinite(composite.prior_mean).all()):
        raise CompositeError("the mean is not finite")
    return _split(composite, _symmetric(covariance), n)


def _split(composite: CompositeMeasurement, covariance: Array, n: int) -> Snippet:
    u_at = np.r_[0:4, 10 + 3 * n : 13 + 3 * n]
    w_at = np.arange(4, 10 + 3 * n)
    uu, wu = covariance[np.ix_(u_at, u_at)], covariance[np.ix_(w_at, u_at)]
    gain, explained = conditional(uu, wu)
    noise = _symmetric(covariance[np.ix_(w_at, w_at)] - explained)
    seen, values, variances = _gained(
        composite.mean[u_at], uu, composite.prior_mean, _symmetric(composite.prior_covariance)
    )
    return Snippet(composite, composite.mean[u_at], uu, composite.mean[w_at], gain, noise, seen, values, variances)


def _gained(u: Array, covariance: Array, prior: Array, prior_covariance: Array) -> tuple[Array, Array, Array]:
    """Directions (k, 7), values (k,) and variances (k,) of the information in ``u`` beyond that of the prior."""
    lower = np.linalg.cholesky(prior_covariance)
    pull = lower.T @ np.linalg.inv(covariance)
    excess, vectors = np.linalg.eigh(_symmetric(pull @ lower) - np.eye(7))  # relative to the prior's information
    kept = excess > _LEAST
    excess, vectors = excess[kept], vectors[:, kept]
    seen = np.linalg.solve(lower.T, vectors).T
    values = (vectors.T @ pull @ angular(u - prior)) / excess
    return seen, values, 1.0 / excess


def angular(difference: Array) -> Array:
    """A difference of ``u`` with roll and yaw brought into [-pi, pi)."""
    out = difference.copy()
    out[[1, 3]] = (out[[1, 3]] + np.pi) % (2.0 * np.pi) - np.pi
    return out


class Taken(NamedTuple):
    """A state with the composite in it, the log likelihood of all that was compared, and the NIS with its dof."""

    state: State
    log_likelihood: float
    nis: float
    dof: int


def take_up(state: State, snippet: Snippet, aliases: dict[int, int], key_sigma: float) -> Taken:
    """The state at P2 of a composite that starts at the state's own pose."""
    informed = inform_base(state, snippet)
    moved = move_on(informed.state, snippet, aliases)
    merged, log_likelihood, nis, count = _merge_keys(moved, snippet, aliases, key_sigma)
    return Taken(merged, informed.log_likelihood + log_likelihood, informed.nis + nis, len(snippet.values) + 3 * count)


def inform_base(state: State, snippet: Snippet) -> Conditioned:
    """The state with what the composite learnt about its base and the drift."""
    if len(snippet.values) == 0:
        return Conditioned(state, 0.0, 0.0)
    offset = snippet.seen @ angular(state.mean[LOCAL] - snippet.composite.prior_mean)
    columns = np.arange(LOCAL.start, LOCAL.stop)
    return condition(state, columns, snippet.seen, snippet.values - offset, np.diag(snippet.variances))


def move_on(state: State, snippet: Snippet, aliases: dict[int, int]) -> State:
    """The state at P2, with the base as an origin and the composite's features; keys held already come as fresh."""
    rows = len(snippet.w)
    jacobian = np.zeros((rows + 2, HEAD))
    offset, noise = np.zeros(rows + 2), np.zeros((rows + 2, rows + 2))
    at = np.r_[0:6, 8 : rows + 2]  # the origin comes between the pose and the features
    jacobian[at, LOCAL] = snippet.gain
    # the gain acts on the deviation from the composite's own base, whose angles may be a turn apart
    linear_at = state.mean[LOCAL] - angular(state.mean[LOCAL] - snippet.u)
    offset[at] = snippet.w - snippet.gain @ linear_at
    noise[np.ix_(at, at)] = snippet.noise
    for first in (0, 6, *range(8, rows + 2, 3)):
        jacobian[first : first + 2, XY] += np.eye(2)
    return advance_head(state, jacobian, offset, noise, (_origin(snippet), *_blocks(state, snippet, aliases)))


def _origin(snippet: Snippet) -> Block:
    return Block(Kind.ORIGIN, snippet.composite.sequence)


def _blocks(state: State, snippet: Snippet, aliases: dict[int, int]) -> tuple[Block, ...]:
    def block(key: int) -> Block:
        held = Block(Kind.FOUND, aliases.get(key, key)) in state
        return Block(Kind.FRESH if held else Kind.FOUND, key)

    return tuple(block(key) for key in snippet.keys)


def _merge_keys(
    state: State, snippet: Snippet, aliases: dict[int, int], sigma: float
) -> tuple[State, float, float, int]:
    """Features that the tracker knows again by their key become one with their older selves."""
    log_likelihood, nis, fresh = 0.0, 0.0, [k for k in snippet.keys if Block(Kind.FRESH, k) in state]
    for key in fresh:
        merged = equate(state, Block(Kind.FRESH, key), Block(Kind.FOUND, aliases.get(key, key)), sigma**2 * np.eye(3))
        state, log_likelihood, nis = merged.state, log_likelihood + merged.log_likelihood, nis + merged.nis
    return remove(state, {Block(Kind.FRESH, k) for k in fresh}), log_likelihood, nis, len(fresh)


def _check_definite(name: str, matrix: Array) -> None:
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-9):
        raise CompositeError(f"the {name} is not finite and symmetric")
    try:
        np.linalg.cholesky(_symmetric(matrix))
    except np.linalg.LinAlgError as error:
        raise CompositeError(f"the {name} is not positive definite") from error


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))
