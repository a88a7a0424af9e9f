"""Six degrees of freedom: rigid body, added mass, Coriolis terms, drag, lift, thrust, buoyancy at the surface.

Fossen's equations about the centre of buoyancy, forward-left-up, with velocity relative to the water where
the water acts: ``M nu' = tau - C_rb(nu) nu - C_a(nu_r) nu_r + (M_a + displaced) water acceleration``.
"""

from __future__ import annotations

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import matrix_from_quaternion
from fbn_common.types import Array, Mat3, Mat6, Vec3, Vec6
from fbn_sim.kernels import cross, times, transposed_times
from fbn_sim.sea import SeaTable, current, elevation, orbital
from fbn_sim.vehicle import Body

BOW_SHARE = 0.2  # of the buoyancy in the tapering bow, and as much in the stern
STATE = 13  # position 3 (map), quaternion 4, velocity 6 (body, over ground)


@kernel
def coriolis(mass: Mat6, velocity: Vec6) -> Vec6:
    """``C(nu) nu`` of a body with this mass matrix (Kirchhoff's equations)."""
    momentum = times(mass, velocity)
    v, w, p, h = velocity[:3], velocity[3:], momentum[:3], momentum[3:]
    out = np.empty(6)
    out[:3] = cross(w, p)
    out[3:] = cross(v, p) + cross(w, h)
    return out


@kernel
def propulsion(body: Body, velocity: Vec6, actuators: Array, depth: float) -> Vec6:
    """Force and torque (6,) of the propeller; positive pan pushes the stern left, positive tilt pushes it down."""
    rate = actuators[0]
    thrust = body.thrust * rate * abs(rate) - body.thrust_inflow * abs(rate) * velocity[0]
    if depth < 1.5 * body.radius:
        thrust *= 1.0 - body.surface_loss
    pan = 0.0 if body.finned else actuators[1] + body.servo_zero[0]
    tilt = 0.0 if body.finned else actuators[2] + body.servo_zero[1]
    force = thrust * np.array([np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), -np.sin(tilt)])
    out = np.empty(6)
    out[:3] = force
    out[3:] = cross(np.array([body.propeller_position, 0.0, 0.0]), force)
    out[3] -= body.propeller_torque * rate * abs(rate)
    return out


@kernel
def hydrodynamics(body: Body, velocity: Vec6, actuators: Array) -> Vec6:
    """Force and torque (6,) of drag, of the hull's lift and of the tail's, by velocity relative to the water."""
    out = -(body.linear_drag + body.quadratic_drag * np.abs(velocity)) * velocity
    u, x = velocity[0], body.fin_position
    rudder = actuators[1] + body.servo_zero[0] if body.finned else 0.0
    plane = actuators[2] + body.servo_zero[1] if body.finned else 0.0
    side = -body.fin_lift * abs(u) * (velocity[1] + x * velocity[5] - u * rudder)
    lift = -body.fin_lift * abs(u) * (velocity[2] - x * velocity[4] + u * plane)
    out[1] += side - body.body_lift * abs(u) * velocity[1]
    out[2] += lift - body.body_lift * abs(u) * velocity[2]
    out[4] -= x * lift
    out[5] += x * side
    return out


@kernel
def restoring(body: Body, rotation: Mat3, position: Vec3, surface: float) -> Vec6:
    """Force and torque (6,) of weight and buoyancy; bow, middle and stern lose buoyancy as they leave the water."""
    up = rotation[2].copy()  # world's up in the body
    out = np.empty(6)
    out[:3] = -body.weight * up
    out[3:] = cross(body.gravity_centre, out[:3])
    for part in range(-1, 2):
        share = BOW_SHARE if part else 1.0 - 2.0 * BOW_SHARE
        arm = np.array([0.3 * part * body.length, 0.0, 0.0])
        height = position[2] + up[0] * arm[0] - surface
        s = min(max((body.radius - height) / (2.0 * body.radius), 0.0), 1.0)
        force = share * body.buoyancy * s * s * (3.0 - 2.0 * s) * up
        out[:3] += force
        out[3:] += cross(arm, force)
    return out


@kernel
def derivative(state: Array, actuators: Array, t: float, body: Body, sea: SeaTable) -> Array:
    """Rate of change (13,) of the state."""
    position, velocity = state[:3], state[7:13]
    rotation = matrix_from_quaternion(state[3:7])
    flow = transposed_times(rotation, current(sea, t, position))
    wave, wave_acceleration = orbital(sea, t, position)
    water = flow + transposed_times(rotation, wave)
    omega = velocity[3:].copy()
    relative = velocity.copy()
    relative[:3] -= water
    surface = elevation(sea, t, position)

    force = propulsion(body, relative, actuators, surface - position[2])
    force += hydrodynamics(body, relative, actuators)
    force += restoring(body, rotation, position, surface)
    force -= coriolis(body.rigid, velocity) + coriolis(body.added, relative)
    accelerating = transposed_times(rotation, wave_acceleration)
    turning = cross(omega, water)
    for i in range(3):
        displaced = body.rigid[0, 0]
        force[i] += (displaced + body.added[i, i]) * accelerating[i] - body.added[i, i] * turning[i]

    out = np.empty(STATE)
    out[:3] = times(rotation, velocity[:3])
    x, y, z, w = state[3], state[4], state[5], state[6]
    out[3] = 0.5 * (w * omega[0] + y * omega[2] - z * omega[1])
    out[4] = 0.5 * (w * omega[1] + z * omega[0] - x * omega[2])
    out[5] = 0.5 * (w * omega[2] + x * omega[1] - y * omega[0])
    out[6] = -0.5 * (x * omega[0] + y * omega[1] + z * omega[2])
    out[7:] = times(body.mass_inverse, force)
    return out


@kernel
def step(state: Array, actuators: Array, t: float, dt: float, body: Body, sea: SeaTable) -> Array:
    """The state (13,) after ``dt`` [s], by the classical Runge-Kutta method."""
    k1 = derivative(state, actuators, t, body, sea)
    k2 = derivative(state + 0.5 * dt * k1, actuators, t + 0.5 * dt, body, sea)
    k3 = derivative(state + 0.5 * dt * k2, actuators, t + 0.5 * dt, body, sea)
    k4 = derivative(state + dt * k3, actuators, t + dt, body, sea)
    out = state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    out[3:7] /= np.sqrt((out[3:7] ** 2).sum())
    return out


@kernel
def actuate(actuators: Array, command: Array, dt: float, body: Body) -> Array:
    """Propeller rate, pan and tilt (3,) after ``dt``: first-order lag, then limits of rate and range."""
    out = np.empty(3)
    for i in range(3):
        wanted = min(max(command[i], -body.actuator_limit[i]), body.actuator_limit[i])
        change = (wanted - actuators[i]) * (1.0 - np.exp(-dt / body.actuator_lag[i]))
        most = body.actuator_rate[i] * dt
        out[i] = actuators[i] + min(max(change, -most), most)
    return out
