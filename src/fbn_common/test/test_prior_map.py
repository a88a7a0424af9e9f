"""The prior map's file: what goes in comes out, and what is broken is refused by feature and reason."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbn_common.geodesy import GeodeticPoint, geodetic_from_enu
from fbn_common.prior_map import PriorFeature, PriorMap, PriorMapError, parse_prior_map, read_prior_map, write_prior_map

DATUM = GeodeticPoint(42.35, -71.09, 0.0)


def a_feature(**changes: Any) -> dict[str, Any]:
    properties = {"id": 4, "name": "reflector", "sigma": 5.0, "visibility": 0.7, "target": True}
    item: dict[str, Any] = {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [-71.09, 42.35, -4.0]},
        "properties": properties,
    }
    properties |= {k: v for k, v in changes.items() if k != "geometry"}
    return item | {k: v for k, v in changes.items() if k == "geometry"}


def a_map(*features: Any, **top: Any) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(features), **top}


@pytest.mark.parametrize("datum", [None, DATUM])
def test_a_written_map_is_read_back_to_a_tenth_of_a_millimetre(tmp_path: Path, datum: Any) -> None:
    enu = np.array([[0.0, 0.0, -4.0], [123.4, -56.7, -4.5], [1500.0, 800.0, -10.0]])
    geodetic = [geodetic_from_enu(np.array([x, y, 0.0]), DATUM) for x, y, _ in enu]
    features = tuple(
        PriorFeature(i, g.latitude, g.longitude, enu[i, 2], f"f{i}", 5.0, 0.7, 0.9, i == 1)
        for i, g in enumerate(geodetic)
    )
    write_prior_map(tmp_path / "map.geojson", PriorMap(features), datum)
    back = read_prior_map(tmp_path / "map.geojson")
    horizontal = back.positions(DATUM)[:, :2]
    # the earth curves away by d^2 / 2R = 0.23 m at 1.7 km; tilted by d / R that is 6e-5 m on the horizontal
    np.testing.assert_allclose(horizontal, enu[:, :2], atol=2e-4)
    assert [(f.id, f.name, f.up, f.target) for f in back.features] == [(f.id, f.name, f.up, f.target) for f in features]


def test_a_point_without_height_has_an_unknown_one() -> None:
    prior = parse_prior_map(a_map(a_feature(geometry={"type": "Point", "coordinates": [-71.09, 42.35]})))
    assert np.isnan(prior.positions(DATUM)[0, 2])


def test_an_empty_map_is_a_map() -> None:
    assert parse_prior_map(a_map()).positions(DATUM).shape == (0, 3)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"id": "four"}, "id must be an integer"),
        ({"id": True}, "id must be an integer"),
        ({"sigma": 0.0}, "sigma must be"),
        ({"sigma": float("nan")}, "sigma must be"),
        ({"visibility": 1.5}, "visibility must be"),
        ({"existence": "sure"}, "existence must be"),
        ({"target": "yes"}, "target true or false"),
        ({"geometry": {"type": "LineString", "coordinates": [[0, 0], [1, 1]]}}, "must be a Point"),
        ({"geometry": {"type": "Point", "coordinates": [float("inf"), 0.0]}}, "finite numbers"),
        ({"geometry": {"type": "Point", "coordinates": [1.0]}}, "finite numbers"),
        ({"geometry": {"type": "Point", "coordinates": [42.35, -171.0]}}, "no place on earth"),
        ({"geometry": None}, "must be a Point"),
    ],
)
def test_a_broken_feature_is_refused_by_index_id_and_reason(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(PriorMapError, match=reason) as caught:
        parse_prior_map(a_map(a_feature(id=1), a_feature(id=2), a_feature(**changes)))
    assert caught.value.index == 2
    assert caught.value.feature_id == changes.get("id", 4)


def test_two_features_with_one_id_are_refused() -> None:
    with pytest.raises(PriorMapError, match="same id") as caught:
        parse_prior_map(a_map(a_feature(), a_feature()))
    assert (caught.value.index, caught.value.feature_id) == (1, 4)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{", "is not GeoJSON"), ("[]", "FeatureCollection"), (json.dumps({"type": "Feature"}), "FeatureCollection")],
)
def test_a_file_that_is_no_map_is_refused_by_name(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "broken.geojson"
    path.write_text(text)
    with pytest.raises(PriorMapError, match=rf"broken\.geojson: .*{reason}"):
        read_prior_map(path)


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(PriorMapError, match=r"none\.geojson: can't be read"):
        read_prior_map(tmp_path / "none.geojson")


def test_a_datum_that_is_no_place_is_refused() -> None:
    with pytest.raises(PriorMapError, match="no place on earth"):
        parse_prior_map(a_map(properties={"datum": [142.0, 0.0, 0.0]}))
