"""The EKF's transition is the derivative of its own prediction, for a motion that predict computed."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fbn_common.lie import matrix_from_rpy, so3_log
from fbn_common.motion_ekf.filter import MotionFilter
from fbn_common.motion_ekf.layout import (
    ESTIMATED_REFERENCE,
    GRID_NS,
    LAYER,
    LOSS,
    SIZE_REFERENCE,
    THRUST,
    WATER,
    X_DEVIATION,
    X_LAYER,
    X_PARAMETERS,
    X_SIZE,
    X_VELOCITY,
    Config,
)
from fbn_common.motion_ekf.measure import apply_error
from fbn_common.motion_ekf.parameters import FilterParameters
from fbn_common.motion_ekf.propagate import propagate, rotation_of, set_rotation
from fbn_common.motion_ekf.timeline import MotionLog
from fbn_common.records import JointState, PredictedMotion
from fbn_common.types import Array
from fbn_predict.estimator import MOTION, Predict
from fbn_predict.parameters import PredictParameters

N = SIZE_REFERENCE


def config() -> Config:
    """A filter's, with nothing but the transition left."""
    base = MotionFilter(FilterParameters(), {}, 4).config()
    still = base._replace(walk=np.zeros(15), water_share=0.0, wander_time=1e15, tau=np.full(15, 1e15))
    return still._replace(estimated=ESTIMATED_REFERENCE)


CONFIG = config()
PREDICT = Predict(PredictParameters())


def motion() -> MotionLog:
    """The first step of a vehicle under way."""
    log, predict = MotionLog(), PREDICT
    predict._reset()
    names = ("propeller", "pan", "tilt")
    predict.put("actuators", JointState(0, "", names, np.array([0, 0.3, 0.1]), np.array([120.0, 0, 0]), np.empty(0)))
    for out in predict.advance(3_000_000_000):
        if out.topic == MOTION and isinstance(out.record, PredictedMotion):
            log.put(out.record)
    return log


LOG = motion()
K = 250


def error(a: Array, b: Array) -> Array:
    """``b (-) a`` (36,)."""
    turn = so3_log(np.ascontiguousarray(rotation_of(a).T @ rotation_of(b)))
    return np.concatenate((b[:3] - a[:3], turn, b[X_VELOCITY:] - a[X_VELOCITY:]))


@settings(max_examples=25)
@given(st.lists(st.floats(-1.0, 1.0), min_size=40, max_size=40).map(np.array))
def test_the_transition_equals_its_numerical_derivative_at_any_heading(u: Array) -> None:
    rows = LOG.rows
    x0 = np.zeros(X_SIZE)
    used = rows.attitude[K].reshape(3, 3)
    set_rotation(x0, matrix_from_rpy(np.array([0.0, 0.0, 3.0 * u[0]])) @ used @ matrix_from_rpy(0.001 * u[1:4]))
    x0[X_VELOCITY:X_PARAMETERS] = rows.mean[K, 6:12] + 0.02 * u[4:10]
    x0[X_PARAMETERS:X_DEVIATION] = rows.parameters[K] * (1.0 + 0.05 * u[10:25])
    x0[X_PARAMETERS + 12 : X_DEVIATION] = 0.1 * u[25:28]
    x0[X_LAYER:] = 0.1 * u[28:30]
    x0[2] = -0.1  # near the surface
    rows.noise[K] = 0.0

    def moved(dx: Array) -> Array:
        x = x0.copy()
        apply_error(x, dx)
        propagate(x, np.eye(N), rows, K, 0.0, 1.0, GRID_NS * 1e-9, CONFIG)
        return x

    n = ESTIMATED_REFERENCE
    nominal, h = moved(np.zeros(n)), 1e-6
    f = np.eye(N)
    columns = [(error(nominal, moved(h * e)) - error(nominal, moved(-h * e))) / (2 * h) for e in np.eye(n)]
    f[:n, :n] = np.column_stack(columns)
    # thrust lost takes its share of the gain ahead; the top layer's motion adds to the water's, less with depth
    f[:12, LOSS] = -x0[X_PARAMETERS + 9] * f[:12, THRUST]
    fade = np.exp(-0.1 / CONFIG.layer_depth)
    np.testing.assert_allclose(f[:12, LAYER : LAYER + 2], fade * f[:12, WATER : WATER + 2], atol=1e-9)
    p = np.eye(N)
    propagate(x0.copy(), p, rows, K, 0.0, 1.0, GRID_NS * 1e-9, CONFIG)
    # left out: second-order terms of the motion's own linearisation; the largest is righting, 19 1/s^2, by
    # an offset of 0.001 rad, over 0.01 s, and damping's derivative by an offset of 0.02 m/s, both ways; and water of
    # another speed than the motion was computed with, which drags another way when the vehicle turns
    water = x0[X_PARAMETERS + 12 : X_DEVIATION] + fade * np.array([*x0[X_LAYER:], 0.0])
    offset = np.linalg.norm(water - rows.parameters[K, -3:])
    turned = GRID_NS * 1e-9 * 1.05 * rows.parameters[K, 3:6].max() * offset
    np.testing.assert_allclose(p, f @ f.T, atol=6e-4 + turned)
