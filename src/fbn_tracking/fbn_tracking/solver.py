"""Damped Gauss-Newton on a whole window, and the square-root marginal of some of its variables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from fbn_common.types import Array

_ITERATIONS = 30
_CONVERGED = 1e-6  # of the energy: for fifty detections some 0.01 sigma off
_MOST_DAMPING = 1e8
_THETA = gtsam.noiseModel.Unit.Create(3)


Curvature = Callable[[gtsam.Values], dict[int, float]]
"""What Gauss-Newton leaves out of the second derivative of the energy by each feature's theta, never negative."""


class Solution(NamedTuple):
    """The optimum, the graph linearised there, and its energy (half the sum of squares)."""

    values: gtsam.Values
    linear: Any
    energy: float


def solve(graph: Any, values: gtsam.Values, curvature: Curvature) -> Solution:
    """Gauss-Newton with theta's missing curvature put back, and damped where the energy rises all the same.

    Theta is the one direction far from linear: ``u`` is cubic in it, and ranges are even functions of it, so that
    residuals bend the energy as much as slopes do.  Raises RuntimeError where the system is indeterminate.
    """
    linear = graph.linearize(values)
    damping, energy, missing = 0.0, float(linear.error(values.zeroVectors())), curvature(values)
    for _ in range(_ITERATIONS):
        candidate = values.retract(_curved(linear, missing, damping).optimize())
        there = graph.linearize(candidate)  # gives the energy too: most steps are accepted
        value = float(there.error(candidate.zeroVectors()))
        if not value <= energy + _CONVERGED * (1.0 + energy):
            damping = max(damping * 10.0, 10.0)
            if damping > _MOST_DAMPING or not missing:
                break
            continue
        done = energy - value < _CONVERGED * (1.0 + value)
        values, energy, linear, damping = candidate, value, there, damping * 0.1 if damping > 1.0 else 0.0
        if done:
            break
        missing = curvature(values)
    return Solution(values, linear, energy)


def _curved(linear: Any, missing: dict[int, float], damping: float) -> Any:
    curved = linear.clone()
    for key, weight in missing.items():
        if weight + damping > 0.0:
            curved.add(key, np.diag([0.0, 0.0, (weight + damping) ** 0.5]), np.zeros(3), _THETA)
    return curved


def square_root_covariance(linear: Any, keys: list[int]) -> Array:
    """``S`` with ``S S^T`` the joint covariance of ``keys`` in their order, by QR; no information matrix is formed."""
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    A, _ = linear.marginal(keys, gtsam.EliminateQR).jacobian(ordering)
    R = np.asarray(np.linalg.qr(np.array(A), mode="r"))
    return np.asarray(solve_triangular(R, np.eye(R.shape[1])))
