"""The vehicle's equations of motion, their Jacobians, and one Runge-Kutta step with its sensitivities.

See docs/equations/predict.md.  The state ``y`` over one step: increment 3 (body frame at start), rotation vector 3
since the start, velocity 6.  Sensitivities are by velocity at start 6, attitude at start 3, parameters 15.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import product, skew, so3_exp, so3_right_jacobian
from fbn_common.types import Array, Mat3, Vec3
from fbn_predict.parameters import Dynamics

COLUMNS = 24


class Model(NamedTuple):
    """The constants of :class:`~fbn_predict.parameters.Dynamics`, as the kernels take them."""

    propeller_reference: float
    thrust_exponent: float
    design_speed: float
    quadratic: Array
    mass: Array
    lateral_centre: float
    fin_torque: float
    fin_lift: float
    buoyancy: float
    righting: Array  # roll, pitch
    steering_exponent: float
    surface_loss: float
    surface_depth: float


def model_of(d: Dynamics) -> Model:
    """The kernels' view of the parameters."""
    return Model(
        d.propeller_reference,
        d.thrust_exponent,
        d.terminal_speed,
        np.array(d.quadratic_damping),
        np.array(d.mass_ratio),
        d.lateral_centre,
        d.fin_torque,
        d.fin_lift,
        d.buoyancy,
        np.array([d.righting_roll, d.righting_pitch]),
        d.steering_exponent,
        d.surface_loss,
        d.surface_depth,
    )


@kernel
def actuation(model: Model, actuators: Array, speed: float, depth: float, out: Array) -> None:
    """Unit force 3 and torque 3, and their slopes by forward speed 6, into ``out`` (12,).

    ``actuators``: propeller [rad/s], pan, tilt, rudder, stern plane [rad].  The propeller is at the stern: pushed
    left (pan) it turns the bow right.  Fins act by speed squared.  Damping is linear where drag is nearly quadratic,
    so what steering takes from the force ahead enters with the power by which speed follows force.
    """
    rate, pan, tilt, rudder, plane = actuators[0], actuators[1], actuators[2], actuators[3], actuators[4]
    thrust = np.sign(rate) * (abs(rate) / model.propeller_reference) ** model.thrust_exponent
    if depth < model.surface_depth:
        thrust *= 1.0 - model.surface_loss
    dynamic, slope = (speed / model.design_speed) ** 2, 2.0 * speed / model.design_speed**2
    ahead, side, down = np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), np.sin(tilt)
    out[0] = thrust * max(ahead, 0.0) ** model.steering_exponent
    out[1] = thrust * side + model.fin_lift * dynamic * rudder
    out[2] = -thrust * down - model.fin_lift * dynamic * plane
    out[3] = thrust
    out[4] = -thrust * down - model.fin_torque * dynamic * plane
    out[5] = -thrust * side - model.fin_torque * dynamic * rudder
    out[6], out[7], out[8] = 0.0, model.fin_lift * slope * rudder, -model.fin_lift * slope * plane
    out[9], out[10], out[11] = 0.0, -model.fin_torque * slope * plane, -model.fin_torque * slope * rudder


@kernel
def _rotate_back(a: Mat3, v: Vec3) -> Vec3:
    out = np.empty(3)
    for i in range(3):
        out[i] = a[0, i] * v[0] + a[1, i] * v[1] + a[2, i] * v[2]
    return out


@kernel
def _cross(a: Vec3, b: Vec3) -> Vec3:
    out = np.empty(3)
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return out


@kernel
def rates(
    y: Array,
    attitude: Mat3,
    p: Array,
    actuators: Array,
    depth: float,
    model: Model,
    dy: Array,
    wanted: bool,
    a: Array,
    b: Array,
) -> None:
    """``dy`` (12,); where wanted, its Jacobians: ``a`` (12, 12) by ``y``, ``b`` (12, 18) by attitude and parameters."""
    theta, v, w = y[3:6], y[6:9], y[9:12]
    e = so3_exp(theta)
    world = attitude
    water0, up0 = _rotate_back(world, p[12:15]), world[2].copy()
    water, up = _rotate_back(e, water0), _rotate_back(e, up0)
    rel, flow, momentum, m = np.empty(3), np.empty(3), np.empty(3), model.mass
    for i in range(3):
        rel[i] = v[i] - water[i]
        flow[i] = rel[i]
        momentum[i] = m[i] * rel[i]
    # flow: at the centre of lateral resistance
    flow[1] += model.lateral_centre * w[2]
    flow[2] -= model.lateral_centre * w[1]
    drive = np.empty(12)
    actuation(model, actuators, rel[0], depth, drive)
    spin, drag = _cross(w, momentum), _cross(w, water)
    wv = _cross(theta, w)
    wwv = _cross(theta, wv)
    lift = model.buoyancy * min(max(depth / model.surface_depth, 0.0), 1.0)
    for i in range(3):
        dy[i] = e[i, 0] * v[0] + e[i, 1] * v[1] + e[i, 2] * v[2]
        dy[3 + i] = w[i] + 0.5 * wv[i] + wwv[i] / 12.0
        resistance = p[3 + i] * flow[i] * (1.0 + model.quadratic[i] * abs(flow[i]))
        dy[6 + i] = p[9 + i] * drive[i] - resistance - spin[i] / m[i] - drag[i] + lift * up[i]
        dy[9 + i] = p[i] * drive[3 + i] - p[6 + i] * w[i]
    dy[9] -= model.righting[0] * up[1]
    dy[10] += model.righting[1] * up[0]
    if wanted:
        _jacobians(y, e, world, p, model, water0, up0, water, up, rel, flow, drive, momentum, lift, a, b)


@kernel
def _jacobians(
    y: Array,
    e: Mat3,
    world: Mat3,
    p: Array,
    model: Model,
    water0: Vec3,
    up0: Vec3,
    water: Vec3,
    up: Vec3,
    rel: Vec3,
    flow: Vec3,
    drive: Array,
    momentum: Vec3,
    lift: float,
    a: Array,
    b: Array,
) -> None:
    theta, v, w = y[3:6], y[6:9], y[9:12]
    a[:], b[:] = 0.0, 0.0
    jr, et, m = so3_right_jacobian(theta), np.ascontiguousarray(e.T), model.mass
    aside = product(product(e, skew(v)), jr)
    dot = theta[0] * w[0] + theta[1] * w[1] + theta[2] * w[2]
    square = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    sw, st = skew(w), skew(theta)
    for i in range(3):
        for j in range(3):
            a[i, 3 + j], a[i, 6 + j] = -aside[i, j], e[i, j]
            same = 1.0 if i == j else 0.0
            a[3 + i, 3 + j] = -0.5 * sw[i, j] + (theta[i] * w[j] + dot * same - 2.0 * w[i] * theta[j]) / 12.0
            a[3 + i, 9 + j] = same + 0.5 * st[i, j] + (theta[i] * theta[j] - square * same) / 12.0
    # by the velocity relative to the water, at fixed water
    r = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            r[i, j] = -sw[i, j] * m[j] / m[i]
        r[i, i] -= p[3 + i] * (1.0 + 2.0 * model.quadratic[i] * abs(flow[i]))
        r[i, 0] += p[9 + i] * drive[6 + i]
    sm, su = skew(momentum), skew(water)
    for i in range(3):
        for j in range(3):
            a[6 + i, 6 + j] = r[i, j]
            a[6 + i, 9 + j] = sm[i, j] / m[i] + su[i, j]
        a[9 + i, 9 + i] = -p[6 + i]
        a[9 + i, 6] = p[i] * drive[9 + i]
    for i, j, sign in ((1, 2, 1.0), (2, 1, -1.0)):
        a[6 + i, 9 + j] -= sign * model.lateral_centre * p[3 + i] * (1.0 + 2.0 * model.quadratic[i] * abs(flow[i]))
    # by the water in the body, du, and by up in the body, dg
    by_water = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            by_water[i, j] = -r[i, j] - sw[i, j]
    turn_water, turn_up = product(su, jr), product(skew(up), jr)
    base_water, base_up = product(et, skew(water0)), product(et, skew(up0))
    axes = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            axes[i, j] = et[i, 0] * world[j, 0] + et[i, 1] * world[j, 1] + et[i, 2] * world[j, 2]
    force_turn, force_base, force_axes = (
        product(by_water, turn_water),
        product(by_water, base_water),
        product(by_water, axes),
    )
    for i in range(3):
        for j in range(3):
            a[6 + i, 3 + j] = force_turn[i, j] + lift * turn_up[i, j]
            b[6 + i, j] = force_base[i, j] + lift * base_up[i, j]
            b[6 + i, 15 + j] = force_axes[i, j]
            # torque by fins sees forward speed through the water
            a[9 + i, 3 + j] = -p[i] * drive[9 + i] * turn_water[0, j]
            b[9 + i, j] = -p[i] * drive[9 + i] * base_water[0, j]
            b[9 + i, 15 + j] = -p[i] * drive[9 + i] * axes[0, j]
        b[6 + i, 12 + i] = drive[i]
        b[6 + i, 6 + i] = -flow[i] * (1.0 + model.quadratic[i] * abs(flow[i]))
        b[9 + i, 3 + i] = drive[3 + i]
        b[9 + i, 9 + i] = -w[i]
    for j in range(3):
        a[9, 3 + j] -= model.righting[0] * turn_up[1, j]
        a[10, 3 + j] += model.righting[1] * turn_up[0, j]
        b[9, j] -= model.righting[0] * base_up[1, j]
        b[10, j] += model.righting[1] * base_up[0, j]


@kernel
def _flow(a: Array, b: Array, s: Array, out: Array) -> None:
    """``out = A S + [0 B]``, leaving out the columns of A that are zero (the increment's)."""
    for i in range(12):
        for j in range(COLUMNS):
            out[i, j] = 0.0
        for k in range(3, 12, 3):  # three at a time: each round reads and writes ``out``
            c0, c1, c2 = a[i, k], a[i, k + 1], a[i, k + 2]
            if c0 != 0.0 or c1 != 0.0 or c2 != 0.0:
                for j in range(COLUMNS):
                    out[i, j] = out[i, j] + c0 * s[k, j] + c1 * s[k + 1, j] + c2 * s[k + 2, j]
        for j in range(18):
            out[i, 6 + j] += b[i, j]


@kernel
def step(
    velocity: Array,
    attitude: Mat3,
    p: Array,
    actuators: Array,
    depth: float,
    dt: float,
    model: Model,
    y: Array,
    s: Array,
    wanted: bool,
) -> None:
    """One classical Runge-Kutta step: ``y`` (12,) and, where wanted, ``s = dy/d(velocity, attitude, p)`` (12, 24)."""
    a, b = np.empty((12, 12)), np.empty((12, 18))
    k, ks = np.empty(12), np.empty((12, COLUMNS))
    y0, s0 = np.zeros(12), np.zeros((12, COLUMNS))
    for i in range(6):
        y0[6 + i] = velocity[i]
        s0[6 + i, i] = 1.0
    stage, ss = y0.copy(), s0.copy()
    y[:] = y0
    if wanted:
        s[:] = s0
    for n in range(4):
        rates(stage, attitude, p, actuators, depth, model, k, wanted, a, b)
        weight = dt / 6.0 if n == 0 or n == 3 else dt / 3.0
        reach = dt if n == 2 else 0.5 * dt
        for i in range(12):
            y[i] += weight * k[i]
            stage[i] = y0[i] + reach * k[i]
        if wanted:
            _flow(a, b, ss, ks)
            for i in range(12):
                for j in range(COLUMNS):
                    s[i, j] += weight * ks[i, j]
                    ss[i, j] = s0[i, j] + reach * ks[i, j]
