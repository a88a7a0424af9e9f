"""A valid record of any type, filled with random numbers."""

from __future__ import annotations

import dataclasses
import typing
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np

from fbn_common import records as r
from fbn_common.types import Array

T = TypeVar("T")

RECORD_TYPES = tuple(
    kind for kind in vars(r).values() if isinstance(kind, type) and issubclass(kind, r.Record) and kind.ros_type
)


def example(kind: type[T], rng: np.random.Generator, items: int = 2) -> T:
    """A record of this type that passes every check; sequences have so many items.

    Numbers are multiples of 1/64, which single precision holds, so that they come back from any message as they were.
    """
    hints = typing.get_type_hints(kind)
    values = {f.name: _value(f, hints[f.name], rng, items) for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return _consistent(kind(**values), rng, items)


def _value(field: dataclasses.Field[Any], hint: Any, rng: np.random.Generator, items: int) -> Any:
    shape = field.metadata.get("shape")
    if field.name in ("orientation", "attitude_start"):
        return unit_quaternion(rng)
    if shape is not None:
        return _array(field.name, tuple(items if n == -1 else n for n in shape), rng)
    if field.name.endswith("_ns"):
        return int(rng.integers(0, 2_000_000_000)) * 1_000_000_000 + int(rng.integers(0, 1_000_000_000))
    return _scalar(hint, rng, items)


def _scalar(hint: Any, rng: np.random.Generator, items: int) -> Any:
    if typing.get_origin(hint) is tuple:
        item = typing.get_args(hint)[0]
        return tuple(_scalar(item, rng, items) for _ in range(items))
    if dataclasses.is_dataclass(hint):
        return example(typing.cast(type[Any], hint), rng, items)
    if hint is bool:
        return bool(rng.integers(2))
    if hint is str:
        return "grün" + str(rng.integers(100))
    if issubclass(hint, IntEnum):
        return list(hint)[rng.integers(len(hint))]
    return int(rng.integers(0, 100)) if hint is int else float(rng.integers(0, 1000) / 64)


def _array(name: str, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    if len(shape) == 2 and shape[0] == shape[1]:
        return np.diag(rng.integers(1, 100, shape[0]) / 64)
    if name.endswith("covariance") and len(shape) == 2:  # (n, m): with others, then among themselves
        n, m = shape
        return np.hstack((_array("", (n, m - n), rng), _array(name, (n, n), rng)))
    return rng.integers(-1000, 1000, shape) / 64


def _consistent(record: Any, rng: np.random.Generator, items: int) -> Any:
    """Sizes that depend on one another, made to fit."""
    match record:
        case r.CompositeMeasurement():
            n = 13 + 3 * len(record.features)
            mean, covariance = _array("mean", (n,), rng), _array("covariance", (n, n), rng)
            return dataclasses.replace(record, mean=mean, covariance=covariance)
        case r.SweptArea():
            return dataclasses.replace(record, scans=_array("scans", (record.width * record.height,), rng))
        case r.FeatureMap():
            n = 3 * len(record.features)
            return dataclasses.replace(record, covariance=_array("covariance", (n, n), rng))
        case _:
            return record


def unit_quaternion(rng: np.random.Generator) -> Array:
    """A random rotation."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)
