"""The geometry of a sonar array: mount, field of view, noise.

A blazed array measures range ``r`` and the angle ``phi`` to its own axis, which is the z axis of its frame;
the angle ``theta`` around that axis is known only to the width of the lobe.  In the array's frame a target is
at ``r (sin phi cos theta, sin phi sin theta, cos phi)``: x looks along the middle of the lobe and, for an
array mounted level with its axis to the left, positive theta is down.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from fbn_common.lie import matrix_from_rpy
from fbn_common.parameters import ParameterError, param
from fbn_common.types import Array, Mat3, Vec3

FRAME_BASE_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""R_base_array of a level array that looks forward: its x forward, its y down, its z left."""


@dataclass(frozen=True, slots=True)
class SonarArray:
    """One array of a sonar; its name is the ``frame_id`` of its detections."""

    mount_xyz: tuple[float, float, float] = param(
        (0.6, 0.0, 0.0), "m", "position in base_link", "Ranger: nose, 1.3 m long"
    )
    mount_rpy: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0),
        "rad",
        "turn of the look direction from forward: roll, pitch (down positive), yaw",
        "level, ahead",
    )
    bearing_min: float = param(pi / 2 - 0.3927, "rad", "smallest angle to the array's axis", "45 deg field of view")
    bearing_max: float = param(pi / 2 + 0.3927, "rad", "largest angle to the array's axis", "45 deg field of view")
    range_min: float = param(4.0, "m", "nearest usable range", "900 kHz blazed array, IROS 2007 II")
    range_max: float = param(40.0, "m", "farthest usable range", "900 kHz blazed array, IROS 2007 II")
    lobe_width: float = param(0.349, "rad", "full width of the lobe around the axis", "20 deg, JOE 2013 III")
    range_sigma: float = param(0.05, "m", "standard deviation of range", "3 cm, and the target's own size")
    bearing_sigma: float = param(0.0175, "rad", "standard deviation of bearing", "1 deg, JOE 2013 III")
    detection_probability: float = param(
        0.67, "-", "chance to detect a feature in view", "two of three scans, JOE 2013 III-B"
    )

    def __post_init__(self) -> None:
        if not 0.0 <= self.bearing_min < self.bearing_max <= pi:
            raise ParameterError("bearing_min and bearing_max must satisfy 0 <= min < max <= pi [rad]")
        if not 0.0 <= self.range_min < self.range_max:
            raise ParameterError("range_min and range_max must satisfy 0 <= min < max [m]")
        if min(self.lobe_width, self.range_sigma, self.bearing_sigma) <= 0.0:
            raise ParameterError("lobe_width, range_sigma and bearing_sigma must be positive")
        if not 0.0 < self.detection_probability < 1.0:
            raise ParameterError("detection_probability must lie between 0 and 1")

    @property
    def rotation_base_array(self) -> Mat3:
        """R_base_array: array coordinates to base_link."""
        return np.ascontiguousarray(matrix_from_rpy(np.array(self.mount_rpy)) @ FRAME_BASE_LEVEL)

    @property
    def position_base(self) -> Vec3:
        """The array's origin in base_link [m]."""
        return np.array(self.mount_xyz)


def cartesian(r: float, phi: float, theta: float) -> Array:
    """The point (3,) [m] in the array's frame at range, bearing to the axis and angle around it [m, rad, rad]."""
    return r * np.array([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)])


def polar(point: Vec3) -> tuple[float, float, float]:
    """Range, bearing to the axis, angle around it [m, rad, rad] of a point (3,) in the array's frame."""
    r = float(np.sqrt(point @ point))
    return r, float(np.arccos(np.clip(point[2] / max(r, 1e-12), -1.0, 1.0))), float(np.arctan2(point[1], point[0]))
