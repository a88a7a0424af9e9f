"""``fbn check``: is this log good enough?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HELP = """Is this log good enough to navigate by?

Looks at topics, rates, gaps, stamps and values (units and frames that look wrong), and says what the estimators will
do without what is missing. Exit status: 0 it can navigate, 1 it cannot.

Examples:

  fbn check my_bag
  fbn check my_bag --namespace ranger
  fbn check my_bag --json | jq .findings
"""


def check(
    bag: Annotated[Path, typer.Argument(help="A rosbag2 directory.")],
    namespace: Annotated[str, typer.Option(metavar="NAME", help="Prefix of the topics, e.g. ranger.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    from fbn_bringup import ui
    from fbn_bringup.check import log, words

    with ui.progress(f"reading {bag.name}") as advance:
        verdict = log.check_bag(bag, namespace.strip("/"), advance)
    if as_json:
        typer.echo(words.as_json(verdict))
    else:
        for part in words.tables(verdict):
            ui.out.print(part, "")
    raise typer.Exit(0 if verdict.can_navigate else 1)
