"""The vehicle's own pilot: follows lines at a depth by compass, pressure, propeller rate and GPS on the surface.

It sees the world through the same errors as the sensors (compass deviation, GPS error), not the truth, so the
track it flies is off as a real one's is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import rpy_from_matrix, wrap
from fbn_common.types import Array, Mat3
from fbn_sim.kernels import times
from fbn_sim.sea import SeaTable, elevation
from fbn_sim.vehicle import Body

PERIOD_S = 0.1
SURFACED_S = 6.0  # the pilot's receiver needs this long on the surface
AFLOAT = 0.05  # m, depth to aim at when going on the surface
MEMORY = 12
"""What the pilot remembers (a float array, as the kernel needs): see the names below."""
LEG, SECONDS, FROM_X, FROM_Y, NAV_X, NAV_Y, INTEGRAL, UP_S, YAW, PITCH, HOLD_YAW, DONE = range(MEMORY)


class PilotTable(NamedTuple):
    """The pilot's settings and its sensors' errors, as the kernel takes them."""

    legs: Array  # (n, 6), see Mission.table
    gains: Array  # (10,), the fields of Autopilot in their order
    speed_per_rate: float
    deviation: Array  # (5,) amplitude and phase of the first and second harmonic, constant [rad]
    drift: Array  # (m,) rad, at 1 Hz
    noise: Array  # (k, 4) yaw, pitch [rad], depth [m], at 10 Hz
    gps: Array  # (m, 2) m, error of the fixes at 1 Hz


class Surroundings(NamedTuple):
    """All that the closed loop acts in, as the kernels take it."""

    body: Body
    sea: SeaTable
    bed: Array  # see fbn_sim.world.bed_height
    pilot: PilotTable


@kernel
def new_memory(x: float, y: float, yaw: float) -> Array:
    """The pilot's memory at the start: it knows where it is put in."""
    memory = np.zeros(MEMORY)
    memory[FROM_X] = memory[NAV_X] = x
    memory[FROM_Y] = memory[NAV_Y] = y
    memory[YAW] = memory[HOLD_YAW] = yaw
    return memory


@kernel
def deviation(coefficients: Array, yaw: float) -> float:
    """Deviation of the compass [rad] at a heading: hard iron turns once, soft iron twice a circle."""
    c = coefficients
    return c[0] * np.sin(yaw + c[1]) + c[2] * np.sin(2.0 * yaw + c[3]) + c[4]


@kernel
def pilot(memory: Array, state: Array, rotation: Mat3, t: float, around: Surroundings) -> Array:
    """The command (3,) [rad/s, rad, rad] from what the pilot senses now; every PERIOD_S; updates its memory."""
    table = around.pilot
    yaw, pitch, depth = _sense(state, rotation, t, table)
    yaw_rate = wrap(yaw - memory[YAW]) / PERIOD_S
    pitch_rate = (pitch - memory[PITCH]) / PERIOD_S
    memory[YAW], memory[PITCH] = yaw, pitch
    _navigate(memory, state, rotation, yaw, pitch, t, around)
    _next_leg(memory, yaw, table)
    leg = table.legs[int(memory[LEG])]
    command = np.empty(3)
    command[0] = leg[4]
    command[1] = _steer(memory, leg, yaw, yaw_rate, table.gains)
    command[2] = _elevate(memory, leg, depth, pitch, pitch_rate, table.gains)
    return command


@kernel
def _sense(state: Array, rotation: Mat3, t: float, table: PilotTable) -> tuple[float, float, float]:
    rpy = rpy_from_matrix(rotation)
    noise = table.noise[int(t / PERIOD_S + 0.5)]
    yaw = rpy[2] + deviation(table.deviation, rpy[2]) + table.drift[int(t)] + noise[0]
    return yaw, rpy[1] + noise[1], -state[2] + noise[2]


@kernel
def _navigate(
    memory: Array, state: Array, rotation: Mat3, yaw: float, pitch: float, t: float, around: Surroundings
) -> None:
    """Dead reckoning by propeller rate and compass; pulled to GPS once a second while the antenna is up."""
    table = around.pilot
    rate = table.legs[int(memory[LEG]), 4]
    memory[NAV_X] += table.speed_per_rate * rate * np.cos(pitch) * np.cos(yaw) * PERIOD_S
    memory[NAV_Y] += table.speed_per_rate * rate * np.cos(pitch) * np.sin(yaw) * PERIOD_S
    antenna = state[:3] + times(rotation, around.body.antenna)
    up = antenna[2] > elevation(around.sea, t, antenna)
    memory[UP_S] = memory[UP_S] + PERIOD_S if up else 0.0
    if memory[UP_S] > SURFACED_S and t - int(t) < PERIOD_S - 1e-6:
        gain, error = table.gains[9], table.gps[int(t)]
        memory[NAV_X] += gain * (antenna[0] + error[0] - memory[NAV_X])
        memory[NAV_Y] += gain * (antenna[1] + error[1] - memory[NAV_Y])


@kernel
def _next_leg(memory: Array, yaw: float, table: PilotTable) -> None:
    leg = table.legs[int(memory[LEG])]
    memory[SECONDS] += PERIOD_S
    done = leg[5] > 0.0 and memory[SECONDS] >= leg[5]
    if leg[0] > 0.0:
        _, _, to_go = _on_line(memory, leg)
        done = done or to_go < table.gains[8]
    if not done:
        return
    if memory[LEG] + 1 >= table.legs.shape[0]:
        memory[DONE] = 1.0
        return
    if leg[0] > 0.0:
        memory[FROM_X], memory[FROM_Y] = leg[1], leg[2]
    else:
        memory[FROM_X], memory[FROM_Y] = memory[NAV_X], memory[NAV_Y]
    memory[LEG] += 1
    memory[SECONDS] = 0.0
    memory[HOLD_YAW] = yaw


@kernel
def _on_line(memory: Array, leg: Array) -> tuple[float, float, float]:
    """Direction of the line [rad], distance left of it, distance to go along it [m]."""
    dx, dy = leg[1] - memory[FROM_X], leg[2] - memory[FROM_Y]
    length = max(np.sqrt(dx * dx + dy * dy), 1e-6)
    ex, ey = memory[NAV_X] - memory[FROM_X], memory[NAV_Y] - memory[FROM_Y]
    return np.arctan2(dy, dx), (dx * ey - dy * ex) / length, length - (dx * ex + dy * ey) / length


@kernel
def _steer(memory: Array, leg: Array, yaw: float, yaw_rate: float, gains: Array) -> float:
    wanted = memory[HOLD_YAW]
    if leg[0] > 0.0:
        course, left, _ = _on_line(memory, leg)
        wanted = course - np.arctan2(left, gains[7])
    return -(gains[0] * wrap(wanted - yaw) - gains[1] * yaw_rate)


@kernel
def _elevate(memory: Array, leg: Array, depth: float, pitch: float, pitch_rate: float, gains: Array) -> float:
    """Tilt from depth: the bow goes down (positive pitch) where the wanted depth is below."""
    error = min(max(max(leg[3], AFLOAT) - depth, -1.0), 1.0)
    if leg[3] <= 0.0:
        memory[INTEGRAL] = 0.0
    elif abs(error) < 0.8:
        memory[INTEGRAL] += error * PERIOD_S
    wanted = gains[2] * error + gains[3] * memory[INTEGRAL]
    wanted = min(max(wanted, -gains[6]), gains[6])
    return -(gains[4] * (wanted - pitch) - gains[5] * pitch_rate)
