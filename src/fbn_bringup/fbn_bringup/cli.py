"""The ``fbn`` command. Each sub-command is a module of :mod:`fbn_bringup.commands`, imported when it is called."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from fbn_bringup.commands import (
    campaign,
    check,
    demo,
    design,
    docs,
    evaluate,
    evaluate_gps,
    importing,
    params,
    replay,
    report,
    run,
    sim,
)

HELP = """Feature-based navigation for small AUVs: from sonar detections to "here on the map".

A first tour:

  fbn demo  # replay the sample log, evaluate it, write the report
  fbn check my_bag  # is this log good enough to navigate by?
  fbn replay my_bag -o my_run --map map.geojson
  fbn evaluate my_run  # errors, consistency, matches
  fbn report my_run  # one HTML file with all pictures

Every command explains itself with examples: fbn replay --help. Completion for your shell: fbn --install-completion.
"""


def reflowed(text: str) -> str:
    """Help as the terminal shall wrap it: each paragraph a line, each indented example a line of its own."""
    paragraphs = text.strip().split("\n\n")
    return "\n\n".join(p.replace("\n", "\n\n") if p.startswith("  ") else p.replace("\n", " ") for p in paragraphs)


app = typer.Typer(
    help=reflowed(HELP), no_args_is_help=True, rich_markup_mode="rich", pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip

app.command("demo", rich_help_panel="Start here", help=reflowed(demo.HELP))(demo.demo)
app.command("check", rich_help_panel="Start here", help=reflowed(check.HELP))(check.check)
app.add_typer(importing.app, name="import", rich_help_panel="Start here", help=importing.HELP)
app.command("replay", rich_help_panel="Navigate", help=reflowed(replay.HELP))(replay.replay)
app.command("run", rich_help_panel="Navigate", help=reflowed(run.HELP))(run.run)
app.command("evaluate", rich_help_panel="Examine", help=reflowed(evaluate.HELP))(evaluate.evaluate)
app.command("evaluate-gps", rich_help_panel="Examine", help=reflowed(evaluate_gps.HELP))(evaluate_gps.evaluate_gps)
app.command("report", rich_help_panel="Examine", help=reflowed(report.HELP))(report.report)
app.command("params", rich_help_panel="Examine", help=reflowed(params.HELP))(params.params)
app.command("design", rich_help_panel="Start here", help=reflowed(design.HELP))(design.design)
app.command("sim", rich_help_panel="Simulate", help=reflowed(sim.HELP))(sim.sim)
app.command("campaign", rich_help_panel="Simulate", help=reflowed(campaign.HELP))(campaign.campaign)
app.command("docs", rich_help_panel="For developers", help=reflowed(docs.HELP))(docs.docs)


@app.callback(invoke_without_command=True)
def entry(version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False) -> None:
    if version:
        from importlib.metadata import PackageNotFoundError
        from importlib.metadata import version as installed

        try:
            typer.echo(f"fbn {installed('fbn_bringup')}")
        except PackageNotFoundError:
            typer.echo("fbn (from source)")
        raise typer.Exit


def main() -> None:
    """Run the command line; errors of ours end with one clear line and status 1, defects with a traceback."""
    from fbn_bringup import ui

    try:
        app(prog_name="fbn")
    except KeyboardInterrupt:
        ui.err.print("stopped")
        sys.exit(130)
    except Exception as error:
        text = ui.known_error(error)
        if text is None:
            raise
        ui.err.print(f"[bold red]error:[/] {ui.escape(text)}", soft_wrap=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
