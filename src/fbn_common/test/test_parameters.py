"""Parameters: names, types, units, and what an error tells the user."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from fbn_common.parameters import ParameterError, describe, flatten, group, load, param, read_yaml


@dataclass(frozen=True)
class Gate:
    sigma: float = param(3.0, "-", "gate", "99.7 %")


@dataclass(frozen=True)
class Example:
    rate: float = param(30.0, "Hz", "output rate", "design")
    mount: tuple[float, float, float] = param((0.0, 0.0, 0.0), "m", "mount", "drawing")
    name: str = param("ranger", "-", "vehicle", "-")
    datum: list[float] | None = param(None, "deg", "origin", "the first fix")
    gate: Gate = group(Gate)
    arrays: dict[str, Gate] = group(dict)

    def __post_init__(self) -> None:
        if self.rate <= 0:
            raise ParameterError(f"rate [Hz]: must be positive, got {self.rate}")


def test_defaults_stand_where_nothing_is_given() -> None:
    assert load(Example, {}) == Example()


def test_dotted_names_reach_groups_and_named_groups() -> None:
    loaded = load(Example, {"gate.sigma": 2, "arrays.left.sigma": 4.0, "arrays.right.sigma": 5.0})
    assert loaded.gate.sigma == 2.0
    assert {k: v.sigma for k, v in loaded.arrays.items()} == {"left": 4.0, "right": 5.0}


def test_flatten_and_load_are_inverse() -> None:
    example = load(Example, {"rate": 10.0, "mount": [1.0, 2.0, 3.0], "arrays.left.sigma": 4.0, "datum": [1.0, 2.0]})
    assert load(Example, flatten(example)) == example


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"rat": 1.0}, "did you mean 'rate'"),
        ({"gate.sgma": 1.0}, "did you mean 'gate.sigma'"),
        ({"rate": "fast"}, r"rate \[Hz\]: expected float"),
        ({"rate": float("nan")}, "not a number"),
        ({"rate": True}, "expected float"),
        ({"rate": -1.0}, "must be positive"),
        ({"mount": [1.0, 2.0]}, "expected 3 values, got 2"),
        ({"mount": 1.0}, "expected a list"),
        ({"gate": 1.0}, "group of parameters"),
    ],
)
def test_a_wrong_parameter_is_refused_with_its_name_and_the_remedy(values: dict[str, object], says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        load(Example, values)


def test_every_parameter_is_described_with_unit_and_origin() -> None:
    rows = {d.name: d for d in describe(Example)}
    assert set(rows) == {"rate", "mount", "name", "datum", "gate.sigma", "arrays.<name>.sigma"}
    assert (rows["rate"].unit, rows["rate"].default, rows["rate"].origin) == ("Hz", 30.0, "design")


def test_a_ros_parameter_file_gives_the_common_section_and_then_the_nodes(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n    rate: 5.0\n    name: a\n"
        "fbn_x:\n  ros__parameters:\n    rate: 7.0\n    gate:\n      sigma: 2.0\n"
    )
    assert read_yaml(path, "fbn_x") == {"rate": 7.0, "name": "a", "gate.sigma": 2.0}
    assert read_yaml(path, "fbn_y") == {"rate": 5.0, "name": "a"}


@pytest.mark.parametrize("text", ["[1, 2]", "fbn_x:\n  rate: 1.0\n", "a: [", "fbn_x: 3"])
def test_a_file_that_is_no_ros_parameter_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError):
        read_yaml(path, "fbn_x")
