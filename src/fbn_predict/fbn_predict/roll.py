"""The model run along the grid: the ring of states of the last seconds, and the compiled loop over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common.kernels import kernel
from fbn_common.lie import product, quaternion_from_matrix, so3_exp
from fbn_common.types import Array, Mat3, Vec3, Vec6
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


class Steps(NamedTuple):
    """The motions of some steps, as in :class:`~fbn_common.records.PredictedMotion` and in its order."""

    increment: Array  # (n, 3)
    rotation: Array  # (n, 3)
    velocity_start: Array  # (n, 6)
    velocity_end: Array  # (n, 6)
    parameters: Array  # (n, 15)
    jacobian_velocity: Array  # (n, 12, 6)
    jacobian_attitude: Array  # (n, 12, 3)
    jacobian_parameters: Array  # (n, 12, 15)
    noise: Array  # (n, 12, 12)
    attitude_start: Array  # (n, 4)


def new_steps(n: int) -> Steps:
    """Room for the motions of ``n`` steps."""
    shapes = ((3,), (3,), (6,), (6,), (15,), (12, 6), (12, 3), (12, 15), (12, 12), (4,))
    return Steps(*(np.empty((n, *shape)) for shape in shapes))


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
def _keep(made: Steps, i: int, velocity: Vec6, attitude: Mat3, p: Array, y: Array, s: Array) -> None:
    """Write down step ``i``: its start, its end ``y`` and the sensitivities ``s`` (12, 24)."""
    made.increment[i], made.rotation[i] = y[0:3], y[3:6]
    made.velocity_start[i], made.velocity_end[i] = velocity, y[6:12]
    made.parameters[i], made.attitude_start[i] = p, quaternion_from_matrix(attitude)
    for row in range(12):
        for j in range(6):
            made.jacobian_velocity[i, row, j] = s[row, j]
        for j in range(3):
            made.jacobian_attitude[i, row, j] = s[row, 6 + j]
        for j in range(15):
            made.jacobian_parameters[i, row, j] = s[row, 9 + j]


@kernel
def roll(
    ring: Ring, first: int, actuators: Array, dt: float, model: Model, levels: Levels, wanted: bool, made: Steps
) -> None:
    """Step from slot ``first`` on, once per row of ``actuators`` (n, 5); feedback met on the way is taken over.

    Where wanted, row i of ``made`` is filled for step i.
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
            _keep(made, i, ring.velocity[k], ring.attitude[k], p, y, s)
            _noise(p, depth, levels, dt, made.noise[i])
        ring.attitude[n] = product(ring.attitude[k], so3_exp(y[3:6]))
        ring.velocity[n], ring.depth[n] = y[6:12], depth
