"""``fbn report``: a run in pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HELP = """Write a run's report: one self-contained HTML file with layers that can be switched, and PNGs for papers.

Track over prior and estimated map, errors with 3-sigma bounds, innovations per sensor, matches, depth profile, rates
and latencies, health, parameters. The file opens without a network.

Examples:

  fbn report out/charles_river_2006  # writes out/charles_river_2006/report/
  fbn report out/charles_river_2006 -o /tmp/r --no-png
"""


def report(
    run: Annotated[Path, typer.Argument(help="A run directory, or a bag with the nodes' output.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: RUN/report.")] = None,
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Default: truth.yaml beside the run or its log.")
    ] = None,
    png: Annotated[bool, typer.Option("--png/--no-png", help="PNGs beside the HTML.")] = True,
) -> None:
    from fbn_bringup import ui
    from fbn_bringup.evaluation.load import load_run
    from fbn_bringup.report.write import write_report

    with ui.progress(f"reading {run.name}") as advance:
        loaded = load_run(run, truth, advance)
    with ui.progress("drawing") as advance:
        page = write_report(loaded, output or run / "report", png=png, advance=advance)
    ui.out.print(f"report: [bold]{page}[/]", soft_wrap=True)
