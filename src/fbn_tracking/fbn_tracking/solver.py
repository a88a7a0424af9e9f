"""Damped Gauss-Newton on a window, and the square root of the joint covariance of some of its variables."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtri

from fbn_common.types import Array
from fbn_tracking.elimination import (
    Whole,
    back_substitute,
    eliminate,
    energy_of,
    missing_curvatures,
    strengthened,
)
from fbn_tracking.system import Layout, State, System

_ITERATIONS = 30
_CONVERGED = 1e-6  # of the energy: for fifty detections some 0.01 sigma off
_MOST_DAMPING = 1e8
_NEAR_TURN, _NEAR_WAY, _NEAR_THETA = 0.01, 0.1, 0.02  # rad, m, rad: after smaller steps all is as good as linear


class Solution(NamedTuple):
    """An estimate; the border's triangle where the window was linearised last, and the energy there."""

    state: State
    layout: Layout
    corner: Array
    energy: float

    def root(self, columns: Whole) -> Array:
        """``S`` with ``S S^T`` the joint covariance of these columns of the border, in their order."""
        inverse, singular = dtrtri(self.corner)
        if singular or not np.isfinite(inverse).all():
            raise RuntimeError("a window's triangle is singular")
        return np.asarray(inverse[columns])


class _Looks(NamedTuple):
    """Measurements as the kernels take them."""

    base: Array
    motion: Array
    looks: Array
    at: Whole
    starts: Whole
    weak: float


class _Step(NamedTuple):
    """A linearised window, the measurements alone, reduced."""

    corner: Array
    right: Array
    chain: Array
    energy: float


def solve(system: System, start: State, kept: Iterable[int], exact: bool) -> Solution:
    """Gauss-Newton with theta's missing curvature put back, and damped where the energy rises all the same.

    Theta is the one direction far from linear: ``u`` is cubic in it, and ranges are even functions of it, so that
    residuals bend the energy as much as slopes do.  ``exact``: until the energy falls no more, and with the triangle
    at the optimum itself and of the measurements alone; else until what is left is nearly linear.  ``kept``: rows of
    poses in the border.  Raises RuntimeError where an estimate is not finite.
    """
    layout, made = system.layout(kept), _Looks(system.base, system.motion.view(), *system.sorted_looks(), system.weak)
    theta = layout.features + 2
    state, damping = start, 0.0
    here, missing = _linearise(made, state, layout), _missing(made, state)
    for _ in range(_ITERATIONS):
        corner, right = strengthened(here.corner, here.right, theta, missing + damping)
        border, poses = back_substitute(corner, right, here.chain, layout.poses)
        candidate = state.moved(border, poses, layout)
        if not (np.isfinite(candidate.T).all() and np.isfinite(candidate.q).all()):
            raise RuntimeError("a window's estimate is not finite")
        if not exact and _small(border, poses, layout):
            return Solution(candidate, layout, corner, here.energy)
        energy = energy_of(*made, *candidate)
        if not energy <= here.energy + _CONVERGED * (1.0 + here.energy):
            damping = max(damping * 10.0, 10.0)
            if damping > _MOST_DAMPING or not len(missing):
                break
            continue
        done = here.energy - energy < _CONVERGED * (1.0 + energy)
        state, damping = candidate, damping * 0.1 if damping > 1.0 else 0.0
        here, missing = _linearise(made, state, layout), _missing(made, state)
        if done:
            break
    corner = here.corner if exact else strengthened(here.corner, here.right, theta, missing)[0]
    return Solution(state, layout, corner, here.energy)


def _missing(made: _Looks, state: State) -> Array:
    return missing_curvatures(made.looks, made.at, state.T, state.q)


def _linearise(made: _Looks, state: State, layout: Layout) -> _Step:
    return _Step(*eliminate(*made, *state, layout.poses, layout.features, layout.top, layout.width))


def _small(border: Array, poses: Array, layout: Layout) -> bool:
    turn, way = np.abs(poses[:, :3]).max(), np.abs(poses[:, 3:]).max()
    theta = np.abs(border[layout.features + 2]).max(initial=0.0)
    return bool(turn < _NEAR_TURN and way < _NEAR_WAY and theta < _NEAR_THETA)
