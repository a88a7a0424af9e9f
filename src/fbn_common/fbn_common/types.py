"""Array aliases: the shapes are conventions, checked where data enters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Vec2 = Array  # (2,)
Vec3 = Array  # (3,)
Vec6 = Array  # (6,)
Quaternion = Array  # (4,) x, y, z, w
Mat2 = Array  # (2, 2)
Mat3 = Array  # (3, 3)
Mat4 = Array  # (4, 4)
Mat6 = Array  # (6, 6)

NS = 1_000_000_000  # nanoseconds in a second


def seconds(duration_ns: int) -> float:
    """A duration in seconds, from nanoseconds."""
    return duration_ns / NS


def nanoseconds(duration_s: float) -> int:
    """A duration in whole nanoseconds, from seconds."""
    return round(duration_s * NS)
