"""``fbn replay``: a log through the nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fbn_bringup.commands import options as o

HELP = """Replay a log through the nodes, and record what they say.

The run directory holds a bag (inputs, everything between, results) and run.yaml. By default the real nodes run as
processes over DDS, in lock step with the log: nothing is lost, and it goes as fast as they can.

Examples:

  fbn replay bags/charles_river_2006 -o out/river
  fbn replay my_bag --offline  # one process, no DDS, fastest, the same answer
  fbn replay my_bag --rate 1  # paced by time, as on the vehicle
  fbn replay out/river/bag --only tracking,global --set global.method=JCBB -o out/again
"""


def replay(
    bag: Annotated[Path, typer.Argument(help="A rosbag2 directory (mcap or sqlite3).")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="RUN", help="Default: out/<name of the bag>.")
    ] = None,
    rate: Annotated[float | None, typer.Option(help="Times real time instead of lock step.", min=0.01)] = None,
    offline: Annotated[bool, typer.Option("--offline", help="In one process, without DDS.")] = False,
    only: o.Only = "",
    params: o.Params = None,
    settings: o.Set = None,
    prior_map: o.Map = None,
    namespace: o.Namespace = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a run that is there.")] = False,
) -> None:
    from fbn_bringup import ui

    if offline and rate is not None:
        ui.fail("--offline has no clock, so it takes no --rate; leave one of them out", 2)
    chosen = o.replay_options(bag, params, settings, prior_map, namespace, only)
    target = output or Path("out") / bag.resolve().name
    if overwrite:
        clear(target)
    run_replay(bag, target, chosen, offline=offline, rate=rate)
    ui.out.print(f"run written to [bold]{target}[/]; next: fbn evaluate {target}", soft_wrap=True)


def run_replay(bag: Path, target: Path, chosen: object, *, offline: bool, rate: float | None = None) -> object:
    """Replay with a progress bar; what the runners raise says what to do."""
    from typing import cast

    from fbn_bringup import ui
    from fbn_bringup.rundir import Progress, ReplayOptions

    with ui.progress(f"replaying {bag.name}") as advance:

        def on_progress(p: Progress) -> None:
            advance(p.fraction, f"{p.log_s:.0f} of {p.total_s:.0f} s, {p.speed:.1f}x real time  {p.text}")

        wanted = cast(ReplayOptions, chosen)
        if offline:
            from fbn_bringup.offline import replay_offline

            return replay_offline(bag, target, wanted, on_progress)
        from fbn_bringup.replay import replay_nodes

        return replay_nodes(bag, target, wanted, on_progress, rate=rate)


def clear(target: Path) -> None:
    """Remove what an earlier run left in a directory, and nothing else."""
    import shutil

    if not (target / "run.yaml").is_file() and not (target / "bag" / "metadata.yaml").is_file():
        return
    for name in ("bag", "report"):
        shutil.rmtree(target / name, ignore_errors=True)
    for name in ("run.yaml", "evaluation.json"):
        (target / name).unlink(missing_ok=True)
