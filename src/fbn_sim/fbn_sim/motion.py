"""The closed loop of vehicle, sea and pilot, run through to the mission's end: the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import matrix_from_quaternion
from fbn_common.types import Array
from fbn_sim.autopilot import DONE, LEG, NAV_X, NAV_Y, PERIOD_S, Surroundings, new_memory, pilot
from fbn_sim.dynamics import STATE, actuate, step
from fbn_sim.kernels import times
from fbn_sim.sea import current, elevation
from fbn_sim.world import bed_height


class SimulationError(RuntimeError):
    """The mission cannot be flown; the text says when and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The truth, dense: one row a time step."""

    time_s: Array  # (n,) since the start
    position: Array  # (n, 3) m, map
    orientation: Array  # (n, 4) quaternion, body to map
    velocity: Array  # (n, 6) over ground, body
    actuators: Array  # (n, 3) propeller rad/s, pan, tilt rad, as they are, without the servos' zeros
    current: Array  # (n, 3) m/s, map, of the water about the vehicle, without waves
    altitude: Array  # (n,) m, over the bed
    surface: Array  # (n,) m, height of the water's surface over the antenna's; negative = the antenna is up
    leg: Array  # (n,) number of the leg being flown
    pilot_xy: Array  # (n, 2) m, where the pilot believes to be


@kernel
def _fly(start: Array, yaw: float, dt: float, steps: int, around: Surroundings) -> tuple[Array, int]:
    """Rows (n, 24) of the truth at each step, and how many are valid."""
    rows = np.empty((steps, 24))
    state, actuators, command = np.zeros(STATE), np.zeros(3), np.zeros(3)
    state[:7] = start
    memory = new_memory(start[0], start[1], yaw)
    every = int(PERIOD_S / dt + 0.5)
    for i in range(steps):
        t = i * dt
        rotation = matrix_from_quaternion(state[3:7])
        if i % every == 0:
            command = pilot(memory, state, rotation, t, around)
        antenna = state[:3] + times(rotation, around.body.antenna)
        rows[i, :13], rows[i, 13:16] = state, actuators
        rows[i, 16:19] = current(around.sea, t, state[:3])
        rows[i, 19] = state[2] - bed_height(around.bed, state[0], state[1])
        rows[i, 20] = elevation(around.sea, t, antenna) - antenna[2]
        rows[i, 21], rows[i, 22], rows[i, 23] = memory[LEG], memory[NAV_X], memory[NAV_Y]
        if memory[DONE] > 0.0 or rows[i, 19] < around.body.radius or not np.isfinite(state).all():
            return rows, i + 1
        actuators = actuate(actuators, command, dt, around.body)
        state = step(state, actuators, t, dt, around.body, around.sea)
    return rows, steps


def fly(start: tuple[float, float], yaw: float, dt: float, limit_s: float, around: Surroundings) -> Motion:
    """The truth of a mission from x, y [m] and heading [rad], afloat and at rest.

    ``dt`` [s] is the step of integration; it ends when the legs are done, or after ``limit_s``.  Raises
    SimulationError when the vehicle touches the bed.
    """
    first = np.array([*start, -1.5 * around.body.radius, 0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])
    rows, n = _fly(first, yaw, dt, int(limit_s / dt), around)
    rows = np.ascontiguousarray(rows[:n])
    if not np.isfinite(rows[-1, :16]).all():
        raise SimulationError(f"the vehicle's motion became unstable after {n * dt:.1f} s; shorten time_step")
    if rows[-1, 19] < around.body.radius:
        raise SimulationError(f"the vehicle touched the bed after {n * dt:.1f} s; the mission goes too deep")
    return Motion(
        time_s=np.arange(n, dtype=np.float64) * dt,
        position=rows[:, :3],
        orientation=rows[:, 3:7] * np.where(rows[:, 6:7] < 0.0, -1.0, 1.0),
        velocity=rows[:, 7:13],
        actuators=rows[:, 13:16],
        current=rows[:, 16:19],
        altitude=rows[:, 19],
        surface=rows[:, 20],
        leg=rows[:, 21],
        pilot_xy=rows[:, 22:24],
    )


def interpolate(motion: Motion, times: Array) -> Motion:
    """The truth at these times [s], linearly between time steps; quaternions are normalised."""
    dt = motion.time_s[1] - motion.time_s[0]
    index = np.clip((times / dt).astype(np.int64), 0, len(motion.time_s) - 2)
    f = times / dt - index

    def between(rows: Array) -> Array:
        weight = f if rows.ndim == 1 else f[:, None]
        return np.asarray((1.0 - weight) * rows[index] + weight * rows[index + 1])

    def turned(rows: Array) -> Array:
        a, b = rows[index], rows[index + 1]
        b = b * np.where((a * b).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        q = (1.0 - f)[:, None] * a + f[:, None] * b
        return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))

    return Motion(
        time_s=times,
        position=between(motion.position),
        orientation=turned(motion.orientation),
        velocity=between(motion.velocity),
        actuators=between(motion.actuators),
        current=between(motion.current),
        altitude=between(motion.altitude),
        surface=between(motion.surface),
        leg=motion.leg[index],
        pilot_xy=between(motion.pilot_xy),
    )
