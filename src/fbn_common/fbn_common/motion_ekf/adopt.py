"""Surgery on Gaussians outside the kernels: taking over considered parameters, and subtracting information."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtrs

from fbn_common.motion_ekf.layout import DAMPING, ROTATION, X_DEVIATION
from fbn_common.motion_ekf.monitor import all_finite
from fbn_common.records import VehicleParameters
from fbn_common.types import Array


def joint_covariance(record: VehicleParameters) -> Array:
    """Covariance (24, 24) of the 15 parameters and the further ones; (15, 15) where those are not stated."""
    if not record.further_covariance.any():
        return record.covariance
    joint = np.empty((24, 24))
    joint[:15, :15], joint[15:] = record.covariance, record.further_covariance
    joint[:15, 15:] = record.further_covariance[:, :15].T
    return joint


def usable_parameters(record: VehicleParameters) -> bool:
    """Whether all is finite, and the covariance one."""
    numbers = (record.mean, record.covariance, record.further, record.further_covariance)
    if not all_finite(*numbers):
        return False
    c = joint_covariance(record)
    symmetric, slack = 0.5 * (c + c.T), 1e-12 * np.trace(c)
    try:  # mostly this is all it takes, and an eighth of the eigenvalues' time
        np.linalg.cholesky(symmetric + slack * np.eye(len(c)))
    except np.linalg.LinAlgError:
        return bool(np.linalg.eigvalsh(symmetric)[0] >= -slack)
    return True


def adopt_covariance(p: Array, states: slice, covariance: Array, followers: slice = slice(0, 0)) -> None:
    """Give the considered ``states`` of ``p`` (n, n) the covariance (m, m), in place; correlations follow.

    In the basis where the old covariance is I and the new one diagonal, a direction that became better known (by
    the others' measurements, of which the rest of the state knows nothing) keeps that share of its correlation;
    one that became less known keeps all of it.  ``followers``, whose mean will follow the states', become better known
    as by a measurement of the states; all others stay as uncertain as they are, which against that measurement's
    posterior adds a positive semidefinite block (Schmidt).  So ``p`` stays positive definite.
    """
    old = np.asarray(np.linalg.cholesky(p[states, states]), np.float64)
    whitened = _solve_lower(old, _solve_lower(old, covariance).T)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    basis = old @ vectors
    kept, inverse = np.minimum(values, 1.0), _solve_lower(old, vectors, transposed=True)
    cross = p[:, states] @ (inverse * kept) @ basis.T
    learnt = p[:, states] @ inverse * np.sqrt(1.0 - kept)
    p[followers, :] -= learnt[followers] @ learnt.T
    p[:, followers] = p[followers, :].T
    p[:, states] = cross
    p[states, :] = cross.T
    p[states, states] = 0.5 * (covariance + covariance.T)


def _solve_lower(lower: Array, right: Array, *, transposed: bool = False) -> Array:
    """``lower^-1 right``, or of the transpose: LAPACK without the checks, which take longer than the work."""
    return np.asarray(dtrtrs(lower, right, lower=1, trans=int(transposed))[0])


class Adoptions:
    """Parameters that reference has found, by the timeline's slot at which each of them is taken over."""

    def __init__(self) -> None:
        self._records: dict[int, VehicleParameters] = {}

    def put(self, slot: int, record: VehicleParameters) -> None:
        """Take these over when the timeline comes to this slot."""
        self._records[slot] = record

    def adopt(self, slot: int, x: Array, p: Array) -> None:
        """Change a state and its covariance in place; the considered parameters' mean comes with each motion."""
        record = self._records.get(slot)
        if record is None:
            return
        known = joint_covariance(record)[3:, 3:]
        if len(known) > 12:
            x[X_DEVIATION:] = record.further
        states, attitude = slice(DAMPING, DAMPING + len(known)), slice(ROTATION, ROTATION + 3)
        adopt_covariance(p, states, known + 1e-12 * np.eye(len(known)), attitude)


def gained_information(before: Array, after: Array) -> Array:
    """Information (n, n) that takes covariance ``before`` to ``after``; none in directions where that is not positive.

    ``after^-1 = before^-1 + information`` wherever information was gained; positive semidefinite always.
    """
    factor = np.linalg.cholesky(before)
    whitened = factor.T @ np.linalg.solve(after, factor)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    half = solve_triangular(factor, vectors, trans="T", lower=True) * np.sqrt(np.maximum(values - 1.0, 0.0))
    return np.asarray(half @ half.T)
