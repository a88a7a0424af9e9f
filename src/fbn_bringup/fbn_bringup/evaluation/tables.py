"""An evaluation as tables for the terminal, and as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.table import Table

from fbn_bringup.evaluation.evaluate import DiveResult, Evaluation
from fbn_bringup.evaluation.run import Run
from fbn_bringup.ui import escape, number, table
from fbn_common.estimator import Level
from fbn_common.graph import GRAPH

COLOUR = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "red", Level.STALE: "red"}


def all_tables(result: Evaluation, run: Run) -> Iterator[Table]:
    """Everything, for ``fbn evaluate``."""
    yield dive_table(result)
    if result.errors:
        yield error_table(result)
    if result.surfacings:
        yield surfacing_table(result)
    if result.nees:
        yield nees_table(result)
    if result.sensors:
        yield sensor_table(result)
    if run.health:
        yield health_table(run)


def demo_tables(result: Evaluation, run: Run) -> Iterator[Table]:
    """What the demo shows."""
    yield dive_table(result)
    if result.nees:
        yield nees_table(result)
    yield traffic_table(run)
    if run.health:
        yield health_table(run)


def dive_table(result: Evaluation) -> Table:
    """One row per dive, and the run as a whole below; it fits a terminal of 80 columns."""
    columns = ("dive", "at", "way", "matched", "pairs", "on the map", "absolute", "reference", "drift")
    t = table(f"{result.name}: dives", *columns)
    for d in result.dives:
        t.add_row(*dive_row(d, result.has_truth))
    whole = result.mission_drift
    t.add_row(
        "[bold]all",
        "",
        number(whole.distance if whole else None, 0, " m"),
        f"[bold]{result.matched} of {len(result.dives)}",
        f"[red]{result.false_matches} false" if result.false_matches else "",
        f"[bold]{number(result.on_map_median, 2, ' m')}",
        "",
        "",
        number(result.drift_percent, 1, " %"),
    )
    t.caption = (
        "matched: s into the dive; pairs: right of all; on the map: median after the match;\n"
        "absolute, reference: errors at the dive's end; drift: of dead reckoning, per distance"
    )
    return t


def dive_row(d: DiveResult, has_truth: bool) -> tuple[str, ...]:
    """One dive's cells."""
    m = d.matches
    return (
        str(d.number),
        number(d.start_s / 60, 1, " min"),
        number(d.distance_m, 0, " m"),
        _matched(d),
        (f"{m.right} of {m.right + m.wrong}" if has_truth else str(m.pairs)) if m.pairs else "–",
        number(d.on_map_m, 2, " m"),
        number(d.absolute_m, 1, " m"),
        number(d.reference_m, 1, " m"),
        number(d.deadreck.percent if d.deadreck else None, 1, " %"),
    )


def _matched(d: DiveResult) -> str:
    if not d.matches.declared:
        return "[yellow]no"
    after = number(d.matches.after_s, 0, " s")
    return f"[bold red]FALSE {after}" if d.matches.false else f"[green]{after}"


def error_table(result: Evaluation) -> Table:
    """Horizontal errors of every estimate."""
    t = table("Horizontal error [m]", "estimate", "median", "95 %", "worst", "final")
    for s in result.errors:
        t.add_row(s.name, *(number(v) for v in (s.median, s.p95, s.worst, s.final)))
    return t


def surfacing_table(result: Evaluation) -> Table:
    """GPS against dead reckoning."""
    t = table("GPS against dead reckoning at each surfacing", "leg", "discrepancy", "GPS sigma", "way", "of distance")
    for s in result.surfacings:
        t.add_row(
            str(s.leg),
            number(s.discrepancy, 1, " m"),
            number(s.sigma, 1, " m"),
            number(s.distance, 0, " m"),
            number(s.percent, 1, " %"),
        )
    return t


def nees_table(result: Evaluation) -> Table:
    """Are the covariances honest?"""
    t = table("Consistency: NEES", "what", "samples", "dof", "NEES / dof", "under its 95 % bound")
    for n in result.nees:
        t.add_row(n.name, str(n.samples), number(n.dof, 0), _ratio(n.ratio), number(100 * n.inside, 0, " %"))
    t.caption = "1 = as good as it says; above 3 over-confident. One run's samples are correlated: judge by campaigns"
    return t


def sensor_table(result: Evaluation) -> Table:
    """Verdicts and NIS per sensor and estimator."""
    t = table(
        "Consistency: NIS per sensor",
        "estimator",
        "sensor",
        "used",
        "gated",
        "refused",
        "late",
        "NIS / dof",
        "95 % band",
        "why not used",
        left=2,
    )
    t.columns[-1].justify = "left"
    for s in sorted(result.sensors, key=lambda s: (s.node, s.sensor)):
        v, n = s.verdicts, s.nis
        band = f"{n.low:.2f}–{n.high:.2f}" if n else "–"
        why = "; ".join(f"{reason} ({count})" for reason, count in list(s.reasons.items())[:3])
        t.add_row(
            s.node,
            s.sensor,
            *(str(v[k]) for k in ("USED", "GATED", "REFUSED", "LATE")),
            _ratio(n.ratio) if n else "–",
            band,
            why,
        )
    return t


def traffic_table(run: Run) -> Table:
    """Rates and latencies of what the estimators take and give."""
    t = table("Rates and latencies", "topic", "messages", "rate", "longest gap", "latency", "95 %")
    for topic in GRAPH.topics:
        if topic in run.traffic and not topic.endswith("/innovations"):
            x = run.traffic[topic]
            median, late = (float(np.quantile(x.latency, q)) * 1e3 for q in (0.5, 0.95))
            t.add_row(
                topic,
                str(len(x.log_ns)),
                number(x.rate, 2, " Hz"),
                number(x.longest_gap(), 1, " s"),
                number(median, 0, " ms"),
                number(late, 0, " ms"),
            )
    t.caption = "in lock step an output's latency is in log time: data are taken in steps"
    return t


def health_table(run: Run) -> Table:
    """Each node's last word, and what it cost."""
    t = table("Health", "node", "level", "CPU", "of a core", "says", left=2)
    t.columns[-1].justify = "left"
    for node, h in run.health.items():
        cpu = run.timing.cpu_s.get(node) if run.timing else None
        share = 100.0 * cpu / run.timing.log_s if cpu is not None and run.timing and run.timing.log_s else None
        level = f"[{COLOUR[h.level]}]{h.level.name}"
        t.add_row(node, level, number(cpu, 1, " s"), number(share, 1, " %"), escape(h.message))
    if run.timing:
        log, wall, speed = run.timing.log_s, run.timing.wall_s, run.timing.speed
        t.caption = f"{run.timing.mode}: {log:.0f} s of log in {wall:.0f} s, {speed:.1f} times real time"
    return t


def _ratio(value: float) -> str:
    colour = "green" if 1 / 3 <= value <= 2 else "yellow" if value <= 3 else "red"
    return f"[{colour}]{value:.2f}"


def as_json(result: Evaluation) -> str:
    """The evaluation as JSON; what is not known is null."""
    summary = {
        "matched": result.matched,
        "false_matches": result.false_matches,
        "on_map_median": result.on_map_median,
        "on_map_final": result.on_map_final,
        "drift_percent": result.drift_percent,
    }
    return json.dumps(_finite(dataclasses.asdict(result) | summary), indent=2)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
