"""What the sonar swept in a dive, laid on the map, and which features of the map it should have seen there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fbn_common import records as r
from fbn_common.types import Array, Vec2

CELL = 2.0  # m, of the raster that is drawn
ENOUGH = 7.0  # scans after which an object should have become a feature: detections that make one, IROS 2007 V

OnMap = Callable[[Array], Array]  # points (n, 3) of odom to xy (n, 2) on the map


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """Scans (rows along y, columns along x) of each cell; NaN where none; the lower corner [m, map]."""

    corner: Vec2
    scans: Array

    def at(self, xy: Array) -> Array:
        """Scans (n,) at these places (n, 2); 0 outside."""
        cells = np.floor((xy - self.corner) / CELL).astype(int)
        inside = ((cells >= 0) & (cells < np.array(self.scans.shape)[::-1])).all(axis=1)
        found = np.zeros(len(xy))
        found[inside] = np.nan_to_num(self.scans[cells[inside, 1], cells[inside, 0]])
        return found


def swept(composites: Sequence[r.CompositeMeasurement], on_map: OnMap) -> Raster | None:
    """The sweeps of several composites added up; None where nothing was swept."""
    parts = [_cells(c, on_map) for c in composites]
    xy = np.concatenate([np.zeros((0, 2)), *(p[0] for p in parts)])
    if not len(xy):
        return None
    low = np.floor(xy.min(axis=0) / CELL) * CELL
    columns, rows = (np.floor((xy.max(axis=0) - low) / CELL).astype(int) + 1).tolist()
    total = np.zeros((rows, columns))
    for places, scans in parts:
        at = np.floor((places - low) / CELL).astype(int)
        sums, counts = np.zeros_like(total), np.zeros_like(total)
        np.add.at(sums, (at[:, 1], at[:, 0]), scans)
        np.add.at(counts, (at[:, 1], at[:, 0]), 1.0)
        total += sums / np.maximum(counts, 1.0)  # of several fine cells in one of the raster, the mean
    return Raster(low, np.where(total > 0.0, total, np.nan))


def _cells(c: r.CompositeMeasurement, on_map: OnMap) -> tuple[Array, Array]:
    """Where a composite's cells with scans lie on the map (n, 2), and their scans (n,)."""
    scans = np.asarray(c.swept.scans, dtype=float)
    some = np.flatnonzero(scans > 0.0)
    rows, columns = np.divmod(some, max(c.swept.width, 1))
    xy = c.base_odom.position[:2] + c.swept.origin + c.swept.cell_size * (np.column_stack([columns, rows]) + 0.5)
    return on_map(np.column_stack([xy, np.zeros(len(xy))])), scans[some]


def missed(raster: Raster | None, map_xy: Array, seen: set[int]) -> tuple[int, ...]:
    """Rows of features (n, 2) that were scanned enough to be found, and were not."""
    if raster is None or not len(map_xy):
        return ()
    expected = raster.at(map_xy) >= ENOUGH
    return tuple(row for row in np.flatnonzero(expected).tolist() if row not in seen)
