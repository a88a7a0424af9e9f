"""Sonar files: those that come along, how a head carries its arrays, and what a wrong file is answered."""

from __future__ import annotations

from itertools import pairwise
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fbn_common.lie import matrix_from_rpy
from fbn_common.parameters import ParameterError, flatten
from fbn_common.sonar import SonarArray, cartesian
from fbn_common.sonar_file import SonarHead, load_sonar, mounted, sonar_names, with_sonar_file

GENERIC: dict[str, Any] = {
    "name": "Mine",
    "about": "a test",
    "frequency": 7e5,
    "aperture": 0.1,
    "ping_rate": 5.0,
    "array": {
        "bearing_min": 1.0,
        "bearing_max": 2.0,
        "range_min": 1.0,
        "range_max": 50.0,
        "lobe_width": 0.3,
        "range_sigma": 0.05,
        "bearing_sigma": 0.02,
        "detection_probability": 0.5,
    },
    "arrays": {"port": {"mount_rpy": [0.0, 0.0, 0.5]}, "starboard": {"range_max": 30.0}},
}


def _write(tmp_path: Path, document: object) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.mark.parametrize("name", sonar_names())
def test_every_sonar_that_comes_along_loads_and_says_what_it_is(name: str) -> None:
    model = load_sonar(name)
    assert model.name and model.about and model.arrays
    assert 1e-3 < model.wavelength < 4e-3
    # the beam of a line array: wavelength over aperture, 1 degree in all of these; stated to three digits
    assert model.wavelength / model.aperture == pytest.approx(np.deg2rad(1.0), rel=0.01)


@pytest.mark.parametrize(("series", "fov"), [(s, f) for s in ("p450", "p900") for f in (45, 90, 130)])
def test_the_arrays_of_a_blazed_sonar_cover_its_view_without_gap_or_overlap(series: str, fov: int) -> None:
    arrays = load_sonar(f"blueview_{series}_{fov}").arrays.values()
    # what an array sees, as angles to the left of ahead: its yaw plus (axis to the left) pi/2 - bearing
    seen = sorted((a.mount_rpy[2] + pi / 2 - a.bearing_max, a.mount_rpy[2] + pi / 2 - a.bearing_min) for a in arrays)
    assert seen[0][0] == pytest.approx(-np.deg2rad(fov / 2), abs=1e-4)  # five decimals a number in the file
    assert seen[-1][1] == pytest.approx(np.deg2rad(fov / 2), abs=1e-4)
    for (_, end), (begin, _) in pairwise(seen):
        assert begin == pytest.approx(end, abs=2e-5)


def test_what_arrays_share_is_said_once_and_an_array_may_differ(tmp_path: Path) -> None:
    arrays = load_sonar(_write(tmp_path, GENERIC)).arrays
    assert (arrays["port"].range_max, arrays["starboard"].range_max) == (50.0, 30.0)
    assert arrays["port"].mount_rpy == (0.0, 0.0, 0.5) and arrays["starboard"].mount_rpy == (0.0, 0.0, 0.0)
    assert arrays["port"].mount_xyz == (0.0, 0.0, 0.0)  # the head itself, not the default of a vehicle


def test_an_array_moves_and_turns_with_its_head() -> None:
    """A point seen by the array lies where two rotations, one after the other, put it."""
    array = SonarArray(mount_xyz=(0.1, 0.2, 0.0), mount_rpy=(0.0, 0.0, 0.4))
    head = SonarHead("", (0.6, 0.0, -0.1), (0.05, 0.1, -0.2))
    point = cartesian(12.0, 1.4, 0.1)
    in_head = array.position_base + array.rotation_base_array @ point
    expected = np.array(head.mount_xyz) + matrix_from_rpy(np.array(head.mount_rpy)) @ in_head
    found = mounted(array, head)
    np.testing.assert_allclose(found.position_base + found.rotation_base_array @ point, expected, atol=1e-12)


def test_a_head_that_is_not_turned_leaves_the_mounts_as_the_file_has_them_to_the_last_bit() -> None:
    array = load_sonar("blueview_p900_45").arrays["sonar_left"]
    assert mounted(array, SonarHead("", (0.6, 0.0, 0.0))).mount_rpy == array.mount_rpy


def test_values_that_are_given_go_over_the_files() -> None:
    given = {"head.sonar": "blueview_p900_90", "arrays.sonar_left.range_max": 25.0, "gate": 0.9}
    values = with_sonar_file(given)
    assert values["arrays.sonar_left.range_max"] == 25.0 and values["arrays.sonar_right.range_max"] == 40.0
    assert values["gate"] == 0.9 and values["head.sonar"] == "blueview_p900_90"
    assert with_sonar_file(values) == values  # an effective configuration stays what it is


def test_without_a_sonar_file_nothing_is_added() -> None:
    given = {"arrays.sonar.range_max": 25.0, "head.mount_xyz": [1.0, 0.0, 0.0]}
    assert with_sonar_file(given) == given


def _changed(**changes: object) -> dict[str, Any]:
    array = GENERIC["array"] | {k: v for k, v in changes.items() if k in flatten(SonarArray())}
    return GENERIC | {"array": array} | {k: v for k, v in changes.items() if k not in array and k != "mount_rpy"}


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({k: v for k, v in GENERIC.items() if k != "frequency"}, r"frequency \[Hz\].*must be stated"),
        (GENERIC | {"arrays": {}}, "at least one"),
        (GENERIC | {"arrays": {"my sonar": {}}}, "a frame's name"),
        (GENERIC | {"array": {"range_max": 9.0}}, r"arrays.port: bearing_min \[rad\] is missing.*under 'array:'"),
        (GENERIC | {"arays": {"port": {"range_max": 9.0}}}, "did you mean 'arrays'"),
        (_changed(range_maxx=1.0) | {"array": GENERIC["array"] | {"range_maxx": 1.0}}, "range_maxx"),
        (_changed(bearing_min=45.0, bearing_max=135.0), r"\[rad\]"),
        (_changed(mount_rpy=[0.0, 0.0, 22.5]), "radians, not degrees"),
        (_changed(bearing_sigma=1.5), "wider than the field of view"),
        (_changed(ping_rate=25.0), r"comes back from 30.0 m at most"),
        (["a list"], "is a mapping, got list"),
        (GENERIC | {"arrays": {"port": 3}}, "group of parameters"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_the_remedy(tmp_path: Path, document: object, says: str) -> None:
    path = _write(tmp_path, document)
    with pytest.raises(ParameterError, match=says) as refused:
        load_sonar(path)
    assert str(path) in str(refused.value)


def test_an_unknown_sonar_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"no sonar 'p900'; there are .*blueview_p900_45"):
        load_sonar("p900")
    with pytest.raises(ParameterError, match="not a readable sonar file"):
        load_sonar(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("a: [1,")
    with pytest.raises(ParameterError, match="not readable as YAML"):
        load_sonar(tmp_path / "bad.yaml")
