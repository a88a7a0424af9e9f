"""``fbn docs``: the pages of the docs that are made from the code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HELP = """Make the generated pages of the docs anew: topics, parameters, the data-flow figure.

Examples:

  fbn docs
  fbn docs --check  # change nothing; status 1 if a page is not current
"""


def docs(
    directory: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: the project's docs.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Only say which pages are not current.")] = False,
) -> None:
    from fbn_bringup import pages, ui
    from fbn_bringup.simulation import project_root

    root = directory or (project_root() or Path.cwd()) / "docs"
    stale = pages.stale(root)
    if check:
        if stale:
            ui.fail(f"not current: {', '.join(stale)}; run: fbn docs")
        return
    for name in pages.write(root):
        ui.out.print(f"{root / name}{' (changed)' if name in stale else ''}")
