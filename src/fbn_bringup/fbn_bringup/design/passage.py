"""What is seen of a target while the vehicle passes it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from fbn_bringup.design.case import Case
from fbn_common.sonar import SonarArray
from fbn_common.types import Array
from fbn_tracking.geometry import observe


@dataclass(frozen=True, slots=True)
class Passage:
    """What is seen of a target while the vehicle passes it on a straight line."""

    pings: int  # with the target in view
    detections: float  # expected
    first: float  # m, range where it comes into view (0: never in view)
    last: float  # m, range where it leaves
    sigma_horizontal: float  # m, given the poses; inf where not enough is seen
    sigma_vertical: float  # m


def passage(case: Case, offset: float) -> Passage:
    """A straight way towards and past a target at ``offset`` [m] to the side, the current from astern.

    Information is that of ranges and bearings where the target is in view, weighed by the chance to be detected, and of
    the lobe at first sight; poses count as known, as for graduation.
    """
    reach = max(a.range_max + np.linalg.norm(a.mount_xyz) for a in case.arrays.values())
    target = np.array([0.0, offset, case.vehicle_depth - case.target_depth])
    information, expected = np.zeros((3, 3)), 0.0
    ranges: list[float] = []
    for x in np.arange(-reach, reach, case.ground_speed / case.ping_rate):
        seen = list(_looks(case, target - np.array([x, 0.0, 0.0])))
        for q, d, array in seen:
            if not ranges:
                lobe = array.lobe_width / sqrt(12.0)  # of what is evenly likely over the lobe
                information += np.outer(d[2], d[2]) / lobe**2
            rows = d[:2] / np.array([[array.range_sigma], [array.bearing_sigma]])
            information += array.detection_probability * rows.T @ rows
            ranges.append(float(q[0]))
            expected += array.detection_probability
    if not ranges or np.linalg.cond(information) > 1e12:
        return Passage(len(ranges), expected, *_ends(ranges), inf, inf)
    covariance = np.linalg.inv(information)
    horizontal = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[1]))
    return Passage(len(ranges), expected, *_ends(ranges), horizontal, float(np.sqrt(covariance[2, 2])))


def _looks(case: Case, place_base: Array) -> Iterator[tuple[Array, Array, SonarArray]]:
    """What each array that has a point of the body's frame in view measures: r, phi, theta, and its derivative."""
    for array in case.arrays.values():
        q, d = observe(array.rotation_base_array, array.position_base, place_base)
        inside = array.range_min <= q[0] <= array.range_max and array.bearing_min <= q[1] <= array.bearing_max
        if inside and abs(q[2]) <= array.lobe_width / 2.0:
            yield q, d, array


def _ends(ranges: list[float]) -> tuple[float, float]:
    return (ranges[0], ranges[-1]) if ranges else (0.0, 0.0)
