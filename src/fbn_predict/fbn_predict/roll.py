"""The model run along the grid: the ring of states of the last seconds, and the compiled loop over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import product_into, quaternion_into, so3_exp_into
from fbn_common.types import Array, Mat3, Vec3, Vec6
from fbn_predict.dynamics import Model
from fbn_predict.sensitivity import COLUMNS, Scratch, new_scratch, step

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


@inner_kernel
def noise_of_step(linear: Vec3, angular: Vec3, dt: float, q: Array) -> None:
    """Covariance (12, 12) of a step's white accelerations (power spectral densities, body axes)."""
    for i in range(12):
        for j in range(12):
            q[i, j] = 0.0
    for i in range(6):
        density = linear[i] if i < 3 else angular[i - 3]
        q[i, i] = density * dt**3 / 3.0
        q[i, 6 + i] = q[6 + i, i] = density * dt**2 / 2.0
        q[6 + i, 6 + i] = density * dt


@inner_kernel
def _noise(p: Array, depth: float, levels: Levels, dt: float, densities: Array, q: Array) -> None:
    """A step's noise: a standing error s of velocity is kept up by white acceleration of density ``2 D s^2``."""
    fade = np.exp(-max(depth, 0.0) / levels.surge_depth)
    surge = levels.surge * fade
    linear, angular = densities[0], densities[1]
    for i in range(3):
        linear[i] = 2.0 * p[3 + i] * levels.velocity[i] ** 2 + 2.0 * levels.surge_time * (p[3 + i] * surge) ** 2
        angular[i] = 2.0 * p[6 + i] * (levels.turn_rate[i] ** 2 + (fade * levels.wave_turn[i]) ** 2)
    noise_of_step(linear, angular, dt, q)


@inner_kernel
def _keep(made: Steps, i: int, velocity: Vec6, attitude: Mat3, p: Array, y: Array, s: Array) -> None:
    """Write down step ``i``: its start, its end ``y`` and the sensitivities ``s`` (12, 24)."""
    for j in range(3):
        made.increment[i, j], made.rotation[i, j] = y[j], y[3 + j]
    for j in range(6):
        made.velocity_start[i, j], made.velocity_end[i, j] = velocity[j], y[6 + j]
    for j in range(15):
        made.parameters[i, j] = p[j]
    quaternion_into(attitude, made.attitude_start[i])
    for row in range(12):
        for j in range(6):
            made.jacobian_velocity[i, row, j] = s[row, j]
        for j in range(3):
            made.jacobian_attitude[i, row, j] = s[row, 6 + j]
        for j in range(15):
            made.jacobian_parameters[i, row, j] = s[row, 9 + j]


@inner_kernel
def _take_feedback(ring: Ring, k: int) -> None:
    """Go on from what dead reckoning says of this stamp."""
    for i in range(6):
        ring.velocity[k, i] = ring.velocity_fed[k, i]
    for i in range(3):
        for j in range(3):
            ring.attitude[k, i, j] = ring.attitude_fed[k, i, j]
    ring.depth[k] = ring.depth_fed[k]


@inner_kernel
def _end_of_step(ring: Ring, k: int, n: int, y: Array, turn: Mat3) -> None:
    """The state in slot ``n``, after the step ``y`` from that in slot ``k``."""
    so3_exp_into(y[3:6], turn)
    product_into(ring.attitude[k], turn, ring.attitude[n])
    for i in range(6):
        ring.velocity[n, i] = y[6 + i]
    ring.depth[n] = ring.depth[k]


@kernel
def roll(
    ring: Ring, first: int, actuators: Array, dt: float, model: Model, levels: Levels, wanted: bool, made: Steps
) -> None:
    """Step from slot ``first`` on, once per row of ``actuators`` (n, 5); feedback met on the way is taken over.

    Where wanted, row i of ``made`` is filled for step i.
    """
    y, s, turn, densities = np.empty(12), np.empty((12, COLUMNS)), np.empty((3, 3)), np.empty((2, 3))
    _roll(ring, first, actuators, dt, model, levels, wanted, made, y, s, turn, densities, new_scratch())


@inner_kernel
def _roll(
    ring: Ring,
    first: int,
    actuators: Array,
    dt: float,
    model: Model,
    levels: Levels,
    wanted: bool,
    made: Steps,
    y: Array,
    s: Array,
    turn: Mat3,
    densities: Array,
    scratch: Scratch,
) -> None:
    size = ring.depth.shape[0]
    for i in range(actuators.shape[0]):
        k, n = (first + i) % size, (first + i + 1) % size
        if ring.feedback[k]:
            _take_feedback(ring, k)
        p, depth = ring.parameters[k], ring.depth[k]
        step(ring.velocity[k], ring.attitude[k], p, actuators[i], depth, dt, model, y, s, wanted, scratch)
        if wanted:
            _keep(made, i, ring.velocity[k], ring.attitude[k], p, y, s)
            _noise(p, depth, levels, dt, densities, made.noise[i])
        _end_of_step(ring, k, n, y, turn)
