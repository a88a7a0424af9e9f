"""``fbn params``: every parameter, its default, unit and origin."""

from __future__ import annotations

import json
from typing import Annotated

import typer

HELP = """List every parameter: default, unit, what it is, and where the number comes from.

Examples:

  fbn params  # all nodes
  fbn params tracking  # one node
  fbn params --match sigma  # names or descriptions with a word
  fbn params tracking --yaml > tracking.yaml  # a file to start from: edit it, then fbn replay --params tracking.yaml
"""


def params(
    node: Annotated[str, typer.Argument(help="A node, e.g. tracking; default: all.")] = "",
    match: Annotated[str, typer.Option(help="Only those with this word in name or description.")] = "",
    as_yaml: Annotated[bool, typer.Option("--yaml", help="As a ROS parameter file with comments.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    from fbn_bringup import catalogue, ui

    try:
        found = catalogue.parameters(node)
    except KeyError as error:
        ui.fail(str(error.args[0]), 2)
    word = match.lower()
    chosen = {n: [d for d in items if word in f"{d.name} {d.about}".lower()] for n, items in found.items()}
    if not any(chosen.values()):
        ui.fail(f"no parameter has {match!r} in its name or description")
    if as_json:
        typer.echo(json.dumps({n: [catalogue.plain(d) for d in items] for n, items in chosen.items()}, indent=2))
    elif as_yaml:
        typer.echo(catalogue.parameter_file(chosen), nl=False)
    else:
        _print(chosen)


def _print(chosen: dict[str, list]) -> None:  # type: ignore[type-arg]
    from fbn_bringup import ui

    for node, items in chosen.items():
        if items:
            table = ui.table(node, "name", "default", "unit", "what", "origin", left=5)
            table.columns[1].justify = "right"
            for d in items:
                table.add_row(
                    d.name,
                    ui.escape(str(d.default)),
                    ui.escape(d.unit),
                    ui.escape(d.about),
                    f"[dim]{ui.escape(d.origin)}[/]",
                )
            ui.out.print(table, "")
