"""Surgery on Gaussians outside the kernels: taking over considered parameters, and subtracting information."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from fbn_common.types import Array


def adopt_covariance(p: Array, states: slice, covariance: Array) -> None:
    """Give the considered ``states`` of ``p`` (n, n) the covariance (m, m), in place; correlations follow.

    In the basis where the old covariance is I and the new one diagonal, a direction that became better known (by
    the others' measurements, of which the rest of the state knows nothing) keeps that share of its correlation;
    one that became less known keeps all of it.  So ``p`` stays positive definite.
    """
    old = np.linalg.cholesky(p[states, states])
    whitened = solve_triangular(old, solve_triangular(old, covariance, lower=True).T, lower=True)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    basis = old @ vectors
    keep = basis @ np.diag(np.minimum(values, 1.0)) @ solve_triangular(old.T, vectors).T
    cross = p[:, states] @ keep.T
    p[:, states] = cross
    p[states, :] = cross.T
    p[states, states] = 0.5 * (covariance + covariance.T)


def gained_information(before: Array, after: Array) -> Array:
    """Information (n, n) that takes covariance ``before`` to ``after``; none in directions where that is not positive.

    ``after^-1 = before^-1 + information`` wherever information was gained; positive semidefinite always.
    """
    factor = np.linalg.cholesky(before)
    whitened = factor.T @ np.linalg.solve(after, factor)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    half = solve_triangular(factor, vectors, trans="T", lower=True) * np.sqrt(np.maximum(values - 1.0, 0.0))
    return np.asarray(half @ half.T)
