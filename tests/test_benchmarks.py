"""The benchmarks measure what they say: the bank is as full as allowed."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def matching() -> ModuleType:
    path = Path(__file__).parents[1] / "benchmarks" / "matching.py"
    spec = importlib.util.spec_from_file_location("benchmarks_matching", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look for it there
    spec.loader.exec_module(module)
    return module


def test_updates_are_timed_with_as_many_hypotheses_alive_as_are_allowed(matching: ModuleType) -> None:
    for made, allowed in zip(matching.updates((12,), (1, 5)), (1, 5), strict=True):
        assert (made.features, made.allowed, made.alive) == (12, allowed, allowed)
        assert 0.0 < made.median <= made.worst
