"""A check's outcome as tables and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.markup import escape

from fbn_bringup.check.findings import Severity, Verdict
from fbn_bringup.check.log import SENSORS
from fbn_bringup.ui import number, table
from fbn_common.graph import GRAPH

LOOK = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.NOTE: "dim"}


def tables(verdict: Verdict) -> Iterator[RenderableType]:
    """What there is, what was found, and the verdict."""
    yield _topics(verdict)
    if verdict.findings:
        yield _findings(verdict)
    yield closing(verdict)


def closing(verdict: Verdict) -> str:
    """The verdict in a line."""
    worst = max((f.severity for f in verdict.findings), default=Severity.NOTE)
    if worst == Severity.ERROR:
        return "[bold red]This log cannot be navigated by;[/] mend the errors above."
    if worst == Severity.WARNING:
        return "[bold yellow]Navigation works, worse than it could;[/] see the warnings above."
    return "[bold green]Good enough to navigate by.[/]"


def _topics(verdict: Verdict) -> RenderableType:
    t = table(f"{verdict.bag}: sensors", "topic", "messages", "rate", "longest gap", "latency", "without it", left=1)
    t.columns[-1].justify = "left"
    for topic in SENSORS:
        traffic = verdict.log.traffic.get(topic)
        without = f"[dim]{GRAPH.topics[topic].without}"
        if traffic is None:
            t.add_row(topic, "[yellow]none", "–", "–", "–", without)
        else:
            late = float(np.median(traffic.latency)) * 1e3
            t.add_row(
                topic,
                str(len(traffic.log_ns)),
                number(traffic.rate, 2, " Hz"),
                number(traffic.longest_gap(), 1, " s"),
                number(late, 0, " ms"),
                without,
            )
    return t


def _findings(verdict: Verdict) -> RenderableType:
    t = table("Findings", "", "topic", "what", "what to do", left=4)
    for f in verdict.findings:
        t.add_row(f"[{LOOK[f.severity]}]{f.severity.name.lower()}", f.topic, escape(f.text), escape(f.remedy))
    return t


def as_json(verdict: Verdict) -> str:
    """The outcome for programs."""
    traffic = verdict.log.traffic
    return json.dumps(
        {
            "bag": verdict.bag,
            "can_navigate": verdict.can_navigate,
            "topics": {
                t: {"messages": len(x.log_ns), "rate_hz": x.rate, "longest_gap_s": x.longest_gap()}
                for t, x in traffic.items()
            },
            "missing": list(verdict.missing),
            "findings": [
                {"severity": f.severity.name, "topic": f.topic, "text": f.text, "remedy": f.remedy}
                for f in verdict.findings
            ],
        },
        indent=2,
    )
