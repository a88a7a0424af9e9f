"""One scenario over many seeds: simulate, navigate in one process, evaluate; in parallel, nothing but numbers kept."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from fbn_bringup.evaluation.calibration import Stated, bins, expected_error
from fbn_bringup.evaluation.evaluate import Evaluation, evaluate
from fbn_bringup.evaluation.run import NOT_KEPT, Item, Run, collect
from fbn_bringup.ui import number, table
from fbn_common import chi_square
from fbn_common.records import Record

if TYPE_CHECKING:
    from fbn_bringup.campaign_journal import Journal


@dataclass(frozen=True, slots=True)
class Plan:
    """What every seed has in common."""

    scenario: str
    parameter_files: tuple[Path, ...] = ()
    settings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Row:
    """One seed's numbers; an error says why there are none."""

    seed: int
    values: dict[str, float | None]
    wall_s: float
    error: str = ""
    stated: Stated = ()  # posteriors of the vehicle's place on the map, and whether it was the right one


MEASURES: dict[str, tuple[str, int, bool]] = {  # name: (unit, digits, is more worse)
    "dives": ("", 0, False),
    "dives_matched": ("", 0, False),
    "false_matches": ("", 0, True),
    "wrong_pairs": ("", 0, True),
    "on_map_median_m": ("m", 2, True),
    "on_map_final_m": ("m", 2, True),
    "target_median_m": ("m", 2, True),
    "drift_median_percent": ("%", 2, True),
    "drift_worst_percent": ("%", 2, True),
    "reference_median_m": ("m", 2, True),
    "speed": ("x", 0, False),
}


def run_campaign(
    plan: Plan,
    seeds: Iterable[int],
    jobs: int | None = None,
    on_done: Callable[[int], None] = lambda n: None,
    journal: Journal | None = None,
) -> list[Row]:
    """All seeds, by seed; ``on_done`` is told how many are done.

    With a journal each row is kept as soon as it is there, and seeds whose rows it holds are not run again.
    """
    seeds = list(seeds)
    known = journal.rows() if journal else {}
    rows = [known[seed] for seed in seeds if seed in known]
    left = [seed for seed in seeds if seed not in known]
    on_done(len(rows))
    if left:
        jobs = min(jobs or os.cpu_count() or 1, len(left))
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            for future in as_completed([pool.submit(run_seed, plan, seed) for seed in left]):
                rows.append(future.result())
                if journal:
                    journal.keep(rows[-1])
                on_done(len(rows))
    return sorted(rows, key=lambda r: r.seed)


def run_seed(plan: Plan, seed: int) -> Row:
    """One seed from simulation to numbers; whatever goes wrong is told in the row."""
    begin = time.monotonic()
    try:
        run, speed = navigate(plan, seed)
        result = evaluate(run)
        stated = tuple((s.posterior, s.right) for dive in result.dives for s in dive.stated)
        return Row(seed, measures(result, run, speed), time.monotonic() - begin, stated=stated)
    except Exception as error:  # one bad seed must not cost the others; the row and the exit status tell
        return Row(seed, {}, time.monotonic() - begin, f"{type(error).__name__}: {error}")


def navigate(plan: Plan, seed: int) -> tuple[Run, float]:
    """Simulate a seed and run the estimators on it, in memory; gives the run and its speed (log over CPU time)."""
    import tempfile

    from fbn_bringup.commands.options import overrides
    from fbn_bringup.configuration import load_parameters
    from fbn_bringup.evaluation.truth import parse
    from fbn_bringup.offline import run_offline
    from fbn_bringup.simulation import PARAMETER_FILE, parameter_text
    from fbn_common.graph import GRAPH
    from fbn_common.prior_map import write_prior_map
    from fbn_sim.bag import MAP_FILE, truth_document
    from fbn_sim.scenario import load_scenario
    from fbn_sim.simulation import simulate

    simulation = simulate(load_scenario(plan.scenario), seed)
    with tempfile.TemporaryDirectory() as place:
        write_prior_map(Path(place) / MAP_FILE, simulation.prior_map)
        (Path(place) / PARAMETER_FILE).write_text(parameter_text(simulation))
        chosen = overrides(list(plan.settings), Path(place) / MAP_FILE)
        parameters = load_parameters(GRAPH, (Path(place) / PARAMETER_FILE, *plan.parameter_files), chosen)
        items: list[Item] = [_slim(*entry) for entry in simulation.records()]
        begin = time.process_time()
        run_offline(GRAPH, parameters, simulation.records(), lambda *item: items.append(_slim(*item)))
        wall = time.process_time() - begin
    span = (simulation.entries[-1].log_time_ns - simulation.entries[0].log_time_ns) / 1e9
    return collect(items, f"{plan.scenario}, seed {seed}", parse(truth_document(simulation))), span / wall


def _slim(log_ns: int, topic: str, record: Record) -> Item:
    """The item without what evaluation does not look at: motions and their Jacobians fill half a gigabyte."""
    return log_ns, topic, Record(record.stamp_ns) if topic in NOT_KEPT else record


def measures(result: Evaluation, run: Run, speed: float) -> dict[str, float | None]:
    """A seed's numbers by name; NEES ratios come as ``nees: ...``."""
    from fbn_bringup.evaluation.evaluate import target_errors

    drifts = [d.deadreck.percent for d in result.dives if d.deadreck and d.deadreck.distance > 1.0]
    stamps, errors, _ = target_errors(run)
    target = errors[[any(leg.contains(int(t)) for leg in run.legs()) for t in stamps]]  # while under water and matched
    found: dict[str, float | None] = {
        "dives": len(result.dives),
        "dives_matched": result.matched,
        "false_matches": result.false_matches,
        "wrong_pairs": sum(d.matches.wrong for d in result.dives if d.matches.declared),
        "on_map_median_m": result.on_map_median,
        "on_map_final_m": result.on_map_final,
        "target_median_m": float(np.median(np.linalg.norm(target[:, :2], axis=1))) if len(target) else None,
        "drift_median_percent": float(np.median(drifts)) if drifts else None,
        "drift_worst_percent": max(drifts, default=None),
        "reference_median_m": next((e.median for e in result.errors if e.name == "reference/odometry"), None),
        "speed": speed,
    }
    return found | {f"nees: {n.name}": n.ratio for n in result.nees} | {f"dof: {n.name}": n.dof for n in result.nees}


@dataclass(frozen=True, slots=True)
class Spread:
    """A measure over all seeds that have it."""

    name: str
    seeds: int
    total: float
    median: float
    low: float  # 5 %
    high: float  # 95 %
    worst: float


def spreads(rows: list[Row]) -> list[Spread]:
    """Median, spread and worst of every measure."""
    names = dict.fromkeys(name for row in rows for name in row.values if not name.startswith("dof: "))
    return [
        spread(name, [v for row in rows if (v := row.values.get(name)) is not None and np.isfinite(v)])
        for name in names
    ]


def spread(name: str, values: list[float]) -> Spread:
    """Median, spread and worst of one measure; NaN where no seed has it."""
    if not values:
        return Spread(name, 0, *[float("nan")] * 5)
    more_is_worse = MEASURES.get(name, ("", 2, True))[2]
    low, median, high = (float(q) for q in np.quantile(values, [0.05, 0.5, 0.95]))
    return Spread(
        name, len(values), float(sum(values)), median, low, high, max(values) if more_is_worse else min(values)
    )


def summary_tables(plan: Plan, rows: list[Row]) -> tuple[Table, ...]:
    """The campaign in tables: what was reached, whether the estimators knew how good they were, and where they are."""
    good = [row for row in rows if not row.error]
    reached = table(
        f"{plan.scenario}: {len(good)} of {len(rows)} seeds",
        *("measure", "seeds", "total", "median", "5 %", "95 %", "worst"),
    )
    honest = table("NEES over its degrees of freedom", "of", "seeds", "mean", "95 % band", "median", "worst")
    for s in spreads(good):
        if s.name.startswith("nees: "):
            mean, band = _band(s, good)
            honest.add_row(s.name.removeprefix("nees: "), str(s.seeds), mean, band, number(s.median), number(s.worst))
        else:
            unit, digits, _ = MEASURES[s.name]
            total = "" if unit else number(s.total, 0)
            name = f"{s.name} \\[{unit}]" if unit else s.name
            reached.add_row(name, str(s.seeds), total, *(number(v, digits) for v in (s.median, s.low, s.high, s.worst)))
    honest.caption = "the band of the mean were each run one independent sample: its samples are correlated"
    return (reached, honest, reliability_table(rows)) if stated_by(rows) else (reached, honest)


def stated_by(rows: list[Row]) -> Stated:
    """All posteriors of the vehicle's place that the seeds stated, and whether each was right."""
    return [pair for row in rows for pair in row.stated]


def reliability_table(rows: list[Row]) -> Table:
    """Of all the times that a place on the map was said to be so likely, how often it was the right one."""
    stated = stated_by(rows)
    made = table("posteriors of places on the map", "stated", "share that was right", "95 % bound", "statements")
    for b in bins(stated):
        made.add_row(number(b.stated, 3), number(b.right, 3), f"{b.low:.3f}–{b.high:.3f}", str(b.count))
    made.caption = f"expected calibration error {expected_error(stated):.3f}; statements of one dive hang together"
    return made


def _band(s: Spread, rows: list[Row]) -> tuple[str, str]:
    """Mean over the seeds, and the 95 % band of a mean of as many independent samples."""
    if not s.seeds:
        return "–", "–"
    dof = next((v for row in rows if (v := row.values.get(s.name.replace("nees", "dof", 1)))), 1.0) or 1.0
    low, high = chi_square.band(s.seeds * dof)
    return f"{s.total / s.seeds:.2f}", f"{low:.2f}–{high:.2f}"
