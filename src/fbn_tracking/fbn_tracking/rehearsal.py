"""A made-up dozen pings past one target, to be played before the first real one.

Kernels are compiled by :mod:`fbn_tracking.warm_up`; what is left are the pages of LAPACK's code that a
graduation, a cut and a composite touch for the first time.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fbn_common.records import PingMotion, Pose, Record, SonarDetection, SonarDetections
from fbn_common.sonar import SonarArray, polar
from fbn_common.types import NS

_PINGS = 12  # enough to graduate with both elevations in doubt
_STEP = 0.5  # m a ping
_LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
_DEPTH = 2.0  # m


def rehearsal(arrays: dict[str, SonarArray]) -> Iterator[list[Record]]:
    """What comes in at each ping: a scan of every array, with the echo of a target in its middle, and the motion.

    The last one starts a new chain, so that all before it becomes a composite.
    """
    for number in range(_PINGS):
        scans = [_scan(name, array, number) for name, array in arrays.items()]
        yield [*scans, _motion(number, first=number == 0)]
    yield [_motion(_PINGS, first=True)]


def _motion(number: int, first: bool) -> PingMotion:
    stamp_ns, step = number * NS, 0.0 if first else _STEP
    variances = np.array([0.05, 0.01, 0.01, 0.03]) ** 2
    return PingMotion(
        stamp_ns, "odom", stamp_ns if first else stamp_ns - NS, Pose(np.array([step, 0.0, 0.0]), _LEVEL),
        Pose(np.array([_STEP * number, 0.0, -_DEPTH]), _LEVEL), 5.0, 0.01, 600.0, 1e-4 * np.eye(6),
        np.array([-_DEPTH, 0.0, 0.0, 0.0]), np.diag(1.0 / variances), np.diag(variances),
        np.array([_STEP, 0.0, 0.0, 0.0, 0.0, 0.0]), np.diag([1e-2, 1e-2, 1e-6]),
    )  # fmt: skip


def _scan(name: str, array: SonarArray, number: int) -> SonarDetections:
    limits = (array.range_min, array.range_max, array.bearing_min, array.bearing_max)
    r, phi = 0.5 * (array.range_min + array.range_max), 0.5 * (array.bearing_min + array.bearing_max)
    target = r * np.array([np.sin(phi), 0.0, np.cos(phi)])  # in the array's frame at the first ping
    moved = array.rotation_base_array.T @ np.array([_STEP * number, 0.0, 0.0])
    at, bearing, _ = polar(target - moved)
    echo = SonarDetection(at, bearing, array.range_sigma, array.bearing_sigma, 1.0)
    return SonarDetections(number * NS, name, number, *limits, array.lobe_width, (echo,))
