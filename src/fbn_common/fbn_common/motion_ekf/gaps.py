"""Motions that never came: a short gap is bridged with the velocity held, a long one is leapt."""

from __future__ import annotations

import numpy as np

from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.layout import GRID_NS
from fbn_common.motion_ekf.parameters import HistoryParameters
from fbn_common.motion_ekf.start import state_after_gap
from fbn_common.types import nanoseconds

_SPREAD = np.array([0.02, 0.02, 0.02, 0.05, 0.05, 0.05])  # m^2/s^3, rad^2/s^3: 0.15 m/s and 0.2 rad/s after 1 s


def overdue(ekf: MotionEkf, history: HistoryParameters, now_ns: int) -> bool:
    """Whether the next motion is missing while later ones have come, and has been waited for long enough."""
    head, patience = ekf.head_ns, nanoseconds(history.patience)
    return min(ekf.motions.newest_ns, now_ns) - head >= patience and not ekf.motions.has(head + GRID_NS)


def too_long(ekf: MotionEkf, history: HistoryParameters) -> bool:
    """Whether the gap at the head is one over which the velocity cannot be held."""
    return ekf.motions.newest_ns - ekf.head_ns > nanoseconds(history.max_gap)


def hold_velocity(ekf: MotionEkf) -> int:
    """Fill the gap at the head with motions at constant velocity; how many steps of the grid they are."""
    end = ekf.head_ns + GRID_NS
    while not ekf.motions.has(end):
        ekf.motions.bridge(end, _SPREAD)
        end += GRID_NS
    return (end - ekf.head_ns) // GRID_NS - 1


def leap(ekf: MotionEkf, history: HistoryParameters) -> None:
    """Go on behind the gap with the position as it was, uncertain by what may have happened in the meantime."""
    ekf.start(state_after_gap(ekf.state, ekf.motions.newest_ns - GRID_NS, history.drift_speed))
