"""``fbn evaluate-gps``: how well position holds when GPS is taken away."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fbn_bringup.commands import options as o

if TYPE_CHECKING:
    from rich.table import Table

    from fbn_bringup.evaluation.withheld import Withheld

HELP = """Withhold GPS after the first part of each log and say how far the estimate is from it then.

For logs with GPS throughout, i.e. surface runs: the only truth that most recorded logs have. The motion filters run
twice, with the water estimated and with still water. docs/concepts.md defines each number.

Examples:

  fbn evaluate-gps bags/mission_1 bags/mission_2 -p iver2

  fbn evaluate-gps bags/mission_1 -p iver2 --withhold-after 0.25 --json
"""


def evaluate_gps(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Logs with GPS throughout.")],
    params: o.Params = None,
    settings: o.Set = None,
    namespace: o.Namespace = "",
    withhold_after: Annotated[float, typer.Option(min=0.01, max=0.99, help="Share of the time with GPS.")] = 0.4,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    import json

    from fbn_bringup import ui
    from fbn_bringup.evaluation.withheld import NODES, STILL_WATER, withhold
    from fbn_common.graph import GRAPH
    from fbn_ros.bag import BagReader

    overrides = o.overrides(settings, None)
    rows: list[tuple[str, Withheld, Withheld]] = []
    with ui.progress(f"{len(bags)} logs, GPS withheld after {100 * withhold_after:.0f} %") as advance:
        for i, bag in enumerate(bags):
            advance(i / len(bags), bag.name)
            with BagReader(bag, namespace.strip("/")) as reader:
                log = list(reader.records(GRAPH.only(NODES).external_inputs()))
            files = o.parameter_files(params)
            still = withhold(log, files, {**overrides, **STILL_WATER}, withhold_after)
            rows.append((bag.name, still, withhold(log, files, overrides, withhold_after)))
    if as_json:
        typer.echo(json.dumps([_plain(*row) for row in rows], indent=1))
        return
    ui.out.print(_table(rows), "")


def _plain(name: str, still: Withheld, moving: Withheld) -> dict[str, object]:
    """One log's row as plain values."""

    def numbers(w: Withheld) -> dict[str, float]:
        return {
            "final_m": w.final,
            "final_percent": w.final_percent,
            "mean_percent": w.mean_percent,
            "nees_mean": float(w.nees.mean()),
            "nees_final": float(w.nees[-1]),
        }

    common = {"log": name, "seconds": moving.seconds, "distance_m": moving.distance, "water_m_s": moving.water.tolist()}
    return {**common, "still_water": numbers(still), "water_estimated": numbers(moving)}


def _table(rows: list[tuple[str, Withheld, Withheld]]) -> Table:
    """One line a log, and the median of all."""
    import numpy as np

    from fbn_bringup import ui

    names = (
        "log",
        "without GPS",
        "way",
        "still water",
        "",
        "NEES",
        "water estimated",
        "",
        "mean",
        "NEES",
        "water E, N",
    )
    table = ui.table("error of position at the end of the part without GPS", *names)
    for name, still, w in rows:
        consistency = [ui.number(float(x.nees.mean()), 1) for x in (still, w)]
        table.add_row(
            name, f"{w.seconds:.0f} s", f"{w.distance:.0f} m",
            f"{still.final:.1f} m", f"{still.final_percent:.1f} %", consistency[0],
            f"{w.final:.1f} m", f"{w.final_percent:.1f} %", f"{w.mean_percent:.1f} %", consistency[1],
            f"{w.water[0]:+.2f}, {w.water[1]:+.2f} m/s",
        )  # fmt: skip
    if len(rows) > 1:
        percent = np.array([[s.final_percent, w.final_percent, w.mean_percent] for _, s, w in rows])
        still_m, moving_m, mean_m = (f"{m:.1f} %" for m in np.median(percent, axis=0))
        table.add_row("median", "", "", "", still_m, "", "", moving_m, mean_m, "", "")
    return table
