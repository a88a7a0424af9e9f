"""The model run along the grid: the ring of states of the last seconds, and the compiled loop over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common.kernels import kernel
from fbn_common.lie import quaternion_from_matrix, so3_exp
from fbn_common.types import Array, Vec3
from fbn_predict.dynamics import COLUMNS, Model, step

_UNKNOWN_DEPTH = 1.0  # m, until dead reckoning says: neither at the surface nor out of the waves


class Ring(NamedTuple):
    """By grid stamp: the state, the parameters of the step that starts there, and dead reckoning's feedback."""

    velocity: Array  # (n, 6)
    attitude: Array  # (n, 3, 3)
    depth: Array  # (n,)
    parameters: Array  # (n, 15)
    feedback: npt.NDArray[np.bool_]  # (n,) whether there is any
    velocity_fed: Array  # (n, 6)
    attitude_fed: Array  # (n, 3, 3)
    depth_fed: Array  # (n,)


class Levels(NamedTuple):
    """Standing errors of velocity; see :class:`~fbn_predict.parameters.Noise`."""

    velocity: Vec3
    turn_rate: Vec3
    wave_turn: Vec3
    surge: float
    surge_time: float
    surge_depth: float


def new_ring(n: int) -> Ring:
    """A vehicle at rest, level, heading east."""
    level = np.tile(np.eye(3), (n, 1, 1))
    depth = np.full(n, _UNKNOWN_DEPTH)
    return Ring(
        np.zeros((n, 6)), level, depth, np.zeros((n, 15)),
        np.zeros(n, np.bool_), np.zeros((n, 6)), level.copy(), depth.copy(),
    )  # fmt: skip


@kernel
def noise_of_step(linear: Vec3, angular: Vec3, dt: float, q: Array) -> None:
    """Covariance (12, 12) of a step's white accelerations (power spectral densities, body axes)."""
    q[:] = 0.0
    for i in range(6):
        density = linear[i] if i < 3 else angular[i - 3]
        q[i, i] = density * dt**3 / 3.0
        q[i, 6 + i] = q[6 + i, i] = density * dt**2 / 2.0
        q[6 + i, 6 + i] = density * dt


@kernel
def _noise(p: Array, depth: float, levels: Levels, dt: float, q: Array) -> None:
    """A step's noise: a standing error s of velocity is kept up by white acceleration of density ``2 D s^2``."""
    fade = np.exp(-max(depth, 0.0) / levels.surge_depth)
    surge = levels.surge * fade
    linear, angular = np.empty(3), np.empty(3)
    for i in range(3):
        linear[i] = 2.0 * p[3 + i] * levels.velocity[i] ** 2 + 2.0 * levels.surge_time * (p[3 + i] * surge) ** 2
        angular[i] = 2.0 * p[6 + i] * (levels.turn_rate[i] ** 2 + (fade * levels.wave_turn[i]) ** 2)
    noise_of_step(linear, angular, dt, q)


@kernel
def roll(
    ring: Ring, first: int, actuators: Array, dt: float, model: Model, levels: Levels, wanted: bool,
    mean: Array, attitude: Array, jacobian: Array, noise: Array,
) -> None:  # fmt: skip
    """Step from slot ``first`` on, once per row of ``actuators`` (n, 5); feedback met on the way is taken over.

    Where wanted, row i of ``mean`` (increment 3, rotation 3, velocity at start 6, at end 6), ``attitude``
    (quaternion at start), ``jacobian`` (12, 24) and ``noise`` (12, 12) is filled for step i.
    """
    size = ring.depth.shape[0]
    y, s = np.empty(12), np.empty((12, COLUMNS))
    for i in range(actuators.shape[0]):
        k, n = (first + i) % size, (first + i + 1) % size
        if ring.feedback[k]:
            ring.velocity[k], ring.attitude[k], ring.depth[k] = (
                ring.velocity_fed[k],
                ring.attitude_fed[k],
                ring.depth_fed[k],
            )
        p, depth = ring.parameters[k], ring.depth[k]
        step(ring.velocity[k], ring.attitude[k], p, actuators[i], depth, dt, model, y, s, wanted)
        if wanted:
            mean[i, 0:6], mean[i, 6:12], mean[i, 12:18] = y[0:6], ring.velocity[k], y[6:12]
            attitude[i] = quaternion_from_matrix(ring.attitude[k])
            jacobian[i] = s
            _noise(p, depth, levels, dt, noise[i])
        turn = so3_exp(y[3:6])
        for a in range(3):
            for b in range(3):
                total = 0.0
                for c in range(3):
                    total += ring.attitude[k, a, c] * turn[c, b]
                ring.attitude[n, a, b] = total
        ring.velocity[n], ring.depth[n] = y[6:12], depth
