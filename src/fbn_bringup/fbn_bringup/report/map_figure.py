"""The map: track over prior and estimated map, layers switched by the legend."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from fbn_bringup.evaluation.evaluate import ErrorTracks
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Track
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_bringup.report.canvas import GAP, base, line, markers, rounded
from fbn_common.types import Array


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
