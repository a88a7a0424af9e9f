"""Figures of matching, tracking and traffic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from fbn_bringup.evaluation.run import Run
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_bringup.report.canvas import (
    GAP,
    base,
    legend_above,
    line,
    markers,
    quiet_titles,
    rounded,
    shade_dives,
    styled,
)
from fbn_bringup.report.overlay import DiveOverlay, hypothesis_lines, overlays, stated_posterior
from fbn_common import records as r
from fbn_common.graph import GRAPH
from fbn_common.sweep import CELL
from fbn_common.types import Array

STATES = {"UNMATCHED": st.MUTED, "MATCHED": st.GLOBAL.colour, "AMBIGUOUS": st.DEADRECK.colour, "LOST": st.TARGET.colour}

MISSED = st.Look("swept, and not seen", st.DEADRECK.colour)


def hypothesis_figure(run: Run) -> go.Figure | None:
    """Posterior of place and hypotheses, their scores, and where the filter stands, over time."""
    lines = hypothesis_lines(run)
    if not lines:
        return None
    titles = ["posterior of place and hypotheses", "log score against the null hypothesis", "features matched"]
    figure = make_subplots(
        3, 1, shared_xaxes=True, vertical_spacing=0.08, subplot_titles=titles, row_heights=[0.42, 0.33, 0.25]
    )
    figure.add_trace(line(*stated_posterior(run), st.PLACE, line_shape="hv"), 1, 1)
    for i, h in enumerate(lines):
        look = (
            st.Look("nothing matched", st.MUTED, 1.4, "dot")
            if h.null
            else st.Look(f"hypothesis {h.id}", st.CYCLE[i % 8])
        )
        text = [f"{int(n)} pairs" for n in h.pairs]
        for row, values in ((1, h.posterior), (2, h.log_score)):
            trace = line(
                h.minutes, values, look, mode="lines+markers", marker=dict(size=4), text=text, showlegend=row == 1
            )
            figure.add_trace(trace, row, 1)
    _add_states(figure, run)
    figure.update_yaxes(range=[-0.03, 1.03], row=1)
    figure.update_yaxes(rangemode="tozero", row=3)
    shade_dives(figure, run, 3)
    figure.update_xaxes(title_text="minutes since start", row=3)
    return quiet_titles(styled(figure, 560))


def _add_states(figure: go.Figure, run: Run) -> None:
    statuses = run.of("global/status", r.LocalizationStatus)
    if not statuses:
        return
    time = ly.minutes(run, np.array([s.stamp_ns for s in statuses]))
    counts = np.array([s.features_matched for s in statuses], dtype=float)
    figure.add_trace(
        line(time, counts, st.Look("features matched", st.MUTED, 1.2), line_shape="hv", showlegend=False), 3, 1
    )
    for state, colour in STATES.items():
        inside = np.array([s.state.name == state for s in statuses])
        if inside.any():
            reasons = [s.reason for s, there in zip(statuses, inside, strict=True) if there]
            dots = go.Scatter(
                x=rounded(time[inside]),
                y=counts[inside],
                mode="markers",
                marker=dict(color=colour, size=6),
                name=state.lower(),
                text=reasons,
                hovertemplate="%{y} features<br>%{text}",
            )
            figure.add_trace(dots, 3, 1)


def overlay_figure(run: Run) -> go.Figure | None:
    """What was tracked and swept in each dive, laid on the map by each likely hypothesis; a button for each."""
    made = overlays(run, most=3)
    if not made:
        return None
    figure = base(600, xaxis_title="east [m]", yaxis_title="north [m]", hovermode="closest")
    figure.update_yaxes(scaleanchor="x", scaleratio=1)
    owners: list[int] = []
    for i, overlay in enumerate(made):
        traces = _overlay_traces(overlay, visible=i == len(made) - 1)
        figure.add_traces(traces)
        owners += [i] * len(traces)
    buttons = [
        dict(label=_name(o, made), method="restyle", args=[{"visible": [owner == i for owner in owners]}])
        for i, o in enumerate(made)
    ]
    menu = dict(
        type="dropdown",
        direction="down",
        x=0,
        y=1.08,
        xanchor="left",
        yanchor="bottom",
        buttons=buttons,
        active=len(made) - 1,
    )
    figure.update_layout(updatemenus=[menu])
    return figure


def _name(o: DiveOverlay, made: list[DiveOverlay]) -> str:
    """A dive, and which of its hypotheses where there are several."""
    several = sum(other.dive == o.dive for other in made) > 1
    return f"dive {o.dive}" + (f": hypothesis {o.hypothesis}, {o.posterior:.2f}" if several else "")


def _sweep_trace(o: DiveOverlay, visible: bool) -> list[Any]:
    if o.swept is None:
        return []
    rows, columns = o.swept.scans.shape
    shades = [[0.0, st.faded(st.GPS.colour, 0.10)], [1.0, st.faded(st.GPS.colour, 0.55)]]
    return [
        go.Heatmap(
            z=rounded(o.swept.scans, 0),
            x=o.swept.corner[0] + CELL * (np.arange(columns) + 0.5),
            y=o.swept.corner[1] + CELL * (np.arange(rows) + 0.5),
            colorscale=shades,
            zmin=0,
            zmax=30,
            showscale=False,
            visible=visible,
            hovertemplate="%{z:.0f} scans<extra></extra>",
        )
    ]


def _overlay_traces(o: DiveOverlay, visible: bool) -> list[Any]:
    lines = [end for a, b in o.pairs for end in (o.map_xy[a], o.tracked_xy[b], (GAP, GAP))]
    traces: list[Any] = [
        *_sweep_trace(o, visible),
        line(o.path_xy[:, 0], o.path_xy[:, 1], st.GLOBAL, visible=visible),
        go.Scatter(
            x=[p[0] for p in lines],
            y=[p[1] for p in lines],
            mode="lines",
            visible=visible,
            hoverinfo="skip",
            line=dict(color=st.TARGET.colour, width=2),
            name=f"pairs (posterior {o.posterior:.2f}, score {o.log_score:.0f})",
        ),
        markers(o.map_xy, st.ESTIMATED, "x-thin", 10, o.map_labels, visible=visible),
    ]
    if o.missed:
        labels = tuple(o.map_labels[i] for i in o.missed)
        traces.append(markers(o.map_xy[list(o.missed)], MISSED, "circle-open", 15, labels, visible=visible))
    if len(o.tracked_xy):
        traces.append(
            markers(
                o.tracked_xy, st.TRACKED, "circle", 7, tuple(str(i) for i in range(len(o.tracked_xy))), visible=visible
            )
        )
    return traces


def fates(messages: Sequence[r.TrackedFeatures]) -> tuple[Array, Array]:
    """How many infants were promoted, and how many deleted, up to each message (n,): those that are shown."""
    promoted, deleted = np.zeros(len(messages)), np.zeros(len(messages))
    young: set[int] = set()
    for n, message in enumerate(messages):
        infants = {f.key for f in message.features if f.stage == r.Stage.INFANT}
        others = {f.key for f in message.features} - infants
        promoted[n], deleted[n] = len(young & others), len(young - others - infants)
        young = infants
    return np.cumsum(promoted), np.cumsum(deleted)


def tracking_figure(run: Run) -> go.Figure | None:
    """Infants, features and retired features, what became of infants, and the detections per array and ping."""
    messages = run.of("tracking/features", r.TrackedFeatures)
    if not messages:
        return None
    titles = ["tracked, by stage", "infants promoted and deleted so far", "detections per array and ping"]
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.08, subplot_titles=titles)
    kept = ly.thinned(len(messages))
    counts_of = zip(("promoted", "deleted"), fates(messages), ("#0072b2", "#d55e00"), strict=True)
    messages = [messages[i] for i in kept]
    time = ly.minutes(run, np.array([m.stamp_ns for m in messages]))
    for name, count, colour in counts_of:
        figure.add_trace(line(time, count[kept], st.Look(name, colour), line_shape="hv"), 2, 1)
    for stage, colour in zip(r.Stage, ("#56b4e9", "#009e73", "#7b8794"), strict=True):
        counts = np.array([sum(f.stage == stage for f in m.features) for m in messages], dtype=float)
        figure.add_trace(line(time, counts, st.Look(stage.name.lower(), colour), line_shape="hv"), 1, 1)
    pings = run.of("sonar/detections", r.SonarDetections)
    pings = [pings[i] for i in ly.thinned(len(pings), 3000)]
    if pings:
        x, y = (
            ly.minutes(run, np.array([p.stamp_ns for p in pings])),
            np.array([len(p.detections) for p in pings], dtype=float),
        )
        figure.add_trace(
            go.Scatter(x=rounded(x), y=y, mode="markers", marker=dict(size=3, color=st.MUTED), showlegend=False), 3, 1
        )
    shade_dives(figure, run, 3)
    figure.update_xaxes(title_text="minutes since start", row=3)
    return legend_above(quiet_titles(styled(figure, 600)))


def latency_figure(run: Run) -> go.Figure | None:
    """From measurement to log, per topic: median, and the span from 5 to 95 %."""
    topics = [t for t in GRAPH.topics if t in run.traffic and not t.endswith("/innovations")]
    if not topics:
        return None
    q = np.array([np.quantile(run.traffic[t].latency, [0.05, 0.5, 0.95]) * 1e3 for t in topics])
    q = np.maximum(q, 1.0)  # on a logarithmic axis
    figure = base(90 + 24 * len(topics), xaxis_title="from measurement to log [ms]", hovermode="closest")
    error = dict(
        type="data",
        symmetric=False,
        array=rounded(q[:, 2] - q[:, 1]),
        arrayminus=rounded(q[:, 1] - q[:, 0]),
        thickness=1.4,
        width=0,
    )
    colours = [st.MUTED if GRAPH.publisher(t) is None else st.REFERENCE.colour for t in topics]
    text = [f"{run.traffic[t].rate:.2f} Hz, longest gap {run.traffic[t].longest_gap():.1f} s" for t in topics]
    figure.add_trace(
        go.Scatter(
            x=rounded(q[:, 1]),
            y=topics,
            mode="markers",
            error_x=error,
            text=text,
            marker=dict(size=8, color=colours),
            hovertemplate="%{y}: median %{x:.0f} ms<br>%{text}<extra></extra>",
            showlegend=False,
        )
    )
    figure.update_yaxes(autorange="reversed", ticksuffix=" ", gridcolor="white")
    figure.update_xaxes(type="log")
    return figure
