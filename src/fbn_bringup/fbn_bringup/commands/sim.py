"""``fbn sim``: a scenario becomes a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HELP = """Simulate a scenario into a bag, with its prior map and truth beside it.

The simulator has effects that no estimator models: quadratic drag, actuator lag, compass deviation, correlated GPS
errors, clutter. The same seed gives the same bag.

Examples:

  fbn sim  # list the scenarios
  fbn sim charles_river_2006 -o bags/river --seed 7
  fbn sim my_scenario.yaml
"""


def sim(
    scenario: Annotated[str, typer.Argument(help="A name from the list, or a scenario file.")] = "",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="BAG", help="Default: out/SCENARIO_SEED.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all randomness; default: the scenario's own.")] = None,
) -> None:
    from fbn_bringup import simulation, ui

    if not scenario:
        _list()
        return
    target = output or Path("out") / f"{Path(scenario).stem}_{'default' if seed is None else seed}"
    with ui.progress(f"simulating {scenario}") as advance:
        written = simulation.simulate_to_bag(scenario, target, seed, advance)
    ui.out.print(f"bag written to [bold]{written}[/]; next: fbn replay {written}", soft_wrap=True)


def _list() -> None:
    from fbn_bringup import simulation, ui

    table = ui.table("Scenarios", "name", "what", left=2)
    for name, about in simulation.scenarios().items():
        table.add_row(name, about)
    ui.out.print(table)
