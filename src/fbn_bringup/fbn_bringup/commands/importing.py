"""``fbn import``: from other systems' logs to ours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fbn_bringup.importing.importer import Report

HELP = "Turn other systems' logs into bags that can be replayed."
app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich")

CSV_HELP = """Turn column logs (csv) into a bag, by a mapping file.

The mapping says which columns, in which units and conventions, become which topics, and which readings are valid.
Every row and reading that was left out is counted with its reason. docs/howto/bring-your-own-log.md explains it.

Examples:

  fbn import csv mission.csv --mapping iver2 -o bags/mission
  fbn import csv part1.csv part2.csv --mapping my_vehicle.yaml -o bags/mission
  fbn import csv mission.csv --mapping my_vehicle.yaml --dry-run  # only the account
"""


@app.command("csv", help=CSV_HELP)
def from_csv(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Column logs; together they make one bag.")],
    mapping: Annotated[
        str, typer.Option(metavar="FILE", help="Mapping file, or the name of one that comes along (iver2).")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="BAG", help="Default: beside the first file.")
    ] = None,
    where: Annotated[
        list[str] | None, typer.Option(metavar="COLUMN=NUMBER", help="Only such rows; may be repeated.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Write nothing.")] = False,
) -> None:
    from fbn_bringup import ui
    from fbn_bringup.importing.importer import import_logs, import_to_bag
    from fbn_bringup.importing.mapping import read_mapping, restrict
    from fbn_bringup.shipped import config_file

    chosen = restrict(read_mapping(config_file(mapping, "import")), where or ())
    target = output or files[0].with_suffix("")
    report = import_logs(files, chosen)[1] if dry_run else import_to_bag(files, chosen, target)
    show(report)
    if not dry_run:
        ui.out.print(f"bag: [bold]{target}[/]")


@app.command("keys", help="List every key of a mapping file, with unit and meaning.")
def keys() -> None:
    from fbn_bringup import ui
    from fbn_bringup.importing.mapping import Mapping
    from fbn_common.parameters import describe

    table = ui.table("keys of a mapping file", "key", "default", "unit", "what", left=4)
    for d in describe(Mapping):
        table.add_row(d.name, str(d.default), d.unit, d.about)
    ui.out.print(table)


def show(report: Report) -> None:
    """Print the account of an import."""
    from rich.markup import escape

    from fbn_bringup import ui
    from fbn_bringup.importing.clock import describe

    files = ui.table("files", "file", "from", "rows", "used", "left out, and what to know", left=2)
    for f in report.files:
        words = [f"{reason}: {len(x)} (line {x[0]}{' ...' if len(x) > 1 else ''})" for reason, x in f.dropped.items()]
        words += [f"gap of {length:.0f} s (line {line})" for line, length in f.gaps]
        words += [f"{reason}: {count}" for reason, count in f.notes.items()]
        files.add_row(f.path.name, describe(f.start_ns), str(f.rows), str(f.used), escape("; ".join(words) or "–"))
    sensors = ui.table("messages", "topic", "written", "left out", "what to know")
    for name, s in report.sensors.items():
        texts = ("; ".join(f"{reason}: {n}" for reason, n in counts.items()) for counts in (s.refused, s.notes))
        sensors.add_row(name, str(s.written), *(escape(t) or "–" for t in texts))
    ui.out.print(files, "", sensors, "")
