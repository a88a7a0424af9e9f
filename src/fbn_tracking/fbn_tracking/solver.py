"""Damped Gauss-Newton on a whole window, and the square-root marginal of some of its variables."""

from __future__ import annotations

from typing import Any, NamedTuple

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from fbn_common.types import Array

_ITERATIONS = 25
_CONVERGED = 1e-9  # of the energy
_THETA = gtsam.noiseModel.Unit.Create(3)


class Solution(NamedTuple):
    """The optimum, the graph linearised there, and its energy (half the sum of squares)."""

    values: gtsam.Values
    linear: Any
    energy: float


def solve(graph: Any, values: gtsam.Values, features: list[int]) -> Solution:
    """Gauss-Newton that damps theta alone, the one direction in which the model is far from linear.

    Raises RuntimeError where the system is indeterminate.
    """
    damping, energy = 1e-2 if features else 0.0, float(graph.error(values))
    linear = graph.linearize(values)
    for _ in range(_ITERATIONS):
        candidate = values.retract(_damped(linear, features, damping).optimize())
        value = float(graph.error(candidate))
        if not np.isfinite(value) or value > energy + _CONVERGED * (1.0 + energy):
            if damping > 1e9 or not features:
                break
            damping = max(damping * 8.0, 1e-2)
            continue
        done = energy - value < _CONVERGED * (1.0 + value)
        values, energy, damping = candidate, value, damping * 0.1
        linear = graph.linearize(values)
        if done:
            break
    return Solution(values, linear, energy)


def _damped(linear: Any, features: list[int], damping: float) -> Any:
    if damping < 1e-9:
        return linear
    damped, root = linear.clone(), np.diag([0.0, 0.0, damping**0.5])
    for key in features:
        damped.add(key, root, np.zeros(3), _THETA)
    return damped


def square_root_covariance(linear: Any, keys: list[int]) -> Array:
    """``S`` with ``S S^T`` the joint covariance of ``keys`` in their order, by QR; no information matrix is formed."""
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    A, _ = linear.marginal(keys, gtsam.EliminateQR).jacobian(ordering)
    R = np.linalg.qr(np.array(A), mode="r")
    return np.asarray(solve_triangular(R, np.eye(R.shape[1])))
