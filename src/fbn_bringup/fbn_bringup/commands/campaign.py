"""``fbn campaign``: one scenario over many seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fbn_bringup.commands import options as o

HELP = """Simulate, navigate and evaluate a scenario over many seeds, in parallel processes.

A claim is over many seeds, with its spread and its worst, never one lucky run. Writes one row per seed to CSV, the
summary to JSON, and how reliable the stated posteriors were as a figure (reliability.png). A seed that fails is a row
with its error, and the exit status is 1.

Each row is kept when its seed ends: the same command again goes on where it stopped, and tries failed seeds again. Rows
of other settings, files or code are not mixed in: choose another directory, or --fresh.

Examples:

  fbn campaign charles_river_2006 --seeds 0:20
  fbn campaign row_ambiguity --seeds 0:100 --set global.method=JCBB -o out/jcbb
"""


def campaign(
    scenario: Annotated[str, typer.Argument(help="A scenario's name or file.")],
    seeds: Annotated[str, typer.Option(metavar="A:B", help="From A up to, not including, B.")] = "0:20",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: out/campaign_SCENARIO.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; default: one per core.")] = None,
    params: o.Params = None,
    settings: o.Set = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Forget the rows that are there already.")] = False,
) -> None:
    from fbn_bringup import campaign as c
    from fbn_bringup import campaign_journal as kept
    from fbn_bringup import ui

    numbers = _range(seeds)
    plan = c.Plan(scenario, o.parameter_files(params), tuple(settings or ()))
    target = output or Path("out") / f"campaign_{Path(scenario).stem}"
    if fresh:
        (target / "rows.jsonl").unlink(missing_ok=True)
    journal = kept.Journal(target, plan)
    before = len(journal.rows().keys() & set(numbers))
    if before:
        ui.err.print(f"{before} of {len(numbers)} seeds are there already")
    with ui.progress(f"{scenario}: {len(numbers)} seeds") as advance:
        rows = c.run_campaign(
            plan, numbers, jobs, lambda done: advance(done / len(numbers), f"{done} of {len(numbers)}"), journal
        )
    written = kept.write(target, plan, rows)
    for table in c.summary_tables(plan, rows):
        ui.out.print(table, "")
    for row in rows:
        if row.error:
            ui.err.print(f"[red]seed {row.seed}:[/] {ui.escape(row.error)}")
    ui.out.print(f"rows: [bold]{written}[/]", soft_wrap=True)
    raise typer.Exit(1 if any(row.error for row in rows) else 0)


def _range(seeds: str) -> range:
    from fbn_bringup.ui import fail

    first, colon, last = seeds.partition(":")
    try:
        found = range(int(first), int(last) if colon else int(first) + 1)
    except ValueError:
        fail(f"--seeds {seeds!r}: expected A:B, e.g. 0:20", 2)
    return found or fail(f"--seeds {seeds!r}: is empty; A must be less than B", 2)
