"""How good dead reckoning, the reference filter and the estimated current are, over many simulated transits.

python -m fbn_testing.motion_study transit --seeds 0:50 --jobs 2 --keep transits
python -m fbn_testing.motion_study transit --seeds 0:50 --current 0.2 --compare --figure transit.png
python -m fbn_testing.motion_study transit --seeds 0:50 --without-considered
python -m fbn_testing.motion_study transit --seeds 0:50 --as-stated
python -m fbn_testing.motion_study faults

Only predict, dead reckoning and reference run, on ``no_map_transit``: four calibration dives, then 1.7 km under
water; ``--without-considered`` also runs them with the sensors' lasting errors taken for white noise; ``--as-stated``
makes compass, GPS and water as uncertain as the estimators' parameters say; ``faults`` spoils each sensor in each way
for 25 s of a short voyage.  ``--scenario`` and ``--set`` change the
simulator's and the estimators' parameters (as in ``fbn``'s ``--set``).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fbn_bringup.ui import number, out, progress, table
from fbn_common import chi_square
from fbn_testing.motion_faults import BEGIN_S, END_S, KINDS, SENSORS, Cell, cell, heard_with, listen, voyage
from fbn_testing.motion_voyage import NIS_GROUPS, Judged, front_half, in_map, judge, navigate, transit
from fbn_testing.motion_world import as_stated
from fbn_testing.seeds import How, add_options, run_seeds, seed_range

MEASURES = {
    "drift_percent": "dead reckoning's error [% of distance]",
    "reference_percent": "reference's error before surfacing [% of distance]",
    "yaw_deg": "dead reckoning's yaw, rms [deg]",
    "current_error": "current, error [m/s]",
    "current_sigma": "current, stated sigma [m/s]",
}
NEES = {  # name: title, degrees of freedom of a seed's sample (0: its samples are correlated, no band)
    "nees_ten_minutes": ("dead reckoning x, y, ten minutes into the dive", 2),
    "nees_drift_xy": ("dead reckoning x, y at the end", 2),
    "nees_reference_xy": ("reference x, y before surfacing", 2),
    "nees_current": ("current at the dive's start", 2),
    "nees_z": ("dead reckoning z", 0),
    "nees_tilt": ("dead reckoning roll, pitch", 0),
    "nees_yaw": ("dead reckoning yaw", 0),
}


AS_WHITE = {  # lasting errors of sensors and surface: none, and all that is stated is white
    f"{node}.{name}": value
    for node in ("deadreck", "reference")
    for name, value in {
        "compass.white": 1.0,
        "compass.deviation": 0.0,
        "compass.tilt": 0.0,
        "depth.white": 1.0,
        "depth.bias": 1e-3,
        "depth.density_sigma": 0.0,
        "surface.loss": 0.0,
        "surface.layer": 0.0,
    }.items()
}


def voyage_of(current: float, scenario: dict[str, Any], settings: dict[str, Any], shared: bool, seed: int) -> Judged:
    """One seed's transit, judged."""
    simulation = transit(current, seed, scenario)
    estimators = front_half(in_map(simulation.scenario.world.datum) | settings)
    return judge(simulation, navigate(estimators, simulation.records(), shared))


def report(title: str, found: list[Judged]) -> None:
    """Print errors with their spread, NEES with bands, and NIS."""
    reached = table(f"{title}: {len(found)} seeds", "measure", "median", "5 %", "95 %", "worst")
    for name, label in MEASURES.items():
        values = np.array([j.values[name] for j in found])
        cells = (*np.quantile(values, [0.5, 0.05, 0.95]), values.max())
        reached.add_row(label.replace("[", "\\["), *(number(float(v), 3) for v in cells))
    honest = table("NEES, NIS over their degrees of freedom", "of", "mean", "95 % band", "median", "worst")
    for name, (label, dof) in NEES.items():
        values = np.array([j.values[name] for j in found])
        honest.add_row(label, number(float(values.mean())), _band(dof * len(found)), *_two(values))
    for name in NIS_GROUPS:
        total, dof = sum(j.nis[name][0] for j in found), sum(j.nis[name][1] for j in found)
        honest.add_row(f"NIS {name}", number(total / dof if dof else None), _band(dof), "", "")
    out.print(reached)
    out.print(honest)


def _band(dof: int) -> str:
    """The 95 % band of a mean over so many independent degrees of freedom."""
    return "–".join(f"{edge:.2f}" for edge in chi_square.band(dof)) if dof else ""


def _two(values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[str, str]:
    return number(float(np.median(values))), number(float(values.max()))


def figure(path: Path, title: str, groups: dict[str, list[Judged]]) -> None:
    """Dead reckoning's error against distance, every seed and the median, one colour a group."""
    from matplotlib import pyplot as plt

    fig, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for colour, (label, found) in zip(("tab:blue", "tab:orange", "tab:green"), groups.items(), strict=False):
        grid = np.arange(0.0, min(j.distance[-1] for j in found), 5.0)
        lines = np.array([np.interp(grid, j.distance, j.drift) for j in found])
        axes.plot(grid, lines.T, color=colour, alpha=0.25, linewidth=0.8)
        axes.plot(grid, np.median(lines, axis=0), color=colour, linewidth=2.2, label=f"{label}, median")
    for percent in (2, 5):
        axes.plot(grid, percent / 100.0 * grid, color="0.5", linestyle=":", linewidth=1.0)
        axes.annotate(f"{percent} %", (grid[-1], percent / 100.0 * grid[-1]), color="0.4")
    axes.set(xlabel="distance under water [m]", ylabel="dead reckoning's error [m]", title=title)
    axes.set(xlim=(0.0, None), ylim=(0.0, None))
    axes.legend(frameon=False)
    fig.savefig(path, dpi=120)
    plt.close(fig)


def _transit(a: argparse.Namespace) -> None:
    seeds, scenario, settings = seed_range(a.seeds), assignments(a.scenario), assignments(a.set)
    where = "no_map_transit"
    if a.as_stated:
        scenario, where = as_stated(a.current) | scenario, "a world as stated"
    kinds: dict[str, tuple[dict[str, Any], bool]] = {"parameters shared": (settings, True)}
    if a.compare:
        kinds["not shared"] = (settings, False)
    if a.without_considered:
        kinds["lasting errors as white noise"] = (AS_WHITE | settings, True)
    groups = {}
    for label, (chosen, shared) in kinds.items():
        title = f"{where}, current {a.current:g} m/s, {label}"
        one = partial(voyage_of, a.current, scenario, chosen, shared)
        groups[label] = run_seeds(one, seeds, title, How(a.jobs, a.keep))
        report(title, groups[label])
    if a.figure:
        figure(a.figure, f"current {a.current:g} m/s, {len(seeds)} seeds", groups)


def _faults(a: argparse.Namespace) -> None:
    twin, entries = voyage(int(a.seed))
    chosen = [(topic, kind) for topic in SENSORS for kind in KINDS if a.only in (None, topic, kind)]
    logs = {topic: heard_with(entries, topic) for topic in SENSORS}
    good, rows = {len(log): listen(log) for log in logs.values()}, []
    with progress("faults") as advance:
        for i, (topic, kind) in enumerate(chosen):
            advance(i / len(chosen), f"{topic} {kind}")
            log = logs[topic]
            rows.append(cell(twin, log, good[len(log)], topic, kind))
    fault_report(rows)


def fault_report(rows: list[Cell]) -> None:
    """Print the table of faults."""
    about = f"a fault from {BEGIN_S:g} to {END_S:g} s; most that it moved the estimates"
    titles = ("named [s]", "by", "track [m]", "z [m]", "yaw [deg]", "map [m]", "used again [s]", "sigmas", "sound")
    shown = table(about, "sensor", "fault", *(t.replace("[", "\\[") for t in titles), left=2)
    for c in rows:
        moved = (number(v) for v in (c.drift, c.depth, float(np.degrees(c.yaw)), c.absolute))
        named, again = (number(v, 1) for v in (c.named_s, c.used_again_s))
        shown.add_row(
            c.sensor, c.kind, named, c.said[:24], *moved, again, number(c.worst, 1), "yes" if c.sound else "NO"
        )
    shown.caption = "sigmas: largest error of position at the end over its own standard deviation"
    out.print(shown)


def assignments(texts: Iterable[str]) -> dict[str, Any]:
    """``name=value`` texts, values as in YAML."""
    pairs = (text.partition("=") for text in texts)
    return {name: yaml.safe_load(value) for name, _, value in pairs}


def main() -> None:
    """Run one study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    studies = parser.add_subparsers(required=True)
    p = studies.add_parser("transit", help="errors and consistency over seeds")
    p.add_argument("--seeds", default="1000:1005", metavar="A:B", help="tune on 1000 and up, report below")
    p.add_argument("--current", type=float, default=0.0, metavar="M_S", help="mean speed of the deep current")
    p.add_argument("--compare", action="store_true", help="also without shared parameters")
    p.add_argument("--without-considered", action="store_true", help="also with lasting errors taken for white noise")
    p.add_argument("--as-stated", action="store_true", help="in a world as uncertain as the parameters say")
    p.add_argument("--figure", type=Path, metavar="PNG", help="error against distance")
    p.add_argument("--scenario", action="append", default=[], metavar="NAME=VALUE", help="of the simulator")
    p.add_argument("--set", action="append", default=[], metavar="NODE.NAME=VALUE", help="of an estimator")
    add_options(p)
    p.set_defaults(study=_transit)
    p = studies.add_parser("faults", help="each sensor with each fault")
    p.add_argument("--seed", default="3", help="of the voyage")
    p.add_argument("--only", metavar="TOPIC|KIND", help="one sensor's topic, or one kind of fault")
    p.set_defaults(study=_faults)
    arguments = parser.parse_args()
    arguments.study(arguments)


if __name__ == "__main__":
    main()
