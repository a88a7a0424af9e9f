"""PNGs for papers: the same layers as on the screen, drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fbn_bringup.evaluation.evaluate import ErrorTracks
from fbn_bringup.evaluation.run import Run
from fbn_bringup.evaluation.series import Innovations
from fbn_bringup.report import layers as ly
from fbn_bringup.report import style as st
from fbn_bringup.report.overlay import DiveOverlay, hypothesis_lines, overlays, stated_posterior
from fbn_common import chi_square
from fbn_common.records import Verdict
from fbn_common.sweep import CELL

RC: Final[Any] = {
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": st.MUTED,
    "axes.labelcolor": st.INK,
    "xtick.color": st.INK,
    "ytick.color": st.INK,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": st.GRID,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.dpi": 160,
    "savefig.bbox": "tight",
}


def track_map(run: Run, tracks: ErrorTracks, path: Path) -> None:
    """Two panels: three separate estimates before the map is used, and path and map after matching."""
    layers = ly.map_layers(run, tracks)
    with mpl.rc_context(RC):
        width, height = ly.extent(layers)
        figure = Figure(figsize=(10.5, 1.3 + 4.9 * min(max(1.1 * height / width, 0.2), 1.6)), layout="constrained")
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        _panel_without_map(left, layers)
        _panel_on_map(right, layers)
        _one_legend(figure, (left, right))
        _save(figure, path)


def _panel_without_map(axes: Axes, layers: ly.MapLayers) -> None:
    _plane(axes, "(a) without the map")
    for topic in ("deadreck/odometry", "reference/odometry", "truth/odometry"):
        _path(axes, layers, topic)
    _prior(axes, layers)
    if layers.true_features is not None:
        axes.plot(*layers.true_features.xy.T, "o", mfc="none", mec=st.INK, ms=6, mew=0.9, label=st.TRUE_FEATURE.name)


def _panel_on_map(axes: Axes, layers: ly.MapLayers) -> None:
    _plane(axes, "(b) on the map")
    if layers.shift is not None and "truth/odometry" in layers.paths:
        moved = layers.paths["truth/odometry"].position[:, :2] + layers.shift
        axes.plot(*moved.T, color=st.INK, lw=0.9, ls=(0, (2, 1.5)), label="truth, on the final map", zorder=2)
    _path(axes, layers, "global/odometry")
    _prior(axes, layers)
    if layers.estimated is not None:
        for outline in layers.estimated.ellipses():
            axes.fill(*outline.T, color=st.ESTIMATED.colour, alpha=0.2, lw=0)
        axes.plot(*layers.estimated.xy.T, "o", color=st.ESTIMATED.colour, ms=3.5, label="estimated map, 1σ")
    if layers.target is not None and len(layers.target.xy):
        axes.plot(*layers.target.xy.T, "*", color=st.TARGET.colour, ms=12, label=st.TARGET.name, zorder=5)


def _plane(axes: Axes, title: str) -> None:
    axes.set(title=title, xlabel="east [m]", ylabel="north [m]", aspect="equal")


def _path(axes: Axes, layers: ly.MapLayers, topic: str) -> None:
    if topic in layers.paths:
        look = st.LOOKS[topic]
        axes.plot(
            *layers.paths[topic].position[:, :2].T, color=look.colour, lw=0.8 * look.width, label=look.name, zorder=3
        )


def _prior(axes: Axes, layers: ly.MapLayers) -> None:
    if layers.prior is not None and len(layers.prior.xy):
        for outline in layers.prior.ellipses():
            axes.plot(*outline.T, color=st.MUTED, lw=0.5, alpha=0.5)
        axes.plot(*layers.prior.xy.T, "x", color=st.MUTED, ms=7, mew=1.4, label="prior map, 1σ", zorder=4)


def _one_legend(figure: Figure, axes: tuple[Axes, ...]) -> None:
    handles = {label: handle for a in axes for handle, label in zip(*a.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5)


def errors(run: Run, tracks: ErrorTracks, path: Path) -> None:
    """Errors with three standard deviations."""
    bands = ly.error_bands(run, tracks)
    if not bands:
        return
    with mpl.rc_context(RC):
        figure, panels = _two_columns(len(bands), 1.55)
        for axes, band in zip(panels, bands, strict=True):
            _band(axes, run, band)
        for axes in panels[-(2 - len(panels) % 2) :]:  # the bottom row
            axes.set_xlabel("minutes since start")
        _save(figure, path)


def _two_columns(count: int, inches: float) -> tuple[Figure, list[Axes]]:
    """A figure of ``count`` panels in two columns over one time, each so high."""
    rows = (count + 1) // 2
    figure = Figure(figsize=(10.5, 0.9 + inches * rows), layout="constrained")
    panels = list(figure.subplots(rows, 2, sharex=True, squeeze=False).flat)
    for axes in panels[count:]:
        axes.set_visible(False)
    return figure, panels[:count]


def _band(axes: Axes, run: Run, band: ly.Band) -> None:
    _shade(axes, run)
    axes.fill_between(band.minutes, -band.three_sigma, band.three_sigma, color=st.MUTED, alpha=0.18, lw=0, label="3σ")
    axes.axhline(0.0, color=st.MUTED, lw=0.6)
    absolute = "absolute" if band.beside else "error"
    axes.plot(band.minutes, band.error, color=st.LOOKS[band.topic].colour, lw=1.1, label=absolute)
    for name, values in band.beside.items():
        axes.plot(band.minutes, values, color=st.TARGET.colour, lw=1.1, label=name)
    axes.set(title=band.title, ylabel=f"[{band.unit}]", ylim=limits(band), xlim=(band.minutes[0], band.minutes[-1]))
    if band.beside:
        axes.legend(loc="upper right", ncols=3)


def limits(band: ly.Band) -> tuple[float, float]:
    """Axis limits that show the errors well, even where the bound is huge before a first fix."""
    largest = max(np.abs(band.error).max(), *(np.abs(v).max() for v in band.beside.values()), 1e-9)
    high = float(max(1.2 * largest, min(1.15 * np.quantile(band.three_sigma, 0.9), 4 * largest)))
    return -high, high


def _shade(axes: Axes, run: Run) -> None:
    for leg in run.legs():
        axes.axvspan(*ly.minutes(run, np.array([leg.start_ns, leg.end_ns])), color=st.DIVE, lw=0, zorder=0)


def innovations(run: Run, tracks: ErrorTracks, path: Path) -> None:
    """NIS of every sensor over time against its 95 % bound."""
    tables = [t for t in run.innovations if len(t.stamp_ns) and (t.dof > 0).any()]
    if not tables:
        return
    with mpl.rc_context(RC):
        figure, panels = _two_columns(len(tables), 1.35)
        for axes, table in zip(panels, tables, strict=True):
            _nis(axes, run, table)
        _one_legend(figure, tuple(panels))
        _save(figure, path)


def _nis(axes: Axes, run: Run, table: Innovations) -> None:
    _shade(axes, run)
    some, time, values = ly.shown(table), ly.minutes(run, table.stamp_ns), ly.nis_to_draw(table)
    for verdict in Verdict:
        mine = some[table.verdict[some] == verdict]
        if len(mine):
            axes.plot(time[mine], values[mine], ".", ms=2, color=st.VERDICTS[verdict.name], label=verdict.name.lower())
    axes.axhline(
        float(chi_square.bound(0.95, ly.usual_dof(table))), color=st.INK, lw=0.8, ls="--", label="95 % bound of NIS"
    )
    axes.set(title=f"{table.node}: {table.sensor}", yscale="log", ylabel="NIS")


def matches(run: Run, tracks: ErrorTracks, path: Path) -> None:
    """Posterior of the hypotheses over time, and every dive's tracked features laid on the map."""
    lines, made = hypothesis_lines(run), overlays(run)
    if not lines:
        return
    columns = min(3, max(1, len(made)))
    rows = -(-len(made) // columns)
    tall = 0.7 + 3.1 * _aspect(made)  # inches of a row
    with mpl.rc_context(RC):
        figure = Figure(figsize=(10.5, 2.2 + tall * rows), layout="constrained")
        top, *below = figure.subfigures(
            1 + (rows > 0), 1, height_ratios=[2.2, tall * rows][: 1 + (rows > 0)], squeeze=False
        ).flat
        _posterior(top.subplots(), run, lines)
        if below:
            grid = below[0].subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
            for axes, overlay in zip(grid.flat, made, strict=False):
                _overlay(axes, overlay)
            for axes in grid.flat[len(made) :]:
                axes.set_visible(False)
        _save(figure, path)


def _aspect(made: list[DiveOverlay]) -> float:
    """Height over width of what the overlays show."""
    if not made:
        return 1.0
    width, height = np.ptp(np.concatenate([xy for o in made for xy in (o.map_xy, o.path_xy, o.tracked_xy)]), axis=0)
    return float(min(max(1.1 * height / max(width, 1.0), 0.2), 1.6))


def _posterior(axes: Axes, run: Run, lines: list[Any]) -> None:
    _shade(axes, run)
    axes.step(*stated_posterior(run), where="post", color=st.PLACE.colour, lw=st.PLACE.width, label=st.PLACE.name)
    for i, h in enumerate(lines):
        colour, label = (st.MUTED, "nothing matched") if h.null else (st.CYCLE[i % 8], f"hypothesis {h.id}")
        axes.plot(h.minutes, h.posterior, ".-", color=colour, lw=1.0, ms=3, label=label)
    axes.set(title="Posterior of place and hypotheses", xlabel="minutes since start", ylim=(-0.04, 1.04))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _overlay(axes: Axes, o: DiveOverlay) -> None:
    _plane(axes, f"Dive {o.dive}: {len(o.pairs)} pairs")
    if o.swept is not None:
        rows, columns = o.swept.scans.shape
        x, y = (corner + CELL * np.arange(n + 1) for corner, n in zip(o.swept.corner, (columns, rows), strict=True))
        axes.pcolormesh(x, y, o.swept.scans, cmap="Blues", vmin=0, vmax=60, rasterized=True)
    axes.plot(*o.path_xy.T, color=st.GLOBAL.colour, lw=1.0)
    for a, b in o.pairs:
        axes.plot(*np.stack([o.map_xy[a], o.tracked_xy[b]]).T, color=st.TARGET.colour, lw=1.4)
    axes.plot(*o.map_xy.T, "x", color=st.MUTED, ms=6, mew=1.2)
    if o.missed:
        axes.plot(*o.map_xy[list(o.missed)].T, "o", mfc="none", mec=st.DEADRECK.colour, ms=11, mew=1.4)
    if len(o.tracked_xy):
        axes.plot(*o.tracked_xy.T, "o", mfc="none", mec=st.TRACKED.colour, ms=6, mew=1.2)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, facecolor="white")


PICTURES: Final[dict[str, Callable[[Run, ErrorTracks, Path], None]]] = {
    "track_map.png": track_map,
    "errors.png": errors,
    "innovations.png": innovations,
    "matches.png": matches,
}
