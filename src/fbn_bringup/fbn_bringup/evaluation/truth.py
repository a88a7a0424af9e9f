"""What the simulator knows beside a bag: ``truth.yaml`` with the true features and the datum of true positions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import yaml

from fbn_common.records import Datum
from fbn_common.types import Array, Vec3

FILE = "truth.yaml"


class TruthError(ValueError):
    """A truth file cannot be used; the text says why."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueFeature:
    """One object of the world; ``map_id`` is its id on the prior map, None if it is missing there."""

    id: int
    position: Vec3  # m, ENU at the truth's datum
    map_id: int | None
    target: bool


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true features, and where ENU of true positions has its origin."""

    datum: tuple[float, float, float]  # deg, deg, m
    features: tuple[TrueFeature, ...]

    def on_map(self) -> dict[int, TrueFeature]:
        """True features by their id on the prior map."""
        return {f.map_id: f for f in self.features if f.map_id is not None}

    def offset_to(self, datum: Datum | None) -> Vec3:
        """What to add to true positions to have them in a run's map, whose datum may differ by GPS error [m]."""
        if datum is None:
            return np.zeros(3)
        enu = pymap3d.geodetic2enu(*self.datum, datum.latitude, datum.longitude, datum.height)
        return np.array([float(c) for c in enu]) * np.array([1.0, 1.0, 0.0])

    def shifted(self, offset: Array) -> Truth:
        """The same truth with all positions moved [m]."""
        moved = (TrueFeature(f.id, f.position + offset, f.map_id, f.target) for f in self.features)
        return Truth(self.datum, tuple(moved))


def load(path: Path) -> Truth:
    """The truth in a file; raises TruthError naming the entry that is wrong."""
    try:
        return parse(yaml.safe_load(path.read_text()))
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise TruthError(f"{path}: not a truth file of the simulator ({type(error).__name__}: {error})") from error


def parse(document: dict[str, Any]) -> Truth:
    """The truth in a document as the simulator writes it."""
    datum = document["datum"]
    origin = (float(datum["latitude"]), float(datum["longitude"]), float(datum.get("height", 0.0)))
    return Truth(origin, tuple(_feature(entry) for entry in document["features"]))


def _feature(entry: dict[str, Any]) -> TrueFeature:
    position = np.array(entry["position"], dtype=float)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise ValueError(f"feature {entry.get('id')}: position must be three finite numbers [m]")
    map_id = entry.get("map_id")
    return TrueFeature(int(entry["id"]), position, None if map_id is None else int(map_id), bool(entry.get("target")))
