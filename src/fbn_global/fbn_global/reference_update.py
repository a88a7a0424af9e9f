"""A reference fix against the state: tied to the state's pose by dead reckoning, used where it is the better one.

GPS errs slowly: consecutive fixes share their error.  So a fix counts only in directions in which the reference filter
is surer of its position than the state is at that time; under any number of fixes the state stays about as uncertain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.types import Array, Mat2, Vec2
from fbn_global.odometry import Link, Reckoned, xy_jacobian
from fbn_global.state import HEAD, State, condition, likelihood


class Fixed(NamedTuple):
    """What a fix did: the state after it, whether it was used, its log likelihood before, its innovation and sigma."""

    state: State
    used: bool
    log_likelihood: float
    innovation: Array
    sigma: Array
    nis: float


def apply_fix(state: State, start: Reckoned, tie: Link, xy: Vec2, covariance: Mat2, marginal: Mat2) -> Fixed:
    """The state after a fix at the link's end, used only in the directions in which its marginal is the smaller."""
    predicted, jacobian = xy_jacobian(state, start, tie)
    innovation, columns = xy - predicted, np.arange(HEAD)
    own = jacobian @ state.covariance[:HEAD, :HEAD] @ jacobian.T + tie.growth
    noise = covariance + tie.growth
    log_likelihood, nis = likelihood(state, columns, jacobian, innovation, noise)
    sigma = np.sqrt(np.diag(own + covariance))
    better = better_directions(marginal, own)
    if len(better):
        h = better @ jacobian
        state = condition(state, columns, h, better @ innovation, better @ noise @ better.T).state
    return Fixed(state, bool(len(better)), log_likelihood, innovation, sigma, nis)


def better_directions(covariance: Mat2, own: Mat2) -> Array:
    """Directions (k, 2), jointly diagonalising both, in which the covariance is smaller than the filter's own."""
    lower = np.linalg.cholesky(own)
    whitened = np.linalg.solve(lower, np.linalg.solve(lower, covariance).T)
    ratios, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    return np.asarray(np.linalg.solve(lower.T, vectors[:, ratios < 1.0]).T)
