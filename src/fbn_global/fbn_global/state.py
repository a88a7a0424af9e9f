"""The joint Gaussian of one hypothesis, and all surgery on its mean and covariance.

Order: pose (x, y, z, roll, pitch, yaw), drift (world x, y and body forward [m/s]), then blocks: features of the
prior map and features found (x, y, z), and origins of past composites (x, y).  Everything is in ``map``.  With
roll, pitch and yaw as coordinates a composite measurement is linear in the state, so its update is exact.

States are values: every function gives a new one and leaves its argument alone, so hypotheses may share them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, solve_triangular

from fbn_common.types import Array

Indices = npt.NDArray[np.int64]

POSE = slice(0, 6)
XY = slice(0, 2)
LOCAL = slice(2, 9)  # z, roll, pitch, yaw, drift: what a composite knows of its base
DRIFT = slice(6, 9)
YAW = 5
HEAD = 9
_LOG_2PI = float(np.log(2.0 * np.pi))


class Kind(IntEnum):
    """What a block is."""

    MAP = 0  # a feature of the prior map, by its row in the field
    FOUND = 1  # a tracked feature, by its key
    ORIGIN = 2  # where a composite began, by its sequence
    FRESH = 3  # a tracked feature just added that has yet to be merged with its older self


class Block(NamedTuple):
    """The name of a part of the state."""

    kind: Kind
    id: int

    @property
    def width(self) -> int:
        return 2 if self.kind is Kind.ORIGIN else 3


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean (n,) and covariance (n, n), and where each block begins."""

    mean: Array
    covariance: Array
    starts: dict[Block, int]

    def __contains__(self, block: Block) -> bool:
        return block in self.starts

    def ids(self, kind: Kind) -> tuple[int, ...]:
        """The blocks of a kind, in their order in the state."""
        return tuple(b.id for b in self.starts if b.kind is kind)

    def span(self, block: Block) -> slice:
        start = self.starts[block]
        return slice(start, start + block.width)

    def columns(self, *blocks: Block) -> Indices:
        """Indices of these blocks' coordinates, one block after the other."""
        parts = [np.arange(self.starts[b], self.starts[b] + b.width) for b in blocks]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=int)

    def marginal(self, *blocks: Block) -> tuple[Array, Array]:
        """Mean and covariance of these blocks."""
        at = self.columns(*blocks)
        return self.mean[at], self.covariance[np.ix_(at, at)]


class Conditioned(NamedTuple):
    """A state after a measurement, with the measurement's log likelihood and normalised innovation squared."""

    state: State
    log_likelihood: float
    nis: float


def start(pose: Array, pose_covariance: Array, drift_covariance: Array) -> State:
    """A state of pose (6,), with covariance (6, 6), and zero drift (3, 3)."""
    covariance = np.zeros((HEAD, HEAD))
    covariance[POSE, POSE] = pose_covariance
    covariance[DRIFT, DRIFT] = drift_covariance
    return State(_wrapped(np.concatenate([pose, np.zeros(3)])), covariance, {})


def likelihood(state: State, columns: Indices, jacobian: Array, innovation: Array, noise: Array) -> tuple[float, float]:
    """Log likelihood and normalised square of an innovation (m,) whose Jacobian (m, k) is by these k columns."""
    s = jacobian @ state.covariance[np.ix_(columns, columns)] @ jacobian.T + noise
    return _log_normal(innovation, np.linalg.cholesky(_symmetric(s)))


def condition(state: State, columns: Indices, jacobian: Array, innovation: Array, noise: Array) -> Conditioned:
    """The Kalman update, as a symmetric downdate; the innovation is (m,), the Jacobian (m, k) by the k columns."""
    cross = state.covariance[:, columns] @ jacobian.T
    lower = np.linalg.cholesky(_symmetric(jacobian @ cross[columns] + noise))
    log_likelihood, nis = _log_normal(innovation, lower)
    gain = solve_triangular(lower, cross.T, lower=True)  # (m, n): P H' S^-1 H P = gain' gain
    mean = state.mean + gain.T @ solve_triangular(lower, innovation, lower=True)
    covariance = state.covariance - gain.T @ gain
    return Conditioned(replace(state, mean=_wrapped(mean), covariance=_symmetric(covariance)), log_likelihood, nis)


def equate(state: State, one: Block, other: Block, noise: Array) -> Conditioned:
    """Two blocks become one place, but for the noise: the pseudo-measurement ``x_one - x_other = 0``."""
    width = one.width
    jacobian = np.hstack([np.eye(width), -np.eye(width)])
    innovation = state.mean[state.span(other)] - state.mean[state.span(one)]
    return condition(state, state.columns(one, other), jacobian, innovation, noise)


def advance_head(state: State, jacobian: Array, offset: Array, noise: Array, added: tuple[Block, ...]) -> State:
    """A new pose, and blocks after it, as linear functions of the old pose and drift; the old pose is marginalised.

    ``jacobian`` (6 + k, 9) by pose and drift, ``offset`` (6 + k,), ``noise`` (6 + k, 6 + k): the pose's six rows first.
    """
    n, k = len(state.mean), len(offset) - 6
    rows = jacobian @ state.covariance[:HEAD]
    own = rows[:, :HEAD] @ jacobian.T + noise
    values = jacobian @ state.mean[:HEAD] + offset
    mean, covariance = np.empty(n + k), np.empty((n + k, n + k))
    mean[:n], mean[:6], mean[n:] = state.mean, values[:6], values[6:]
    covariance[6:n, 6:n] = state.covariance[6:, 6:]
    covariance[:6, 6:n], covariance[n:, 6:n] = rows[:6, 6:], rows[6:, 6:]
    covariance[6:n, :6], covariance[6:n, n:] = rows[:6, 6:].T, rows[6:, 6:].T
    covariance[:6, :6], covariance[:6, n:] = own[:6, :6], own[:6, 6:]
    covariance[n:, :6], covariance[n:, n:] = own[6:, :6], own[6:, 6:]
    return State(_wrapped(mean), _symmetric(covariance), _grown(state.starts, n, added))


def append(state: State, added: tuple[Block, ...], mean: Array, covariance: Array, cross: Array) -> State:
    """Blocks with mean (k,), covariance (k, k) and cross-covariance (k, n) with the state so far."""
    n = len(state.mean)
    joint = np.block([[state.covariance, cross.T], [cross, covariance]])
    return State(np.concatenate([state.mean, mean]), _symmetric(joint), _grown(state.starts, n, added))


def remove(state: State, blocks: set[Block]) -> State:
    """The marginal without these blocks."""
    kept = tuple(b for b in state.starts if b not in blocks)
    if len(kept) == len(state.starts):
        return state
    at = np.concatenate([np.arange(HEAD), state.columns(*kept)])
    return State(state.mean[at], state.covariance[np.ix_(at, at)], _grown({}, HEAD, kept))


def decay_drift(state: State, decay: float, stationary: Array) -> State:
    """The drift after a time of which ``decay = exp(-t / tau)``: an Ornstein-Uhlenbeck step towards (3, 3)."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    mean[DRIFT] *= decay
    covariance[DRIFT] *= decay
    covariance[:, DRIFT] *= decay
    covariance[DRIFT, DRIFT] += (1.0 - decay**2) * stationary
    return replace(state, mean=mean, covariance=covariance)


def restart(state: State, part: slice, mean: Array, covariance: Array) -> State:
    """This part of the head known anew, from nothing but this Gaussian: what tied it to the rest is given up."""
    new_mean, joint = state.mean.copy(), state.covariance.copy()
    new_mean[part] = mean
    joint[part], joint[:, part] = 0.0, 0.0
    joint[part, part] = covariance
    return replace(state, mean=_wrapped(new_mean), covariance=joint)


def conditional(prior: Array, into: Array) -> tuple[Array, Array]:
    """A Gaussian's regression: the gain ``K_into K^-1``, and ``K_into K^-1 K_into'``, the variance it explains."""
    factor = (np.linalg.cholesky(prior), True)
    gain = cho_solve(factor, into.T).T
    return gain, gain @ into.T


def _grown(starts: dict[Block, int], at: int, added: tuple[Block, ...]) -> dict[Block, int]:
    grown = dict(starts)
    for block in added:
        grown[block] = at
        at += block.width
    return grown


def _log_normal(innovation: Array, lower: npt.NDArray[np.floating[Any]]) -> tuple[float, float]:
    whitened = solve_triangular(lower, innovation, lower=True)
    nis = float(whitened @ whitened)
    return -0.5 * (nis + len(innovation) * _LOG_2PI) - float(np.log(np.diag(lower)).sum()), nis


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _wrapped(mean: Array) -> Array:
    """Roll and yaw brought into [-pi, pi)."""
    for angle in (3, YAW):
        mean[angle] = (mean[angle] + np.pi) % (2.0 * np.pi) - np.pi
    return mean
