"""Before the first message: every kernel of the filters compiled or loaded, every topic's way taken once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fbn_common.estimator import Estimator
from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.layout import GRID_NS, OWN, SIZE_DEADRECK, Config, Kind
from fbn_common.motion_ekf.output import odometry
from fbn_common.motion_ekf.start import first_state
from fbn_common.records import FluidPressure, Imu, PredictedMotion, Range, Record, VehicleParameters
from fbn_common.types import Array

_STEP_NS, _STEPS = 200_000_000, 10  # long enough for two pings, a fix, and parameters that are adopted
_PARAMETERS = np.full(15, 0.1)  # in their own units: the vehicle of the rehearsal is at rest


def standstill(start_ns: int) -> PredictedMotion:
    """A step of the grid without motion, for warming up and for tests."""

    def zeros(*shape: int) -> Array:
        return np.zeros(shape)

    return PredictedMotion(
        start_ns + GRID_NS, start_ns, zeros(3), zeros(3), zeros(6), zeros(6), zeros(15),
        zeros(12, 6), zeros(12, 3), zeros(12, 15), 1e-6 * np.eye(12), np.array([0.0, 0.0, 0.0, 1.0]),
    )  # fmt: skip


def warm_up(config: Config, size: int, rows: int) -> None:
    """Run a filter of this size over one measurement of each kind."""
    ekf = MotionEkf(size, rows, config, 1.0, lambda slot, x, p: None)
    prior = VehicleParameters(0, "map", _PARAMETERS, np.eye(15))
    compass = np.concatenate((np.eye(3).ravel(), 0.01 * np.eye(3).ravel()))
    own = config.variance[: size - OWN]
    ekf.start(first_state(0, compass, np.array([0.0, 0.01]), prior, np.zeros(6), 1.0, own, config.wander, rows))
    ekf.put_motions(*(standstill(i * GRID_NS) for i in range(6)))
    last = Kind.RANGE if size > SIZE_DEADRECK else Kind.CLIMB
    data = [compass, np.array([0.0, 0.01]), np.array([5.0, 0.01, 0.1, 0.0, 0.5]), np.array([0.0, 0.0, 1.0, 0.0, 1.0]),
            np.array([5.0, 0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0])]  # fmt: skip
    for kind in Kind:
        if kind <= last:
            ekf.put_event(GRID_NS // 2, int(kind), kind, min(int(kind), rows - 1), data[kind])
    ekf.advance(6 * GRID_NS)
    ekf.open_loop(ekf.state_at(GRID_NS), 2 * GRID_NS)
    odometry(ekf.snapshots, [0], "")


def rehearse(estimator: Estimator, own: Callable[[int], list[tuple[str, Record]]]) -> None:
    """Play two made-up seconds to a filter that is thrown away: what :func:`warm_up` calls no kernel of.

    The ways of single records and of the services have small kernels of their own, and touch LAPACK's pages for the
    first time.  ``own`` makes what comes in at a stamp on the topics that only this filter has.
    """
    for end in range(_STEP_NS, (_STEPS + 1) * _STEP_NS, _STEP_NS):
        for topic, record in (*_made_up(end), *own(end)):
            estimator.put(topic, record)
        estimator.advance(end)
    estimator.health()


def _made_up(end_ns: int) -> list[tuple[str, Record]]:
    """What every filter hears during a step: motions at rest, compass, depth, altitude, parameters."""
    none, trifle = np.zeros(3), end_ns * 1e-15  # readings that do not repeat
    level = np.array([trifle, 0.0, 0.0, 1.0])
    motions: list[tuple[str, Record]] = [
        ("predict/motion", replace(standstill(t), parameters=_PARAMETERS))
        for t in range(end_ns - _STEP_NS, end_ns, GRID_NS)
    ]
    return [
        ("predict/parameters", VehicleParameters(end_ns, "map", _PARAMETERS, (1.0 + trifle) * 1e-4 * np.eye(15))),
        *motions,
        ("imu/data", Imu(end_ns, "", level, 1e-4 * np.eye(3), none, np.eye(3), none, np.eye(3))),
        ("pressure", FluidPressure(end_ns, "", 103_000.0 + trifle, 1e4)),
        ("altitude", Range(end_ns, "", 0, 0.1, 0.1, 50.0, 5.0 + trifle)),
    ]
