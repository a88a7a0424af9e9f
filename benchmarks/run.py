"""All benchmarks, side by side in one run: ``make bench``. Ratios carry over to other machines, seconds do not."""

from __future__ import annotations

import sys

import numpy as np
from graph import calibration, graph_speed
from matching import contests as jcbb_contests
from matching import updates
from motion import front_half_speed
from motion_kernels import contests
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from simulator import real_time_factor
from tracking import SHORT_S, speed

console = Console(highlight=False)


def table(title: str, *columns: str) -> Table:
    """A table, words to the left and numbers to the right."""
    made = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for i, column in enumerate(columns):
        made.add_column(escape(column), justify="right" if i else "left")
    return made


def kernels() -> Table:
    """EKF kernels against filterpy."""
    columns = ("what", "states", "ours [us]", "called alone [us]", "filterpy [us]", "ratio")
    made = table("EKF kernels beside filterpy's EKF of the same size", *columns)
    made.caption = "the filters answer attitude (3 degrees of freedom) and depth (1) apart; filterpy does all 4 at once"
    for c in contests():
        times = (f"{t:.1f}" for t in (c.ours, c.alone, c.filterpy))
        made.add_row(c.what, str(c.states), *times, f"{c.ratio:.2f}")
    return made


def front_half() -> Table:
    """Predict and both filters on a long mission without sonar."""
    loads, answers = front_half_speed()
    made = table(f"Front half on 25 minutes, {answers} measurements answered", "node", "CPU [s]", "times real time")
    for load in loads:
        made.add_row(load.node, f"{load.cpu_s:.2f}", f"{load.factor:.0f}")
    total = sum(load.cpu_s for load in loads)
    made.add_row("all three", f"{total:.2f}", f"{loads[0].cpu_s * loads[0].factor / total:.0f}")
    return made


def graph() -> tuple[Table, Table]:
    """The estimators, and the tracker's pings."""
    speeds, pings = graph_speed()
    made = table("Estimators on a mission, one process", "node", "CPU [s]", "times real time")
    for s in speeds:
        made.add_row(s.node, f"{s.cpu_s:.2f}", f"{s.factor:.0f}")
    total = sum(s.cpu_s for s in speeds)
    made.add_row("all five", f"{total:.2f}", f"{speeds[0].cpu_s * speeds[0].factor / total:.0f}")
    ms = table("Tracker, per ping", "", "median [ms]", "95 % [ms]", "worst [ms]")
    ms.add_row(f"{len(pings)} pings", *(f"{1e3 * np.quantile(pings, q):.1f}" for q in (0.5, 0.95, 1.0)))
    return made, ms


def matching() -> tuple[Table, Table]:
    """The global filter's updates by size of the map and number of hypotheses, and JCBB beside a plain one."""
    made = table("Global filter, per update", "features on the map", "hypotheses", "median [s]", "worst [s]")
    for u in updates():
        made.add_row(str(u.features), str(u.alive), f"{u.median:.3f}", f"{u.worst:.3f}")
    beside = table(
        "JCBB of ten found features beside a plain one",
        "features on the map",
        "pose sigma [m]",
        "nodes",
        "ours [ms]",
        "plain",
    )
    for c in jcbb_contests():
        beside.add_row(str(c.features), f"{c.sigma:.0f}", str(c.nodes), f"{1e3 * c.ours:.3f}", f"{c.ratio:.0f} times")
    return made, beside


def tracker() -> tuple[Table, Table]:
    """The tracker beside gtsam's fixed-lag smoother, on the first part of a mission."""
    return speed(2.0, 1, SHORT_S), speed(4.0, 2, SHORT_S)


def simulator() -> Table:
    """The simulator."""
    made = table("Simulator", "scenario", "times real time")
    made.add_row("charles_river_2006", f"{real_time_factor('charles_river_2006'):.0f}")
    return made


def main() -> int:
    """Print every table."""
    loop = calibration()
    for made in (kernels(), front_half(), *graph(), *tracker(), *matching(), simulator()):
        console.print(made, "")
    console.print(f"[dim]a fixed Python loop took {loop * 1e3:.0f} ms before and {calibration() * 1e3:.0f} ms after")
    return 0


if __name__ == "__main__":
    sys.exit(main())
