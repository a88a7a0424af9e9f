"""Compile (or load from the cache) every kernel of the filters before the first message."""

from __future__ import annotations

import numpy as np

from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.layout import GRID_NS, OWN, SIZE_DEADRECK, Config, Kind
from fbn_common.motion_ekf.output import odometry
from fbn_common.motion_ekf.start import first_state
from fbn_common.records import PredictedMotion, VehicleParameters
from fbn_common.types import Array


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
    prior = VehicleParameters(0, "map", np.full(15, 0.1), np.eye(15))
    compass = np.concatenate((np.eye(3).ravel(), 0.01 * np.eye(3).ravel()))
    own = config.variance[: size - OWN]
    ekf.start(first_state(0, compass, np.array([0.0, 0.01]), prior, np.zeros(6), 1.0, own, rows))
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
