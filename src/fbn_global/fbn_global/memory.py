"""What is remembered of past composites beside the states: swept areas, and when each feature was seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from fbn_common.records import CompositeMeasurement, SweptArea
from fbn_common.types import Array
from fbn_global.negative import Sweeps, gather

_CELL = 2.0  # m, of the raster that measures the area swept in all


@dataclass(frozen=True, slots=True)
class Sighting:
    """One feature in one composite."""

    sequence: int
    detections: int
    expected: float


class Memory:
    """Swept areas by sequence, sightings by key, and the area [m^2] swept in all."""

    def __init__(self) -> None:
        self.last_sequence = -1
        self.swept_before = 0.0  # m^2, before a restart
        self._areas: dict[int, SweptArea] = {}
        self._sightings: dict[int, list[Sighting]] = {}
        self._cells: set[int] = set()
        self._gather = lru_cache(maxsize=64)(self._gathered)

    def add(self, composite: CompositeMeasurement, base_xy: Array) -> None:
        """Remember a composite whose base is about there (2,) [m, map]."""
        self._areas[composite.sequence] = composite.swept
        self.last_sequence = composite.sequence
        for f in composite.features:
            sighting = Sighting(composite.sequence, f.detections, f.expected)
            self._sightings.setdefault(f.key, []).append(sighting)
        self._cells.update(_raster(composite.swept, base_xy).tolist())

    @property
    def area(self) -> float:
        return self.swept_before + len(self._cells) * _CELL**2

    def sequences(self) -> list[int]:
        return list(self._areas)

    def forget(self, sequences: set[int]) -> None:
        """Forget the swept areas of these composites."""
        for s in sequences:
            self._areas.pop(s, None)

    def forget_all(self) -> None:
        """Forget all but the area swept."""
        self.last_sequence = -1
        self._areas.clear()
        self._sightings.clear()
        self._gather.cache_clear()

    def sweeps(self, sequences: tuple[int, ...]) -> Sweeps:
        return self._gather(sequences)

    def _gathered(self, sequences: tuple[int, ...]) -> Sweeps:
        return gather(tuple(self._areas[s] for s in sequences))

    def area_of(self, sequence: int) -> SweptArea:
        return self._areas[sequence]

    def seen_in(self, key: int, aliases: dict[int, int]) -> set[int]:
        """Sequences of the composites that saw this object, under any of its keys."""
        return {s.sequence for k in _names(key, aliases) for s in self._sightings.get(k, ())}

    def detected(self, key: int, aliases: dict[int, int]) -> tuple[float, float]:
        """Detections of an object, and scans that should have seen it."""
        sightings = [s for k in _names(key, aliases) for s in self._sightings.get(k, ())]
        return float(sum(s.detections for s in sightings)), float(sum(s.expected for s in sightings))

    def together(self, keys: tuple[int, ...], aliases: dict[int, int]) -> npt.NDArray[np.bool_]:
        """Whether (n, n) two features were seen in one composite: then they are two objects."""
        seen = [self.seen_in(k, aliases) for k in keys]
        return np.array([[bool(a & b) for b in seen] for a in seen], dtype=np.bool_).reshape(len(keys), len(keys))


def _names(key: int, aliases: dict[int, int]) -> list[int]:
    return [key, *(k for k, older in aliases.items() if older == key)]


def _raster(area: SweptArea, base_xy: Array) -> npt.NDArray[np.int64]:
    """Codes of the raster's cells that the sweep covers."""
    scans = np.asarray(area.scans, dtype=float)
    rows, columns = np.divmod(np.flatnonzero(scans > 0.5), max(area.width, 1))
    x = np.floor((base_xy[0] + area.origin[0] + (columns + 0.5) * area.cell_size) / _CELL)
    y = np.floor((base_xy[1] + area.origin[1] + (rows + 0.5) * area.cell_size) / _CELL)
    return np.unique((x.astype(np.int64) << 32) + y.astype(np.int64))
