"""The report written: sections in order, and the pictures for papers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fbn_bringup.evaluation.evaluate import DiveResult, ErrorTracks, Evaluation, error_tracks, evaluate
from fbn_bringup.evaluation.run import Run
from fbn_bringup.report import match_figures as mf
from fbn_bringup.report.innovation_figure import innovation_figure
from fbn_bringup.report.map_figure import map_figure
from fbn_bringup.report.page import Cell, Section, folded, html_table, page
from fbn_bringup.report.time_figures import error_figure, profile_figure
from fbn_bringup.ui import number
from fbn_common.estimator import Level
from fbn_common.graph import GRAPH

Advance = Callable[[float, str], None]
WORDS = {  # title, and what one sees
    "dives": ("Dives", "Each dive: did the filter find itself on the map, rightly, and how well."),
    "map": (
        "Map",
        "Track over prior and estimated map; ellipses are one standard deviation. The prior map is displaced against "
        "the true features, and the path on the map follows the map, not GPS. Click a name to switch a layer, drag to "
        "zoom.",
    ),
    "errors": (
        "Errors",
        "Estimate less truth; grey: three standard deviations as the filter claims them; blue: under water.",
    ),
    "matches": (
        "Matches",
        "The bank of hypotheses over time; and at each dive's end what was tracked (purple) and swept (blue), laid on "
        "the map as each likely hypothesis has it. Circles: should have been seen in this dive, and was not.",
    ),
    "tracking": (
        "Tracking",
        "Objects by stage (infants from their second echo), their fates, and how much the sonar said.",
    ),
    "profile": ("Depth", "Depth of the vehicle, and of the bottom under it."),
    "consistency": ("Consistency", "Is each estimate as good as it says? 1 is right, more is over-confident."),
    "innovations": (
        "Innovations",
        "What each measurement said against what was expected: innovation with three sigma (dotted), and its "
        "normalised square.",
    ),
    "traffic": ("Rates and latencies", "In lock step an output's latency is in log time: data are taken in steps."),
    "health": ("Health and parameters", "Each node's last word, what it cost, and the parameters it ran with."),
}
JUDGEMENT = {Level.OK: "good", Level.WARN: "fair", Level.ERROR: "bad", Level.STALE: "bad"}


def write_report(
    run: Run, directory: Path, *, png: bool, advance: Advance = lambda _f, _t: None, result: Evaluation | None = None
) -> Path:
    """Write ``report.html`` (and PNGs) into a directory; gives the page's path."""
    directory.mkdir(parents=True, exist_ok=True)
    advance(0.0, "evaluating")
    result = result or evaluate(run)
    tracks = error_tracks(run)
    advance(0.2, "report.html")
    target = directory / "report.html"
    target.write_text(page(*_content(run, result, tracks)), encoding="utf-8")
    if png:
        from fbn_bringup.report.paper import PICTURES

        for i, (name, draw) in enumerate(PICTURES.items()):
            advance(0.5 + 0.5 * i / len(PICTURES), name)
            draw(run, tracks, directory / name)
    return target


def _content(
    run: Run, result: Evaluation, tracks: ErrorTracks
) -> tuple[str, str, list[tuple[str, Cell]], list[Section]]:
    known = "against truth" if result.has_truth else "without truth: inner consistency only"
    length = sum(d.duration_s for d in result.dives) / 60
    subtitle = f"{len(result.dives)} dives, {length:.0f} minutes under water; {known}."
    return f"FBN: {run.name}", subtitle, cards(result), [s for s in _sections(run, result, tracks) if any(s.parts)]


def cards(result: Evaluation) -> list[tuple[str, Cell]]:
    """The figures one wants first."""
    n = len(result.dives)
    found = [("dives matched", Cell(f"{result.matched} of {n}", "good" if result.matched == n else "fair"))]
    if result.has_truth:
        false = result.false_matches
        found += [
            ("false matches", Cell(str(false), "bad" if false else "good")),
            ("error on the map, median", Cell(number(result.on_map_median, 2, " m"))),
        ]
    percent = result.drift_percent
    if percent is None and result.surfacings:
        percent = float(np.median([s.percent for s in result.surfacings]))
    return [*found, ("dead reckoning, median of distance", Cell(number(percent, 1, " %")))]


def _sections(run: Run, result: Evaluation, tracks: ErrorTracks) -> Iterator[Section]:
    parts = {
        "dives": [dive_table(result)],
        "map": [map_figure(run, tracks)],
        "errors": [error_figure(run, tracks), error_table(result)],
        "matches": [mf.hypothesis_figure(run), mf.overlay_figure(run)],
        "tracking": [mf.tracking_figure(run)],
        "profile": [profile_figure(run)],
        "consistency": [nees_table(result), sensor_table(result)],
        "innovations": [innovation_figure(run)],
        "traffic": [mf.latency_figure(run), folded("as a table", traffic_table(run))],
        "health": _health(run),
    }
    for anchor, found in parts.items():
        title, about = WORDS[anchor]
        yield Section(anchor, title, about, [part for part in found if part])


def dive_table(result: Evaluation) -> str:
    """One row per dive."""
    columns = (
        "dive",
        "start [min]",
        "length [s]",
        "way [m]",
        "matched",
        "after [s]",
        "pairs right",
        "wrong",
        "on the map [m]",
        "at the end [m]",
        "reference [m]",
        "dead reckoning [% of distance]",
    )
    return html_table(
        columns, [_dive_row(d, result.has_truth) for d in result.dives], caption="On the map: median after the match."
    )


def _dive_row(d: DiveResult, has_truth: bool) -> tuple[Any, ...]:
    m = d.matches
    matched = Cell("no", "fair") if not m.declared else Cell("false", "bad") if m.false else Cell("yes", "good")
    right, wrong = (str(m.right), Cell(str(m.wrong), "bad" if m.wrong else "")) if has_truth else (str(m.pairs), "–")
    drift = d.deadreck.percent if d.deadreck else None
    return (
        d.number,
        number(d.start_s / 60, 1),
        number(d.duration_s, 0),
        number(d.distance_m, 0),
        matched,
        number(m.after_s, 0),
        right,
        wrong,
        number(d.on_map_m),
        number(d.on_map_end_m),
        number(d.reference_m),
        number(drift, 1),
    )


def error_table(result: Evaluation) -> str:
    """Horizontal errors."""
    rows = [(e.name, *(number(v) for v in (e.median, e.p95, e.worst, e.final))) for e in result.errors]
    return html_table(("horizontal error [m]", "median", "95 %", "worst", "final"), rows) if rows else ""


def nees_table(result: Evaluation) -> str:
    """NEES of the estimates."""
    rows = [(n.name, n.samples, number(n.dof, 0), _ratio(n.ratio), number(100 * n.inside, 0)) for n in result.nees]
    return html_table(("NEES of", "samples", "dof", "NEES / dof", "under its 95 % bound [%]"), rows) if rows else ""


def sensor_table(result: Evaluation) -> str:
    """Verdicts and NIS of the sensors."""
    rows = [
        (
            s.node,
            s.sensor,
            *(s.verdicts[v] for v in ("USED", "GATED", "REFUSED", "LATE")),
            _ratio(s.nis.ratio) if s.nis else "–",
            f"{s.nis.low:.2f}–{s.nis.high:.2f}" if s.nis else "–",
            "; ".join(f"{reason} ({n})" for reason, n in list(s.reasons.items())[:3]),
        )
        for s in result.sensors
    ]
    columns = ("estimator", "sensor", "used", "gated", "refused", "late", "NIS / dof", "95 % band", "why not used")
    return html_table(columns, rows, left=2, last_left=True) if rows else ""


def _ratio(value: float) -> Cell:
    return Cell(f"{value:.2f}", "good" if 1 / 3 <= value <= 2 else "fair" if value <= 3 else "bad")


def traffic_table(run: Run) -> str:
    """Rates and latencies."""
    rows = []
    for topic in GRAPH.topics:
        if topic in run.traffic:
            x = run.traffic[topic]
            median, late = (f"{np.quantile(x.latency, q) * 1e3:.0f}" for q in (0.5, 0.95))
            rows.append((topic, len(x.log_ns), number(x.rate), number(x.longest_gap(), 1), median, late))
    return html_table(("topic", "messages", "rate [Hz]", "longest gap [s]", "latency, median [ms]", "95 % [ms]"), rows)


def _health(run: Run) -> list[Any]:
    parts: list[Any] = []
    if run.health:
        rows = [_health_row(run, node) for node in run.health]
        parts = [html_table(("node", "level", "CPU [s]", "of a core [%]", "says"), rows, left=2, last_left=True)]
    for node, values in run.parameters.items():
        counters = sorted(run.health[node].values.items()) if node in run.health else []
        if counters:
            rows = [(name, f"{v:.4g}" if isinstance(v, float) else v) for name, v in counters]
            parts.append(folded(f"counters of {node}", html_table(("counter", "value"), rows)))
        parts.append(folded(f"parameters of {node}", html_table(("name", "value"), sorted(values.items()))))
    return parts


def _health_row(run: Run, node: str) -> tuple[Any, ...]:
    h, timing = run.health[node], run.timing
    cpu = timing.cpu_s.get(node) if timing else None
    share = 100.0 * cpu / timing.log_s if cpu is not None and timing and timing.log_s else None
    return node, Cell(h.level.name, JUDGEMENT[h.level]), number(cpu, 1), number(share, 1), h.message
