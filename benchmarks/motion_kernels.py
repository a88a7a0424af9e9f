"""The EKFs' kernels beside filterpy's EKF of the same size, block by block in turn in one process.

Ours propagates on the manifold (rotation, interpolated motion, 12x24 Jacobian, process noise) and answers compass and
depth with gate and verdict; filterpy is given F, H and h(x) for free and only does the linear algebra.  The filters
have no measurement of 4 degrees of freedom: attitude and depth come as two, and are answered as two, beside filterpy's
one update of 4.  Ours is timed as the filter runs it, in a compiled loop over what is due, and also called by itself
from Python, where handing over its arguments costs about as much as its work.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numba import njit

from fbn_common.graph import GRAPH
from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.layout import GRID_NS, Config, Events, IntArray, Kind, Motions
from fbn_common.motion_ekf.propagate import carry, new_scratch, propagate
from fbn_common.motion_ekf.run import measure
from fbn_common.motion_ekf.warm_up import standstill
from fbn_common.types import Array, seconds
from fbn_ros.host import resolve

BLOCKS, CALLS = 9, 400


class Contest(NamedTuple):
    """Microseconds, medians of the blocks."""

    what: str
    states: int
    ours: float  # in the filter's loop
    alone: float  # called from Python
    filterpy: float

    @property
    def ratio(self) -> float:
        """Ours over theirs."""
        return self.ours / self.filterpy


def contests() -> list[Contest]:
    """Predict and update of both filters."""
    found = []
    for name in ("deadreck", "reference"):
        node = GRAPH.node(name)
        estimator = resolve(node.estimator)(resolve(node.parameters)())
        found += _contest(name, estimator.ekf)
    return found


def _contest(name: str, ekf: MotionEkf) -> list[Contest]:
    n = len(ekf.state.covariance)
    ekf.put_motions(*(standstill(k * GRID_NS) for k in range(3)))
    compass = np.concatenate((np.eye(3).ravel(), 0.01 * np.eye(3).ravel()))
    attitude = np.array([ekf.put_event(GRID_NS, 0, Kind.COMPASS, 0, compass)])
    depth = np.array([ekf.put_event(GRID_NS, 1, Kind.DEPTH, 1, np.array([0.0, 0.01]))])
    x, p, sensors = (a.copy() for a in ekf.state[1:])
    x[:], p[:] = 0.0, 0.01 * np.eye(n)
    x[3:12] = np.eye(3).ravel()
    row, dt = int(np.argmax(ekf.motions.rows.stamp)), seconds(GRID_NS)
    motions, events, config = ekf.motions.rows, ekf.events.rows, ekf.config
    peer = _peer(n, 3)
    predict = _in_turn(
        lambda: _predicts(CALLS, x, p, motions, row, dt, config),
        lambda: _repeat(lambda: propagate(x, p, motions, row, 0.0, 1.0, dt, config)),
        lambda: _repeat(peer.predict),
    )

    def update(slots: IntArray, dof: int) -> tuple[float, ...]:
        peer, h = _peer(n, dof), np.eye(dof, n, 3)
        return _in_turn(
            lambda: _updates(CALLS, slots, x, p, sensors, events, config),
            lambda: _repeat(lambda: [measure(slot, x, p, sensors, events, config) for slot in slots]),
            lambda: _repeat(lambda: peer.update(np.zeros(dof), lambda s: h, lambda s: h @ s)),
        )

    return [
        Contest(f"{name} predict", n, *predict),
        Contest(f"{name} update, 3 dof (compass)", n, *update(attitude, 3)),
        Contest(f"{name} updates, 3 + 1 dof (compass, depth)", n, *update(np.concatenate((attitude, depth)), 4)),
    ]


@njit
def _predicts(count: int, x: Array, p: Array, motions: Motions, row: int, dt: float, config: Config) -> None:
    room = new_scratch(p.shape[0])
    for _ in range(count):
        carry(x, p, motions, row, 0.0, 1.0, dt, config, room)


@njit
def _updates(count: int, slots: IntArray, x: Array, p: Array, sensors: Array, events: Events, config: Config) -> None:
    for _ in range(count):
        for slot in slots:
            measure(slot, x, p, sensors, events, config)


def _peer(n: int, dof: int) -> ExtendedKalmanFilter:
    peer = ExtendedKalmanFilter(dim_x=n, dim_z=dof)
    peer.x, peer.P, peer.F = np.zeros(n), 0.01 * np.eye(n), np.eye(n) + 1e-3 * np.eye(n, k=3)
    peer.Q, peer.R = 1e-8 * np.eye(n), 0.01 * np.eye(dof)
    return peer


def _in_turn(*blocks: Callable[[], object]) -> tuple[float, ...]:
    """Microseconds a call of each, medians over blocks taken in turn."""
    times = np.array([[_time(block) for block in blocks] for _ in range(BLOCKS + 1)])[1:]
    return tuple(np.median(times, axis=0))


def _repeat(call: Callable[[], object]) -> None:
    for _ in range(CALLS):
        call()


def _time(block: Callable[[], object]) -> float:
    begin = time.thread_time()
    block()
    return (time.thread_time() - begin) / CALLS * 1e6
