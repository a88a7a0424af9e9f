"""What the sonar looked at: scans per cell, for negative information."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.records import SweptArea
from fbn_common.types import Array, Mat3, Vec2, Vec3


@kernel
def count_scan(scans: Array, origin: Vec2, cell: float, R: Mat3, p: Vec3, limits: Array) -> None:
    """Add one look to ``scans`` (height, width): cells whose centre lies in range and bearing, elevation ignored.

    ``R`` (3, 3), ``p`` (2+): array in the grid's frame; ``limits``: range min, max, bearing min, max.
    """
    height, width = scans.shape
    reach = limits[1]
    x0, x1 = int((p[0] - reach - origin[0]) / cell), int((p[0] + reach - origin[0]) / cell)
    y0, y1 = int((p[1] - reach - origin[1]) / cell), int((p[1] + reach - origin[1]) / cell)
    nearest, farthest = limits[0] ** 2, limits[1] ** 2
    least, most = np.cos(limits[3]), np.cos(limits[2])  # the cosine falls with the angle
    for j in range(max(y0, 0), min(y1 + 1, height)):
        for i in range(max(x0, 0), min(x1 + 1, width)):
            dx, dy = origin[0] + (i + 0.5) * cell - p[0], origin[1] + (j + 0.5) * cell - p[1]
            square = dx * dx + dy * dy
            if square < nearest or square > farthest or R[0, 0] * dx + R[1, 0] * dy <= 0.0:
                continue
            r, along = np.sqrt(square), R[0, 2] * dx + R[1, 2] * dy
            if least * r <= along <= most * r:
                scans[j, i] += 1.0


def swept_area(looks: Sequence[tuple[Mat3, Vec3, Array]], base: Vec2, cell: float) -> SweptArea:
    """Scan counts of looks (R_world_array, p_world_array, limits) on a grid relative to ``base`` [m].

    No looks give a grid of no cells.
    """
    if not looks:
        return SweptArea(cell, 0, 0, np.zeros(2), np.zeros(0))
    reach = max(limits[1] for _, _, limits in looks)
    xy = np.array([p[:2] for _, p, _ in looks]) - base
    low = np.floor((xy.min(0) - reach) / cell) * cell
    width, height = (int(n) for n in np.ceil((xy.max(0) + reach - low) / cell))
    scans = np.zeros((height, width))
    for (R, _, limits), at in zip(looks, xy, strict=True):
        count_scan(scans, low, cell, np.ascontiguousarray(R), np.ascontiguousarray(at), limits)
    return SweptArea(cell, width, height, low, scans.ravel())
