"""``fbn demo``: from the sample log to "here on the map", and a report with pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HELP = """Replay the sample log through the five nodes over DDS, evaluate it, and write the report.

Examples:

  fbn demo
  fbn demo --offline  # without DDS, in one process
  fbn demo --seed 7  # another mission: simulated first, so that nothing is tuned to one log
"""

BAG = "bags/charles_river_2006"


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="RUN")] = Path("out/demo"),
    offline: Annotated[bool, typer.Option("--offline", help="In one process, without DDS.")] = False,
    seed: Annotated[int | None, typer.Option(help="Simulate this seed instead of the sample log.")] = None,
) -> None:
    from fbn_bringup import ui
    from fbn_bringup.commands.options import replay_options
    from fbn_bringup.commands.replay import clear, run_replay
    from fbn_bringup.evaluation import tables
    from fbn_bringup.evaluation.evaluate import evaluate
    from fbn_bringup.evaluation.load import load_run
    from fbn_bringup.report.write import write_report

    bag = sample_log() if seed is None else simulated_log(output.with_name(f"{output.name}_log_{seed}"), seed)
    clear(output)
    run_replay(bag, output, replay_options(bag, None, None, None, "", ""), offline=offline)
    with ui.progress("reading the run") as advance:
        run = load_run(output, None, advance)
    result = evaluate(run)
    (output / "evaluation.json").write_text(tables.as_json(result))
    with ui.progress("drawing") as advance:
        page = write_report(run, output / "report", png=True, advance=advance, result=result)
    for table in tables.demo_tables(result, run):
        ui.out.print(table, "")
    ui.out.print(f"report: [bold]{page}[/]", soft_wrap=True)


def simulated_log(target: Path, seed: int) -> Path:
    """The same scenario of another seed; made once."""
    from fbn_bringup import simulation, ui

    if not (target / "truth.yaml").is_file():
        with ui.progress(f"simulating seed {seed}") as advance:
            simulation.simulate_to_bag(Path(BAG).name, target, seed, advance)
    return target


def sample_log() -> Path:
    """The sample log, from the working directory or the source tree."""
    from fbn_bringup import ui
    from fbn_bringup.simulation import project_root

    for root in (Path.cwd(), project_root()):
        if root is not None and (root / BAG).is_dir():
            return root / BAG
    remedy = f"run this in the project's directory, or make the log: fbn sim charles_river_2006 -o {BAG}"
    return ui.fail(f"{BAG} is not here; {remedy}")
