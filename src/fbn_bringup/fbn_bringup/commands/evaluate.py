"""``fbn evaluate``: how good a run was."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HELP = """Say how good a run was: against truth where there is one, otherwise by its inner consistency.

With truth: per dive, dead reckoning's error in % of distance, matched or not (and rightly), error on the map; NEES.
Always: every sensor's verdicts and NIS, and GPS against dead reckoning at each surfacing. Writes evaluation.json
into the run's directory. docs/concepts.md defines each number.

Examples:

  fbn evaluate out/charles_river_2006
  fbn evaluate out/charles_river_2006 --json > numbers.json
  fbn evaluate my_recorded_bag  # a bag recorded on the vehicle works too
"""


def evaluate(
    run: Annotated[Path, typer.Argument(help="A run directory, or a bag with the nodes' output.")],
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Default: truth.yaml beside the run or its log.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    from fbn_bringup import ui
    from fbn_bringup.evaluation import tables
    from fbn_bringup.evaluation.evaluate import evaluate as measure
    from fbn_bringup.evaluation.load import load_run

    with ui.progress(f"reading {run.name}") as advance:
        loaded = load_run(run, truth, advance)
    result = measure(loaded)
    text = tables.as_json(result)
    if run.is_dir():
        (run / "evaluation.json").write_text(text)
    if as_json:
        typer.echo(text)
        return
    for table in tables.all_tables(result, loaded):
        ui.out.print(table, "")
