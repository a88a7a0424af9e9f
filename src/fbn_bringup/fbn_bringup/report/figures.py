"""The report's figures for the screen: plotly, layers switched by the legend."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from fbn_bringup.evaluation.consistency import chi2_bound
from fbn_bringup.evaluation.evaluate import ErrorTracks
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Innovations, Stamps, Track
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_common import records as r
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


# --- map -------------------------------------------------------------------------------------------------


def map_figure(run: Run, tracks: ErrorTracks) -> go.Figure:
    """Track over prior and estimated map with covariance ellipses; a click in the legend switches a layer."""
    layers = ly.map_layers(run, tracks)
    figure = base(720, xaxis_title="east [m]", yaxis_title="north [m]", hovermode="closest")
    figure.update_yaxes(scaleanchor="x", scaleratio=1)
    for topic in ("deadreck/odometry", "reference/odometry", "global/odometry", "truth/odometry"):
        if topic in layers.paths:
            figure.add_trace(_path(layers.paths[topic], st.LOOKS[topic], run))
    _add_pose_ellipses(figure, layers)
    if layers.shift is not None and "truth/odometry" in layers.paths:
        moved = layers.paths["truth/odometry"].shifted(np.append(layers.shift, 0.0))
        figure.add_trace(_path(moved, st.Look("truth, on the final map", st.MUTED, 1.2, "dot"), run))
    if len(layers.gps):
        figure.add_trace(markers(layers.gps, st.GPS, "circle", 3))
    _add_features(figure, layers)
    figure.update_layout(updatemenus=[_map_buttons(figure)])
    return figure


def _path(track: Track, look: st.Look, run: Run) -> go.Scatter:
    text = [
        f"{m:.1f} min, depth {-z:.1f} m"
        for m, z in zip(ly.minutes(run, track.stamp_ns), track.position[:, 2], strict=True)
    ]
    return line(
        track.position[:, 0], track.position[:, 1], look, text=text, hovertemplate="%{x:.1f}, %{y:.1f} m<br>%{text}"
    )


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


def _outlines(outlines: list[Array], look: st.Look, fill: float = 0.10, **more: Any) -> go.Scatter:
    """Many closed outlines as one trace."""
    x, y = ([v for o in outlines for v in (*rounded(o[:, axis], 2), GAP)] for axis in (0, 1))
    return go.Scatter(
        x=x,
        y=y,
        mode="lines",
        fill="toself",
        fillcolor=st.faded(look.colour, fill),
        line=dict(color=st.faded(look.colour, 0.7), width=1),
        name=look.name,
        legendgroup=look.name,
        hoverinfo="skip",
        **({"showlegend": False} | more),
    )


def _add_features(figure: go.Figure, layers: ly.MapLayers) -> None:
    if layers.prior is not None and len(layers.prior.xy):
        figure.add_trace(_outlines(layers.prior.ellipses(), st.PRIOR, 0.05))
        figure.add_trace(markers(layers.prior.xy, st.PRIOR, "x-thin", 10, layers.prior.labels))
    if layers.estimated is not None and len(layers.estimated.xy):
        figure.add_trace(_outlines(layers.estimated.ellipses(), st.ESTIMATED, 0.18))
        figure.add_trace(markers(layers.estimated.xy, st.ESTIMATED, "circle", 6, layers.estimated.labels))
    if layers.true_features is not None:
        figure.add_trace(
            markers(layers.true_features.xy, st.TRUE_FEATURE, "circle-open", 11, layers.true_features.labels)
        )
    if layers.target is not None and len(layers.target.xy):
        figure.add_trace(markers(layers.target.xy, st.TARGET, "star", 13, layers.target.labels))


def _add_pose_ellipses(figure: go.Figure, layers: ly.MapLayers, each: int = 30) -> None:
    """The vehicle's own uncertainty along two of the paths, every half minute; off at first."""
    for topic, visible in (("reference/odometry", "legendonly"), ("global/odometry", "legendonly")):
        if topic in layers.paths:
            some = layers.paths[topic].where(np.arange(0, len(layers.paths[topic]), each))
            outlines = [ly.ellipse(p[:2], c[:2, :2]) for p, c in zip(some.position, some.covariance, strict=True)]
            name = f"1σ of {st.LOOKS[topic].name.partition(' ')[0]}"
            figure.add_trace(
                _outlines(outlines, st.Look(name, st.LOOKS[topic].colour), 0.06, showlegend=True, visible=visible)
            )


def _map_buttons(figure: go.Figure) -> dict[str, Any]:
    """Views: everything; before the map is used, and on the map (the two panels of a paper)."""
    names = [trace.name for trace in figure.data]
    without = {st.GLOBAL.name, st.ESTIMATED.name, "1σ of global", "truth, on the final map"}
    on_map = {st.GLOBAL.name, st.ESTIMATED.name, st.PRIOR.name, st.TARGET.name, "1σ of global"}

    def view(label: str, shown: list[bool | str]) -> dict[str, Any]:
        return dict(label=label, method="restyle", args=[{"visible": shown}])

    start = [True if trace.visible is None else trace.visible for trace in figure.data]
    buttons = [
        view("everything", start),
        view("without the map", [name not in without or "legendonly" for name in names]),
        view("on the map", [name in on_map or "legendonly" for name in names]),
    ]
    return dict(
        type="buttons",
        direction="right",
        x=0,
        y=1.06,
        xanchor="left",
        yanchor="bottom",
        buttons=buttons,
        showactive=True,
    )


# --- over time -------------------------------------------------------------------------------------------


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


def quiet_titles(figure: go.Figure) -> go.Figure:
    figure.update_annotations(font=dict(size=13, color=st.INK))
    return figure


def legend_above(figure: go.Figure) -> go.Figure:
    """The legend in a line over the plots, which then have the page's whole width."""
    above = dict(orientation="h", x=0, xanchor="left", y=1, yanchor="bottom", yref="container")
    figure.update_layout(legend=above | dict(y=0.995, yanchor="top"), margin_t=84)
    return figure


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


# --- innovations -----------------------------------------------------------------------------------------


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
        bound = float(chi2_bound(0.95, dof))
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
