"""The pages of the docs that are made from the code, and whether those on disk are current."""

from __future__ import annotations

from pathlib import Path

from fbn_bringup import catalogue
from fbn_bringup.dataflow import dataflow


def pages() -> dict[str, str]:
    """Every generated file, by its path under docs/."""
    return {
        "topics.md": catalogue.topic_page(),
        "parameters.md": catalogue.parameter_page(),
        "images/dataflow.svg": dataflow(),
    }


def stale(root: Path) -> list[str]:
    """The generated files whose content on disk is not current."""
    return [name for name, text in pages().items() if not (root / name).is_file() or (root / name).read_text() != text]


def write(root: Path) -> list[str]:
    """Write all of them; gives their paths under root."""
    made = pages()
    for name, text in made.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return list(made)
