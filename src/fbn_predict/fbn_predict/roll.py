"""The model run along the grid: the ring of states of the last seconds, and the compiled loop over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import matrix_from_quaternion_into, product_into, quaternion_into, so3_exp_into
from fbn_common.motion_ekf.layout import (
    GRID_NS,
    M_ATTITUDE,
    M_BY_ATTITUDE,
    M_BY_PARAMETERS,
    M_BY_VELOCITY,
    M_NOISE,
    M_PARAMETERS,
    MOTION_SIZE,
    O_ORIENTATION,
    O_POSE_COVARIANCE,
    O_TWIST_COVARIANCE,
    O_VELOCITY,
    IntArray,
)
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


FED, UNUSED, BROKEN = 0, 1, 2  # what became of a line of feedback


@kernel
def feed(ring: Ring, stamps: IntArray, lines: Array, oldest_ns: int, newest_ns: int) -> IntArray:
    """Keep dead reckoning's odometry (n, ODOMETRY_SIZE) where it is of a stamp of the grid within these bounds.

    Gives (n,) what became of each line.
    """
    verdicts = np.empty(stamps.shape[0], np.int64)
    for i in range(stamps.shape[0]):
        verdicts[i] = _feed_one(ring, stamps[i], lines[i], oldest_ns, newest_ns)
    return verdicts


@inner_kernel
def _feed_one(ring: Ring, stamp: int, line: Array, oldest_ns: int, newest_ns: int) -> int:
    size = 0.0
    for i in range(4):
        size += abs(line[O_ORIENTATION + i])
    if not size > 0.0:
        return BROKEN
    for i in range(O_POSE_COVARIANCE):
        if not (np.isfinite(line[i]) and np.isfinite(line[min(O_VELOCITY + i, O_TWIST_COVARIANCE - 1)])):
            return BROKEN
    if stamp % GRID_NS != 0 or not oldest_ns <= stamp <= newest_ns:
        return UNUSED
    k = (stamp // GRID_NS) % ring.depth.shape[0]
    ring.feedback[k], ring.depth_fed[k] = True, -line[2]
    for i in range(6):
        ring.velocity_fed[k, i] = line[O_VELOCITY + i]
    matrix_from_quaternion_into(line[O_ORIENTATION:O_POSE_COVARIANCE], ring.attitude_fed[k])
    return FED


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
def _write_down(made: Array, velocity: Vec6, attitude: Mat3, p: Array, y: Array, s: Array) -> None:
    """A step's start, its end ``y`` and the sensitivities ``s`` (12, 24), into the numbers of its motion."""
    for j in range(6):
        made[j], made[6 + j], made[12 + j] = y[j], velocity[j], y[6 + j]
    for j in range(15):
        made[M_PARAMETERS + j] = p[j]
    quaternion_into(attitude, made[M_ATTITUDE:M_BY_VELOCITY])
    for row in range(12):
        for j in range(6):
            made[M_BY_VELOCITY + 6 * row + j] = s[row, j]
        for j in range(3):
            made[M_BY_ATTITUDE + 3 * row + j] = s[row, 6 + j]
        for j in range(15):
            made[M_BY_PARAMETERS + 15 * row + j] = s[row, 9 + j]


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
def roll(ring: Ring, first: int, actuators: Array, dt: float, model: Model, levels: Levels, wanted: bool) -> Array:
    """Step from slot ``first`` on, once per row of ``actuators`` (n, 5); feedback met on the way is taken over.

    Gives the numbers (n, MOTION_SIZE) of the steps' motions, where wanted; else (0, MOTION_SIZE).
    """
    made = np.empty((actuators.shape[0] if wanted else 0, MOTION_SIZE))
    y, s, turn, densities = np.empty(12), np.empty((12, COLUMNS)), np.empty((3, 3)), np.empty((2, 3))
    _roll(ring, first, actuators, dt, model, levels, wanted, made, y, s, turn, densities, new_scratch())
    return made


@inner_kernel
def _roll(
    ring: Ring,
    first: int,
    actuators: Array,
    dt: float,
    model: Model,
    levels: Levels,
    wanted: bool,
    made: Array,
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
            _write_down(made[i], ring.velocity[k], ring.attitude[k], p, y, s)
            _noise(p, depth, levels, dt, densities, made[i, M_NOISE:MOTION_SIZE].reshape(12, 12))
        _end_of_step(ring, k, n, y, turn)
