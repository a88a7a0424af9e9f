"""The figure of ``fbn design``: observability over speed, and a target's passage over altitude."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fbn_bringup.design.case import Case, terms
from fbn_bringup.design.passage import passage
from fbn_bringup.report import style as st
from fbn_bringup.report.paper import RC

_LEAST: Final = 1e-3  # of a threshold: below it a term is of no account


def draw(case: Case, offset: float, path: Path) -> None:
    """Write the PNG: what of each term is over its threshold by speed; detections and sigmas by altitude."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(10.5, 4.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        _over_speed(left, case)
        _over_altitude(right, case, offset)
        figure.suptitle(f"{case.vehicle} with {case.sonar}, {case.ping_rate:g} Hz")
        figure.savefig(path)


def _over_speed(axes: Axes, case: Case) -> None:
    speeds = np.linspace(0.1, max(2.5, 1.2 * case.speed), 60)
    rows = [[t.value / t.threshold for t in terms(replace(case, speed=float(v)))] for v in speeds]
    for i, (values, colour) in enumerate(zip(np.array(rows).T, st.CYCLE, strict=True)):
        axes.plot(speeds, np.maximum(values, _LEAST), color=colour, lw=1.4, label=f"N{i + 1}")
    axes.axhline(1.0, color=st.INK, lw=0.8, ls="--")
    axes.axvline(case.speed, color=st.MUTED, lw=0.8, ls=":")
    axes.set(title="seen from ping to ping: over 1", xlabel="speed [m/s]", ylabel="over the detector's threshold")
    axes.set(yscale="log", xlim=(0.0, speeds[-1]))
    axes.legend(ncols=4, loc="lower right")


def _over_altitude(axes: Axes, case: Case, offset: float) -> None:
    altitudes = np.linspace(0.3, case.water_depth - 0.3, 40)
    made = [passage(replace(case, vehicle_depth=case.water_depth - float(a)), offset) for a in altitudes]
    axes.plot(altitudes, [p.detections for p in made], color=st.GLOBAL.colour, lw=1.6, label="detections")
    axes.axhline(case.infant.detections, color=st.GLOBAL.colour, lw=0.8, ls="--", label="needed")
    axes.axvline(case.water_depth - case.vehicle_depth, color=st.MUTED, lw=0.8, ls=":")
    axes.set(title=f"a target {offset:g} m to the side", xlabel="altitude [m]", ylabel="detections a passage")
    axes.set_ylim(bottom=0.0)
    other = axes.twinx()
    other.plot(altitudes, [_drawn(p.sigma_horizontal) for p in made], color=st.REFERENCE.colour, label="σ horizontal")
    other.plot(altitudes, [_drawn(p.sigma_vertical) for p in made], color=st.TARGET.colour, label="σ depth")
    other.set(ylabel="σ [m]", yscale="log")
    handles = [*axes.get_legend_handles_labels()[0], *other.get_legend_handles_labels()[0]]
    axes.legend(handles=handles, loc="upper right")


def _drawn(sigma: float) -> float:
    return sigma if np.isfinite(sigma) else float("nan")
