"""Errors with their bounds, and depth, over time."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from fbn_bringup.evaluation.evaluate import ErrorTracks
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Track
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_bringup.report.canvas import base, legend_above, line, quiet_titles, rounded, shade_dives, styled
from fbn_common import records as r
from fbn_common.types import Array


def error_figure(run: Run, tracks: ErrorTracks) -> go.Figure | None:
    """Errors with three standard deviations, two axes to a row."""
    bands = ly.error_bands(run, tracks)
    if not bands:
        return None
    rows = (len(bands) + 1) // 2
    titles = [f"{b.title} [{b.unit}]" for b in bands]
    figure = make_subplots(
        rows, 2, subplot_titles=titles, shared_xaxes=True, vertical_spacing=0.26 / rows, horizontal_spacing=0.07
    )
    for i, band in enumerate(bands):
        _add_band(figure, band, i // 2 + 1, i % 2 + 1, i == 0)
    shade_dives(figure, run, rows, 2)
    figure.update_xaxes(title_text="minutes since start", row=rows)
    return legend_above(quiet_titles(styled(figure, 130 + 190 * rows, hovermode="x")))


def _add_band(figure: go.Figure, band: ly.Band, row: int, column: int, legend: bool) -> None:
    look = st.LOOKS[band.topic]
    both = (
        np.concatenate([band.minutes, band.minutes[::-1]]),
        np.concatenate([band.three_sigma, -band.three_sigma[::-1]]),
    )
    fill = go.Scatter(
        x=rounded(both[0]),
        y=rounded(both[1]),
        fill="toself",
        fillcolor=st.faded(st.MUTED, 0.16),
        line=dict(width=0),
        hoverinfo="skip",
        name="3σ",
        legendgroup="3σ",
        showlegend=legend,
    )
    figure.add_trace(fill, row, column)
    figure.add_hline(y=0, line=dict(color=st.MUTED, width=0.8), row=row, col=column)
    figure.add_trace(
        line(band.minutes, band.error, look, showlegend=column == 1 and "height" not in band.title), row, column
    )
    for name, values in band.beside.items():
        beside = st.Look(f"error {name}", st.TARGET.colour, 1.6)
        figure.add_trace(line(band.minutes, values, beside, showlegend=column == 1), row, column)
    _limit(figure, band, row, column)


def _limit(figure: go.Figure, band: ly.Band, row: int, column: int) -> None:
    """Show the errors well, even where the bound is huge before a first fix."""
    largest = max(np.abs(band.error).max(), *(np.abs(v).max() for v in band.beside.values()), 1e-9)
    high = float(max(1.2 * largest, min(1.15 * np.quantile(band.three_sigma, 0.9), 4 * largest)))
    figure.update_yaxes(range=[-high, high], row=row, col=column)


def profile_figure(run: Run) -> go.Figure | None:
    """Depth and what the altimeter says of the bottom."""
    source = run.true_track or run.tracks.get("deadreck/odometry")
    if source is None:
        return None
    figure = base(300, xaxis_title="minutes since start", yaxis_title="depth [m]", hovermode="x")
    for topic in ("truth/odometry", "deadreck/odometry"):
        if topic in run.tracks:
            t = run.tracks[topic].where(ly.thinned(len(run.tracks[topic])))
            figure.add_trace(line(ly.minutes(run, t.stamp_ns), -t.position[:, 2], st.LOOKS[topic]))
    x, y = bottom(run, source)
    figure.add_trace(
        go.Scatter(
            x=rounded(x), y=rounded(y), mode="markers", marker=dict(size=3, color=st.MUTED), name="bottom, by altimeter"
        )
    )
    figure.update_yaxes(autorange="reversed")
    shade_dives(figure, run, 1)
    return figure


def bottom(run: Run, source: Track) -> tuple[Array, Array]:
    """Minutes and depth [m] of the bottom as the altimeter saw it, for a level vehicle."""
    ranges = [a for a in run.of("altitude", r.Range) if a.min_range <= a.range <= a.max_range]
    ranges = [a for a in ranges if source.stamp_ns[0] <= a.stamp_ns <= source.stamp_ns[-1]]
    ranges = [ranges[i] for i in ly.thinned(len(ranges))]
    if not ranges:
        return np.zeros(0), np.zeros(0)
    stamps = np.array([a.stamp_ns for a in ranges])
    return ly.minutes(run, stamps), np.array([a.range for a in ranges]) - source.at(stamps).position[:, 2]
