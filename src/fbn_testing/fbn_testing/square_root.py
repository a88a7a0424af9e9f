"""Two ways to the square root of a window's information: QR of its whitened Jacobian, or Cholesky of ``A^T A``.

Both give the same upper triangular ``R`` in exact arithmetic, with what the marginal of the last variables needs in
its lower right corner.  They differ in what rounding does: forming ``A^T A`` squares the condition number.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fbn_common.types import Array

Real = NDArray[Any]  # of the precision under study
_EXACT = np.longdouble  # the reference's: eps 1e-19 where the machine has 80 bits


class Conditions(NamedTuple):
    """Condition numbers, raw and with every column of ``A`` scaled to one, which no choice of units betters by much."""

    root: float
    root_scaled: float
    information: float  # of the matrix as formed in the precision; infinite where it is not positive definite


class Errors(NamedTuple):
    """What one way makes of a window in one precision."""

    failed: bool
    worst: float  # relative error of the worst variance, of any combination of the kept variables; NaN if failed


def corner_by_qr(A: Array, kept: int, dtype: type) -> Real:
    """``R`` (kept, kept) of the last ``kept`` columns of ``A`` (m, n), by QR in this precision."""
    R = np.asarray(np.linalg.qr(A.astype(dtype), mode="r"))
    return np.asarray(R[-kept:, -kept:])


def corner_by_cholesky(A: Array, kept: int, dtype: type) -> Real:
    """The same from the information matrix; LinAlgError where rounding made that indefinite."""
    return np.asarray(np.linalg.cholesky(information(A, dtype)).T[-kept:, -kept:])


def information(A: Array, dtype: type) -> Real:
    """``A^T A`` as formed in this precision."""
    rounded: Real = A.astype(dtype)
    return np.asarray(rounded.T @ rounded)


def reference_corner(A: Array, kept: int) -> Real:
    """The same by Householder reflections in extended precision, which no LAPACK offers.

    A reflection takes the rows alone that are not zero in its column: in a chain of poses these are few.
    """
    rest, n = A.astype(_EXACT), A.shape[1]
    rows = np.zeros((n, n), dtype=_EXACT)
    for j in range(n):
        hit = np.flatnonzero(rest[:, j])
        at = j + np.flatnonzero(rest[hit, j:].any(axis=0))
        block = _reflected(rest[np.ix_(hit, at)])
        rows[j, at] = block[0]
        rest[np.ix_(hit[1:], at)] = block[1:]
        rest[hit[0]] = 0.0
    return np.asarray(rows[-kept:, -kept:])


def _reflected(block: Real) -> Real:
    """``block`` after the reflection that leaves only the first entry of its first column."""
    v = block[:, 0].copy()
    v[0] += np.copysign(np.sqrt(v @ v), v[0])
    square = v @ v
    reflected = block - np.outer(v, (2.0 / square) * (v @ block))
    reflected[1:, 0] = 0.0
    return np.asarray(reflected)


def inverse(corner: Real) -> Real:
    """Inverse of an upper triangular matrix by back substitution, in its own precision."""
    n = len(corner)
    S = np.zeros_like(corner)
    for i in reversed(range(n)):
        S[i] = -corner[i, i + 1 :] @ S[i + 1 :]
        S[i, i] += 1.0
        S[i] /= corner[i, i]
    return S


def worst_error(corner: Real, S: Real) -> float:
    """Largest relative error of a variance, over all directions, where ``corner`` stands for the exact ``S^-1``.

    ``(corner S)^T (corner S)`` is the identity for the exact one, in any units.  The covariance itself is not formed:
    rounding its entries alone costs as much as rounding those of the information matrix.
    """
    M = corner.astype(_EXACT) @ S
    if not np.isfinite(M).all():
        return float("inf")
    gain = np.linalg.eigvalsh(np.asarray(M.T @ M - np.eye(len(M)), dtype=np.float64))
    return float("inf") if gain[0] <= -1.0 else float(np.abs(gain / (1.0 + gain)).max())


def errors(A: Array, kept: int, S: Real, by_qr: bool, dtype: type) -> Errors:
    """How far off the marginal of the last ``kept`` columns is; ``S``: the inverse of the reference's ``R``."""
    try:
        with np.errstate(all="ignore"):
            return Errors(False, worst_error((corner_by_qr if by_qr else corner_by_cholesky)(A, kept, dtype), S))
    except np.linalg.LinAlgError:
        return Errors(True, float("nan"))


def root_conditions(A: Array) -> tuple[float, float]:
    """Condition numbers of the square root, raw and scaled, by singular values in double precision."""
    scaled = A / np.linalg.norm(A, axis=0)
    values = [np.linalg.svd(_root(a), compute_uv=False) for a in (A, scaled)]
    return float(values[0][0] / values[0][-1]), float(values[1][0] / values[1][-1])


def _root(A: Array) -> Array:
    """Triangular, with the same singular values."""
    return np.asarray(np.linalg.qr(A, mode="r"))


def information_condition(A: Array, dtype: type) -> float:
    """Condition number of the information matrix as formed in this precision; infinite where not positive definite."""
    eigenvalues = np.linalg.eigvalsh(information(A, dtype))
    return float(eigenvalues[-1] / eigenvalues[0]) if eigenvalues[0] > 0.0 else float("inf")
