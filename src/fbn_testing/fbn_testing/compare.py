"""Where two records, or two logs, differ: by decoded values, to the last bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from fbn_ros.bag import BagReader, Logged


def difference(a: Any, b: Any, path: str = "") -> str:
    """The first difference, as text; "" if there is none.  NaN equals NaN."""
    if type(a) is not type(b):
        return f"{path}: {type(a).__name__} and {type(b).__name__}"
    if isinstance(a, np.ndarray):
        if a.shape != b.shape:
            return f"{path}: shapes {a.shape} and {b.shape}"
        return "" if np.array_equal(a, b, equal_nan=True) else f"{path}: by up to {np.nanmax(np.abs(a - b)):.3g}"
    if dataclasses.is_dataclass(a):
        parts = (difference(getattr(a, f.name), getattr(b, f.name), f"{path}.{f.name}") for f in dataclasses.fields(a))
        return next(filter(None, parts), "")
    if isinstance(a, tuple):
        if len(a) != len(b):
            return f"{path}: {len(a)} and {len(b)} items"
        return next(
            filter(None, (difference(x, y, f"{path}[{i}]") for i, (x, y) in enumerate(zip(a, b, strict=True)))), ""
        )
    if isinstance(a, Exception):
        a, b = str(a), str(b)
    return "" if a == b or (a != a and b != b) else f"{path}: {a} and {b}"


def first_difference(a: Iterable[Any], b: Iterable[Any]) -> str:
    """The first difference of two logs of (log time, topic, record)."""
    for i, (x, y) in enumerate(zip_longest(a, b)):
        if x is None or y is None:
            return f"message {i}: only one has {x or y}"
        if tuple(x[:2]) != tuple(y[:2]):
            return f"message {i}: {tuple(x[:2])} and {tuple(y[:2])}"
        if found := difference(x[2], y[2], x[1]):
            return f"message {i} at {x[0]}: {found}"
    return ""


def read_log(bag: Path) -> list[Logged]:
    """All known messages of a bag."""
    with BagReader(bag) as reader:
        return list(reader.entries())
