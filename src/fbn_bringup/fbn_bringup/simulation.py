"""Scenarios of the simulator, by name or file, written to bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

Advance = Callable[[float, str], None]


def project_root() -> Path | None:
    """The source tree this runs from (the directory with bags/ or src/); None when installed elsewhere."""
    for parent in Path(__file__).resolve().parents:
        if (parent / "Makefile").is_file() and (parent / "src").is_dir():
            return parent
    return None
