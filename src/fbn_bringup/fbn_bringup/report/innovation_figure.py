"""Innovations of every sensor, with their bounds and normalised squares."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Innovations, Stamps
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_bringup.report.canvas import legend_above, quiet_titles, rounded, shade_dives, styled
from fbn_common import chi_square
from fbn_common import records as r
from fbn_common.types import Array


def innovation_figure(run: Run) -> go.Figure | None:
    """Per sensor: innovations with 3 sigma, and NIS with the 95 % bound of its degrees of freedom."""
    tables = [t for t in run.innovations if len(t.stamp_ns)]
    if not tables:
        return None
    n = len(tables)
    titles = [text for t in tables for text in (f"{t.node}: {t.sensor}", "NIS")]
    figure = make_subplots(
        n,
        2,
        subplot_titles=titles,
        shared_xaxes="all",
        vertical_spacing=0.30 / n,
        horizontal_spacing=0.07,
        column_widths=[0.6, 0.4],
    )
    for i, table in enumerate(tables):
        _add_innovations(figure, run, table, i + 1)
    _add_verdict_legend(figure)
    shade_dives(figure, run, n, 2)
    figure.update_xaxes(title_text="minutes since start", row=n)
    return legend_above(quiet_titles(styled(figure, 130 + 175 * n)))


def _add_innovations(figure: go.Figure, run: Run, table: Innovations, row: int) -> None:
    some = ly.shown(table)
    time = ly.minutes(run, table.stamp_ns)
    limit = 0.0
    for k in range(int(table.dof.max(initial=0))):
        values, sigma, have = ly.component(table, k)
        keep = np.isin(have, some)
        limit = max(limit, ly.innovation_limit(values, sigma))
        shade = go.Scatter(
            x=rounded(time[have[keep]]),
            y=rounded(3 * sigma[keep], 5),
            mode="lines",
            showlegend=False,
            hoverinfo="skip",
            line=dict(color=st.faded(st.CYCLE[k % 8], 0.55), width=1, dash="dot"),
        )
        figure.add_trace(shade, row, 1)
        figure.add_trace(go.Scatter(shade, y=-np.asarray(shade.y)), row, 1)
        dots = dict(size=3, color=st.CYCLE[k % 8])
        label = f"component {k + 1}"
        figure.add_trace(
            go.Scatter(
                x=rounded(time[have[keep]]),
                y=rounded(values[keep], 5),
                mode="markers",
                marker=dots,
                name=label,
                showlegend=False,
            ),
            row,
            1,
        )
    if limit > 0.0:
        figure.update_yaxes(range=[-limit, limit], row=row, col=1)
    _add_nis(figure, time[some], table, some, row)


def _add_nis(figure: go.Figure, time: Array, table: Innovations, some: Stamps, row: int) -> None:
    values = ly.nis_to_draw(table)[some]
    drawn, when, nis = some[np.isfinite(values)], time[np.isfinite(values)], values[np.isfinite(values)]
    colours = [st.VERDICTS[r.Verdict(int(v)).name] for v in table.verdict[drawn]]
    text = [f"{r.Verdict(int(table.verdict[i])).name} {table.reason[i]}" for i in drawn]
    dots = go.Scatter(
        x=rounded(when),
        y=rounded(nis),
        mode="markers",
        marker=dict(size=3.5, color=colours),
        text=text,
        hovertemplate="NIS %{y:.2f}<br>%{text}<extra></extra>",
        showlegend=False,
    )
    figure.add_trace(dots, row, 2)
    dof = ly.usual_dof(table)
    if dof:
        bound = float(chi_square.bound(0.95, dof))
        figure.add_hline(y=bound, line=dict(color=st.INK, width=1, dash="dash"), row=row, col=2)
    figure.update_yaxes(type="log", row=row, col=2)


def _add_verdict_legend(figure: go.Figure) -> None:
    for verdict, colour in st.VERDICTS.items():
        figure.add_trace(
            go.Scatter(x=[None], y=[None], mode="markers", marker=dict(color=colour, size=7), name=verdict.lower()),
            1,
            2,
        )
    figure.add_trace(
        go.Scatter(
            x=[None], y=[None], mode="lines", line=dict(color=st.INK, width=1, dash="dash"), name="95 % bound of NIS"
        ),
        1,
        2,
    )
