"""What all figures for the screen share: the house style, lines and markers, the tint of dives."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from fbn_bringup.evaluation.run import Run
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_common.types import Array

GAP: Any = None  # plotly breaks a line here


def base(height: int, **layout: Any) -> go.Figure:
    """An empty figure in the house style."""
    return styled(go.Figure(), height, **layout)


def styled(figure: go.Figure, height: int, **layout: Any) -> go.Figure:
    """A figure in the house style."""
    axis = dict(gridcolor=st.GRID, zeroline=False, linecolor=st.MUTED, ticks="outside", tickcolor=st.MUTED, ticklen=4)
    figure.update_layout(
        height=height,
        template="plotly_white",
        font=dict(family=st.FONT, size=13, color=st.INK),
        margin=dict(l=64, r=24, t=36, b=52),
        hoverlabel=dict(font_family=st.FONT),
        legend=dict(bgcolor="rgba(255,255,255,0.85)", groupclick="togglegroup", tracegroupgap=2),
        **layout,
    )
    figure.update_xaxes(**axis, title_font_size=13)
    figure.update_yaxes(**axis, title_font_size=13)
    return figure


def line(x: Array, y: Array, look: st.Look, **more: Any) -> go.Scatter:
    """A line in an estimate's look."""
    style = dict(color=look.colour, width=look.width, dash=look.dash)
    usual = dict(mode="lines", line=style, name=look.name, legendgroup=look.name)
    return go.Scatter(x=rounded(x), y=rounded(y), **(usual | more))


def rounded(values: Array, digits: int = 3) -> Any:
    """Fewer bits make a smaller file."""
    return np.round(np.asarray(values, dtype=float), digits).astype(np.float32)


def markers(
    xy: Array, look: st.Look, symbol: str, size: float, labels: tuple[str, ...] = (), **more: Any
) -> go.Scatter:
    marker = dict(symbol=symbol, size=size, color=look.colour, line=dict(color=look.colour, width=1.6))
    return go.Scatter(
        x=rounded(xy[:, 0]),
        y=rounded(xy[:, 1]),
        mode="markers",
        marker=marker,
        name=look.name,
        legendgroup=look.name,
        text=list(labels) or None,
        hovertemplate=f"{look.name} %{{text}}<br>%{{x:.1f}}, %{{y:.1f}} m<extra></extra>",
        **more,
    )


def shade_dives(figure: go.Figure, run: Run, rows: int, columns: int = 1) -> None:
    """A tint behind the times under water, in every subplot."""
    spans = [ly.minutes(run, np.array([leg.start_ns, leg.end_ns])) for leg in run.legs()]
    if rows * columns > 1:
        cells = [figure.get_subplot(row + 1, column + 1) for row in range(rows) for column in range(columns)]
        axes = [(_anchor(cell.xaxis.plotly_name), _anchor(cell.yaxis.plotly_name)) for cell in cells]
    else:
        axes = [("x", "y")]
    tint = dict(type="rect", y0=0, y1=1, fillcolor=st.DIVE, line_width=0, layer="below")
    tints = [dict(tint, xref=x, yref=f"{y} domain", x0=a, x1=b) for x, y in axes for a, b in spans]
    figure.update_layout(shapes=[*figure.layout.shapes, *tints])


def _anchor(plotly_name: str) -> str:
    """``xaxis2`` is referred to as ``x2``."""
    return plotly_name.replace("axis", "")


def quiet_titles(figure: go.Figure) -> go.Figure:
    figure.update_annotations(font=dict(size=13, color=st.INK))
    return figure


def legend_above(figure: go.Figure) -> go.Figure:
    """The legend in a line over the plots, which then have the page's whole width."""
    above = dict(orientation="h", x=0, xanchor="left", y=1, yanchor="bottom", yref="container")
    figure.update_layout(legend=above | dict(y=0.995, yanchor="top"), margin_t=84)
    return figure
