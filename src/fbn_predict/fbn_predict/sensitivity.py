"""One Runge-Kutta step of the vehicle's motion, and its sensitivities: the variational equations beside the motion's.

See docs/equations/predict.md.  Sensitivities of ``y`` are by velocity at start 6, attitude at start 3, parameters 15.
On the way those by attitude and water are by what the vehicle feels of them: up and water in the body's axes at the
start; the step's attitude takes the one to the other at its end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.lie import product_into, skew_into, so3_right_jacobian_into
from fbn_common.types import Array, Mat3, Vec3, Vec6
from fbn_predict.dynamics import Feel, Model, Step, begin, new_feel, new_step, rates

COLUMNS = 24
_UP, _ACTUATION, _DAMPING, _THRUST, _WATER = 6, 9, 12, 18, 21  # columns; velocity comes first


class Partials(NamedTuple):
    """Derivatives of the rates at one instant: by ``y``, and directly by what the columns stand for."""

    a: Array  # (12, 12)
    b: Array  # (12, 24)
    jr: Mat3
    turn_water: Mat3
    turn_up: Mat3
    by_velocity: Mat3
    by_water: Mat3
    force: Mat3


class Scratch(NamedTuple):
    """Room to work in for one step after the other; zeros in ``partials.a`` and ``b`` are never written to."""

    step: Step
    feel: Feel
    partials: Partials
    stage: Array  # (12,)
    k: Array  # (12,)
    s: Array  # (12, 24)
    ks: Array  # (12, 24)


@kernel
def new_scratch() -> Scratch:
    """Made once before a loop of steps."""
    m = np.empty((6, 3, 3))
    partials = Partials(np.zeros((12, 12)), np.zeros((12, COLUMNS)), m[0], m[1], m[2], m[3], m[4], m[5])
    return Scratch(
        new_step(), new_feel(), partials, np.empty(12), np.empty(12), np.empty((12, COLUMNS)), np.empty((12, COLUMNS))
    )  # fmt: skip


@inner_kernel
def _skew_times(v: Vec3, m: Mat3, out: Mat3) -> None:
    """``out = [v]x m``."""
    for j in range(3):
        out[0, j] = v[1] * m[2, j] - v[2] * m[1, j]
        out[1, j] = v[2] * m[0, j] - v[0] * m[2, j]
        out[2, j] = v[0] * m[1, j] - v[1] * m[0, j]


@inner_kernel
def _kinematics(y: Array, feel: Feel, d: Partials) -> None:
    """Rows of the increment, ``e v``, and of the rotation vector, ``w + theta x w / 2 + theta x (theta x w) / 12``."""
    theta, v, w, e, a = y[3:6], y[6:9], y[9:12], feel.turned, d.a
    _skew_times(v, d.jr, d.turn_up)
    product_into(e, d.turn_up, d.force)
    dot = theta[0] * w[0] + theta[1] * w[1] + theta[2] * w[2]
    square = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    sw, st = d.by_velocity, d.by_water  # room that is still free
    skew_into(w, sw)
    skew_into(theta, st)
    for i in range(3):
        for j in range(3):
            a[i, 3 + j], a[i, 6 + j] = -d.force[i, j], e[i, j]
            same = 1.0 if i == j else 0.0
            a[3 + i, 3 + j] = -0.5 * sw[i, j] + (theta[i] * w[j] + dot * same - 2.0 * w[i] * theta[j]) / 12.0
            a[3 + i, 9 + j] = same + 0.5 * st[i, j] + (theta[i] * theta[j] - square * same) / 12.0


@inner_kernel
def _forces(y: Array, p: Array, step: Step, model: Model, feel: Feel, d: Partials) -> None:
    """Rows of the linear velocity."""
    w, m, a, b, r = y[9:12], model.mass, d.a, d.b, d.by_velocity
    skew_into(w, r)
    for i in range(3):
        for j in range(3):
            d.by_water[i, j] = r[i, j] * (m[j] / m[i] - 1.0)
            r[i, j] = -r[i, j] * m[j] / m[i]
    for i in range(3):
        drag = 1.0 + 2.0 * model.quadratic[i] * abs(feel.flow[i])
        _add_drag(i, p[3 + i] * drag, p[9 + i] * feel.slope[i], d)
        _skew_row(i, feel.momentum, 1.0 / m[i], feel.water, a)
        if i == 1:
            a[7, 11] -= model.lateral_centre * p[4] * drag
        if i == 2:
            a[8, 10] += model.lateral_centre * p[5] * drag
        b[6 + i, _THRUST + i] = feel.drive[i]
        b[6 + i, _DAMPING + i] = -feel.flow[i] * (1.0 + model.quadratic[i] * abs(feel.flow[i]))
    product_into(d.by_water, d.turn_water, d.force)
    for i in range(3):
        for j in range(3):
            a[6 + i, 6 + j] = r[i, j]
            a[6 + i, 3 + j] = d.force[i, j] + step.lift[0] * d.turn_up[i, j]
            b[6 + i, _UP + j] = step.lift[0] * feel.turned[j, i]
            total = 0.0
            for k in range(3):
                total += d.by_water[i, k] * feel.turned[j, k]
            b[6 + i, _WATER + j] = total


@inner_kernel
def _add_drag(i: int, drag: float, gain: float, d: Partials) -> None:
    """What resistance and the fins' lift make of velocity through the water."""
    d.by_velocity[i, i] -= drag
    d.by_water[i, i] += drag
    d.by_velocity[i, 0] += gain
    d.by_water[i, 0] -= gain


@inner_kernel
def _skew_row(i: int, momentum: Vec3, scale: float, water: Vec3, a: Array) -> None:
    """Row ``i`` of ``[momentum]x scale + [water]x``: the force of spinning by angular velocity."""
    j, k = (i + 1) % 3, (i + 2) % 3
    a[6 + i, 9 + i] = 0.0
    a[6 + i, 9 + j] = -momentum[k] * scale - water[k]
    a[6 + i, 9 + k] = momentum[j] * scale + water[j]


@inner_kernel
def _torques(y: Array, p: Array, model: Model, feel: Feel, d: Partials) -> None:
    """Rows of the angular velocity; torque by fins sees forward speed through the water."""
    a, b, e = d.a, d.b, feel.turned
    for i in range(3):
        gain = p[i] * feel.slope[3 + i]
        a[9 + i, 6], a[9 + i, 9 + i] = gain, -p[6 + i]
        b[9 + i, _ACTUATION + i], b[9 + i, _DAMPING + 3 + i] = feel.drive[3 + i], -y[9 + i]
        for j in range(3):
            a[9 + i, 3 + j] = -gain * d.turn_water[0, j]
            b[9 + i, _WATER + j] = -gain * e[j, 0]
    for j in range(3):
        a[9, 3 + j] -= model.righting[0] * d.turn_up[1, j]
        a[10, 3 + j] += model.righting[1] * d.turn_up[0, j]
        b[9, _UP + j] = -model.righting[0] * e[j, 1]
        b[10, _UP + j] = model.righting[1] * e[j, 0]


@inner_kernel
def differentiate(y: Array, p: Array, step: Step, model: Model, feel: Feel, d: Partials) -> None:
    """Fill in the derivatives at ``y``, after :func:`~fbn_predict.dynamics.rates` has filled in ``feel``."""
    so3_right_jacobian_into(y[3:6], d.jr)
    _kinematics(y, feel, d)
    _skew_times(feel.water, d.jr, d.turn_water)
    _skew_times(feel.up, d.jr, d.turn_up)
    _forces(y, p, step, model, feel, d)
    _torques(y, p, model, feel, d)


@inner_kernel
def _flow(a: Array, b: Array, s: Array, out: Array) -> None:
    """``out = A S + B``, leaving out the blocks of A that are zero."""
    for i in range(6):
        k = 6 if i < 3 else 9
        a3, a4, a5, c0, c1, c2 = a[i, 3], a[i, 4], a[i, 5], a[i, k], a[i, k + 1], a[i, k + 2]
        for j in range(COLUMNS):
            turn = a3 * s[3, j] + a4 * s[4, j] + a5 * s[5, j]
            out[i, j] = turn + c0 * s[k, j] + c1 * s[k + 1, j] + c2 * s[k + 2, j]
    for i in range(6, 9):
        a3, a4, a5, a6, a7, a8 = a[i, 3], a[i, 4], a[i, 5], a[i, 6], a[i, 7], a[i, 8]
        a9, a10, a11 = a[i, 9], a[i, 10], a[i, 11]
        for j in range(COLUMNS):
            turn = b[i, j] + a3 * s[3, j] + a4 * s[4, j] + a5 * s[5, j]
            linear = a6 * s[6, j] + a7 * s[7, j] + a8 * s[8, j]
            out[i, j] = turn + linear + a9 * s[9, j] + a10 * s[10, j] + a11 * s[11, j]
    for i in range(9, 12):
        a3, a4, a5, a6, own = a[i, 3], a[i, 4], a[i, 5], a[i, 6], a[i, i]
        for j in range(COLUMNS):
            out[i, j] = b[i, j] + a3 * s[3, j] + a4 * s[4, j] + a5 * s[5, j] + a6 * s[6, j] + own * s[i, j]


@inner_kernel
def _flow_at_start(a: Array, b: Array, out: Array) -> None:
    """The same where S is that of the step's start: I by velocity, 0 else."""
    for i in range(12):
        for j in range(COLUMNS):
            out[i, j] = b[i, j]
        for j in range(6):
            out[i, j] += a[i, 6 + j]


@inner_kernel
def _by_attitude_and_water(attitude: Mat3, step: Step, s: Array) -> None:
    """From what is felt of them to attitude and water: ``dwater = A' dw + [water]x dtheta, dup = [up]x dtheta``."""
    u, g = step.water, step.up
    for i in range(12):
        g0, g1, g2 = s[i, _UP], s[i, _UP + 1], s[i, _UP + 2]
        u0, u1, u2 = s[i, _WATER], s[i, _WATER + 1], s[i, _WATER + 2]
        s[i, _UP] = u1 * u[2] - u2 * u[1] + g1 * g[2] - g2 * g[1]
        s[i, _UP + 1] = u2 * u[0] - u0 * u[2] + g2 * g[0] - g0 * g[2]
        s[i, _UP + 2] = u0 * u[1] - u1 * u[0] + g0 * g[1] - g1 * g[0]
        for j in range(3):
            s[i, _WATER + j] = u0 * attitude[j, 0] + u1 * attitude[j, 1] + u2 * attitude[j, 2]


@inner_kernel
def _accumulate(n: int, weight: float, reach: float, ks: Array, s: Array, stage: Array) -> None:
    """Add stage ``n`` to the step's sensitivities ``s``, and set out from the start to the next stage."""
    for i in range(12):
        for j in range(COLUMNS):
            s[i, j] = weight * ks[i, j] + (s[i, j] if n > 0 else 0.0)
            stage[i, j] = reach * ks[i, j]
    for i in range(6):
        stage[6 + i, i] += 1.0
        if n == 0:
            s[6 + i, i] += 1.0


@inner_kernel
def step(
    velocity: Vec6,
    attitude: Mat3,
    p: Array,
    actuators: Array,
    depth: float,
    dt: float,
    model: Model,
    y: Array,
    s: Array,
    wanted: bool,
    scratch: Scratch,
) -> None:
    """One classical Runge-Kutta step: ``y`` (12,) and, where wanted, ``s = dy/d(velocity, attitude, p)`` (12, 24)."""
    here, feel, partials, stage, k, ss, ks = scratch
    begin(attitude, p, actuators, depth, model, here)
    y[0:6], stage[0:6] = 0.0, 0.0
    for i in range(6):
        y[6 + i] = stage[6 + i] = velocity[i]
    for n in range(4):
        weight = dt / 6.0 if n == 0 or n == 3 else dt / 3.0
        reach = dt if n == 2 else 0.5 * dt
        rates(stage, p, here, model, feel, k)
        if wanted:
            differentiate(stage, p, here, model, feel, partials)
            if n == 0:
                _flow_at_start(partials.a, partials.b, ks)
            else:
                _flow(partials.a, partials.b, ss, ks)
            _accumulate(n, weight, reach, ks, s, ss)
        for i in range(12):
            y[i] += weight * k[i]
            stage[i] = reach * k[i]
        for i in range(6):
            stage[6 + i] += velocity[i]
    if wanted:
        _by_attitude_and_water(attitude, here, s)
