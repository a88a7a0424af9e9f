"""The prior map: points that another vehicle found, read from and written to GeoJSON.

A ``FeatureCollection`` of points (longitude [deg], latitude [deg], up [m]), which any GIS opens.  Up is the
``map`` frame's own z: metres above its datum, negative under water.  Properties of a feature:

- ``id`` (integer, needed, unique); ``name`` (text);
- ``sigma`` [m]: standard deviation of the position, per horizontal axis, absolute (shared with its neighbours
  for the greater part); left out: the reader's default;
- ``visibility`` (0..1]: chance to be detected by one scan; ``existence`` (0..1]; ``target`` (true or false).

With ``properties.datum`` (latitude [deg], longitude [deg], height [m]) at the top level the coordinates are
east, north, up [m] about that datum instead.  (Plain ``json`` here: the ``geojson`` library rounds coordinates to
six decimals both ways, which is 0.1 m.)
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fbn_common.geodesy import GeodeticPoint, enu_from_geodetic, geodetic_from_enu
from fbn_common.types import Array, Vec3


class PriorMapError(ValueError):
    """A map that can't be used: which file, which feature (index and id, where it is one's fault), and why."""

    def __init__(
        self, reason: str, index: int | None = None, feature_id: Any = None, source: str = "prior map"
    ) -> None:
        self.reason, self.index, self.feature_id, self.source = reason, index, feature_id, source
        named = "" if feature_id is None else f" (id {feature_id!r})"
        where = "" if index is None else f"feature {index}{named}: "
        super().__init__(f"{source}: {where}{reason}")


@dataclass(frozen=True, slots=True)
class PriorFeature:
    """One point of the map; ``None`` is unknown, and the reader's default holds."""

    id: int
    latitude: float  # deg
    longitude: float  # deg
    up: float | None  # m, z in map
    name: str = ""
    sigma: float | None = None  # m, per horizontal axis
    visibility: float | None = None  # detections per scan
    existence: float | None = None  # probability
    target: bool = False


@dataclass(frozen=True, slots=True)
class PriorMap:
    """All points, in the order of the file."""

    features: tuple[PriorFeature, ...]

    def positions(self, datum: GeodeticPoint) -> Array:
        """East, north, up (n, 3) [m] about a datum; up is NaN where it is unknown."""
        enu = np.zeros((len(self.features), 3))
        for row, f in zip(enu, self.features, strict=True):
            row[:] = enu_from_geodetic(f.latitude, f.longitude, datum.height, datum)
            row[2] = np.nan if f.up is None else f.up
        return enu


def read_prior_map(path: Path) -> PriorMap:
    """The map in a GeoJSON file; PriorMapError says what is wrong with the file or with which feature."""
    source = path.name
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise PriorMapError(f"can't be read: {error}", source=source) from error
    except ValueError as error:
        raise PriorMapError(f"is not GeoJSON: {error}", source=source) from error
    return parse_prior_map(document, source)


def parse_prior_map(document: Any, source: str = "prior map") -> PriorMap:
    """The map in a parsed GeoJSON document."""
    if not isinstance(document, Mapping) or document.get("type") != "FeatureCollection":
        kind = document.get("type") if isinstance(document, Mapping) else type(document).__name__
        raise PriorMapError(f"must be a FeatureCollection, got {kind!r}", source=source)
    items = document.get("features")
    if not isinstance(items, list):
        raise PriorMapError("'features' must be a list", source=source)
    datum = _datum(document, source)
    features: list[PriorFeature] = []
    seen: set[int] = set()
    for index, item in enumerate(items):
        feature = _feature(item, index, datum, source)
        if feature.id in seen:
            raise PriorMapError("another feature has the same id", index, feature.id, source)
        seen.add(feature.id)
        features.append(feature)
    return PriorMap(tuple(features))


def write_prior_map(path: Path, prior: PriorMap, datum: GeodeticPoint | None = None) -> None:
    """Write the map, whole or not at all; with a datum in local coordinates about it, else geodetic."""
    local = prior.positions(datum) if datum is not None else None
    features = [_item(f, None if local is None else local[i]) for i, f in enumerate(prior.features)]
    document: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if datum is not None:
        document["properties"] = {"datum": [datum.latitude, datum.longitude, datum.height]}
    temporary = path.with_suffix(path.suffix + ".part")
    temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    os.replace(temporary, path)


def _item(feature: PriorFeature, local: Vec3 | None) -> Any:
    horizontal = [feature.longitude, feature.latitude] if local is None else [float(local[0]), float(local[1])]
    coordinates = horizontal if feature.up is None else [*horizontal, feature.up]
    optional = {"sigma": feature.sigma, "visibility": feature.visibility, "existence": feature.existence}
    properties = {"id": feature.id, "name": feature.name, "target": feature.target}
    properties |= {key: value for key, value in optional.items() if value is not None}
    geometry = {"type": "Point", "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _datum(document: Mapping[str, Any], source: str) -> GeodeticPoint | None:
    properties = document.get("properties")
    datum = properties.get("datum") if isinstance(properties, Mapping) else None
    if datum is None:
        return None
    if isinstance(datum, Mapping):
        datum = [datum.get(key) for key in ("latitude", "longitude", "height")]
    if not isinstance(datum, list) or len(datum) != 3 or not all(_finite(v) for v in datum):
        raise PriorMapError(f"datum must be latitude, longitude, height, got {datum!r}", source=source)
    if abs(datum[0]) > 90.0 or abs(datum[1]) > 180.0:
        raise PriorMapError(f"datum is no place on earth: latitude {datum[0]}, longitude {datum[1]}", source=source)
    return GeodeticPoint(*(float(v) for v in datum))


def _feature(item: Any, index: int, datum: GeodeticPoint | None, source: str) -> PriorFeature:
    def refuse(reason: str) -> PriorMapError:
        return PriorMapError(reason, index, identity, source)

    properties = item.get("properties") if isinstance(item, Mapping) else None
    if not isinstance(properties, Mapping):
        identity = None
        raise refuse("has no properties")
    identity = properties.get("id", item.get("id"))
    if isinstance(identity, bool) or not isinstance(identity, int) or identity < 0:
        raise refuse(f"id must be an integer of at least 0, got {identity!r}")
    geometry = item.get("geometry")
    if not isinstance(geometry, Mapping) or geometry.get("type") != "Point":
        raise refuse("geometry must be a Point")
    coordinates = geometry.get("coordinates")
    if not isinstance(coordinates, list) or len(coordinates) not in (2, 3) or not all(_finite(v) for v in coordinates):
        raise refuse(f"coordinates must be two or three finite numbers, got {coordinates!r}")
    up = float(coordinates[2]) if len(coordinates) == 3 else None
    latitude, longitude = _geodetic(coordinates, datum)
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        place = f"latitude {latitude}, longitude {longitude} (the order is longitude, latitude)"
        raise refuse(f"is no place on earth: {place}")
    name, target = properties.get("name", ""), properties.get("target", False)
    if not isinstance(name, str) or not isinstance(target, bool):
        raise refuse(f"name must be text and target true or false, got {name!r} and {target!r}")
    values = {key: properties.get(key) for key in ("sigma", "visibility", "existence")}
    for key, value in values.items():
        highest = math.inf if key == "sigma" else 1.0
        if value is not None and not (_finite(value) and 0.0 < value <= highest):
            raise refuse(f"{key} must be a number above 0{'' if key == 'sigma' else ' and at most 1'}, got {value!r}")
    return PriorFeature(identity, latitude, longitude, up, name, target=target, **values)


def _geodetic(coordinates: list[float], datum: GeodeticPoint | None) -> tuple[float, float]:
    """Latitude and longitude [deg] of a point's coordinates."""
    if datum is None:
        return float(coordinates[1]), float(coordinates[0])
    point = geodetic_from_enu(np.array([coordinates[0], coordinates[1], 0.0]), datum)
    return point.latitude, point.longitude


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
