"""The vehicle's equations of motion over one step.

See docs/equations/predict.md.  The state ``y`` over one step: increment 3 (body frame at start), rotation vector 3
since the start, velocity 6.  Of the attitude and the water at the start the vehicle feels two vectors: the water's
velocity and the direction up, in the body's axes of then.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import cross_into, so3_exp_into
from fbn_common.types import Array, Mat3, Vec3
from fbn_predict.parameters import Dynamics


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


class Step(NamedTuple):
    """What stays the same over one step."""

    water: Vec3  # velocity [m/s], in the body's axes at the start
    up: Vec3
    drive: Array  # (6,) unit force and torque by the propeller
    fins: Array  # (6,) unit force and torque by fins, at design speed
    lift: Array  # (1,) buoyancy [m/s^2]


class Feel(NamedTuple):
    """What the vehicle feels at one instant, in the body's axes of then."""

    turned: Mat3  # since the step's start
    water: Vec3
    up: Vec3
    relative: Vec3  # velocity through the water
    flow: Vec3  # the same at the centre of lateral resistance
    momentum: Vec3
    drive: Array  # (6,) unit force and torque
    slope: Array  # (6,) of that by forward speed


@kernel
def new_step() -> Step:
    """Room for the constants of a step."""
    return Step(np.empty(3), np.empty(3), np.empty(6), np.empty(6), np.empty(1))


@kernel
def new_feel() -> Feel:
    """Room for what is felt."""
    return Feel(
        np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(6), np.empty(6)
    )  # fmt: skip


@inner_kernel
def actuation(model: Model, actuators: Array, depth: float, drive: Array, fins: Array) -> None:
    """Unit force 3 and torque 3 by the propeller, and by fins at design speed, into ``drive`` and ``fins`` (6,).

    ``actuators``: propeller [rad/s], pan, tilt, rudder, stern plane [rad].  The propeller is at the stern: pushed
    left (pan) it turns the bow right.  Fins act by speed squared.  Damping is linear where drag is nearly quadratic,
    so what steering takes from the force ahead enters with the power by which speed follows force.
    """
    rate, pan, tilt, rudder, plane = actuators[0], actuators[1], actuators[2], actuators[3], actuators[4]
    thrust = np.sign(rate) * (abs(rate) / model.propeller_reference) ** model.thrust_exponent
    if depth < model.surface_depth:
        thrust *= 1.0 - model.surface_loss
    ahead, side, down = np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), np.sin(tilt)
    drive[0], drive[1], drive[2] = thrust * max(ahead, 0.0) ** model.steering_exponent, thrust * side, -thrust * down
    drive[3], drive[4], drive[5] = thrust, -thrust * down, -thrust * side
    fins[0], fins[1], fins[2] = 0.0, model.fin_lift * rudder, -model.fin_lift * plane
    fins[3], fins[4], fins[5] = 0.0, -model.fin_torque * plane, -model.fin_torque * rudder


@inner_kernel
def _rotate_back(a: Mat3, v: Vec3, out: Vec3) -> None:
    for i in range(3):
        out[i] = a[0, i] * v[0] + a[1, i] * v[1] + a[2, i] * v[2]


@inner_kernel
def begin(attitude: Mat3, p: Array, actuators: Array, depth: float, model: Model, step: Step) -> None:
    """Fill in the constants of a step from the attitude and the depth at its start."""
    _rotate_back(attitude, p[12:15], step.water)
    for i in range(3):
        step.up[i] = attitude[2, i]
    actuation(model, actuators, depth, step.drive, step.fins)
    step.lift[0] = model.buoyancy * min(max(depth / model.surface_depth, 0.0), 1.0)


@inner_kernel
def rates(y: Array, p: Array, step: Step, model: Model, feel: Feel, dy: Array) -> None:
    """``dy`` (12,) at ``y``; what it is made of is left in ``feel``."""
    theta, v, w, e = y[3:6], y[6:9], y[9:12], feel.turned
    so3_exp_into(theta, e)
    _rotate_back(e, step.water, feel.water)
    _rotate_back(e, step.up, feel.up)
    for i in range(3):
        feel.relative[i] = feel.flow[i] = v[i] - feel.water[i]
        feel.momentum[i] = model.mass[i] * feel.relative[i]
    feel.flow[1] += model.lateral_centre * w[2]
    feel.flow[2] -= model.lateral_centre * w[1]
    speed = feel.relative[0] / model.design_speed
    for i in range(6):
        feel.drive[i] = step.drive[i] + speed * speed * step.fins[i]
        feel.slope[i] = 2.0 * speed / model.design_speed * step.fins[i]
    spin, drag, wv, wwv = dy[0:3], dy[6:9], dy[9:12], dy[3:6]  # room that is still free
    cross_into(theta, w, wv)
    cross_into(theta, wv, wwv)
    for i in range(3):
        dy[3 + i] = w[i] + 0.5 * wv[i] + wwv[i] / 12.0
    cross_into(w, feel.momentum, spin)
    cross_into(w, feel.water, drag)
    for i in range(3):
        resistance = p[3 + i] * feel.flow[i] * (1.0 + model.quadratic[i] * abs(feel.flow[i]))
        forces = p[9 + i] * feel.drive[i] - resistance + step.lift[0] * feel.up[i]
        dy[6 + i] = forces - spin[i] / model.mass[i] - drag[i]
        dy[9 + i] = p[i] * feel.drive[3 + i] - p[6 + i] * w[i]
        dy[i] = e[i, 0] * v[0] + e[i, 1] * v[1] + e[i, 2] * v[2]
    dy[9] -= model.righting[0] * feel.up[1]
    dy[10] += model.righting[1] * feel.up[0]
