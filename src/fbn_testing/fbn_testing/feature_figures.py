"""Pictures of the tracker's work, after figure 4 of the tracking paper (IROS 2007), from our own runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fbn_common.records import CompositeMeasurement
from fbn_common.types import Array
from fbn_testing.feature_runs import Outcome

_BLUE, _GREY, _RED = "#1f5fa8", "#808080", "#b03a2e"
_CIRCLE = np.array([np.cos(np.linspace(0.0, 2.0 * np.pi, 61)), np.sin(np.linspace(0.0, 2.0 * np.pi, 61))])


class Section(NamedTuple):
    """A mission's features, to be seen from the side."""

    name: str
    outcome: Outcome


def draw_sections(sections: list[Section], target: Path) -> None:
    """Vertical sections along x: the path, the true features, and the estimates with their one-sigma ellipses."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(sections), 1, figsize=(10, 2.6 * len(sections)), sharex=True, squeeze=False)
    for section, axis in zip(sections, axes[:, 0], strict=True):
        _section(axis, section)
    axes[-1, 0].set_xlabel("x, east [m]")
    axes[0, 0].legend(loc="upper right", fontsize=8, ncols=4)
    figure.tight_layout()
    figure.savefig(target, dpi=120)
    pyplot.close(figure)


def _section(axis: Any, section: Section) -> None:
    simulation = section.outcome.heard.simulation
    motion, features = simulation.truth.motion, simulation.truth.features.positions
    under = motion.surface > 0.3
    axis.plot(motion.position[under, 0], motion.position[under, 2], color=_RED, lw=1.2, label="vehicle")
    axis.axhline(-simulation.scenario.world.depth, color=_GREY, ls=":", label="bed")
    axis.scatter(features[:, 0], features[:, 2], marker="x", s=28, color="black", label="true features", zorder=3)
    for number, (xyz, covariance) in enumerate(_latest(section.outcome)):
        ellipse = np.linalg.cholesky(covariance[np.ix_([0, 2], [0, 2])]) @ _CIRCLE
        axis.plot(xyz[0] + ellipse[0], xyz[2] + ellipse[1], color=_BLUE, lw=1.0, alpha=0.8)
        axis.plot(xyz[0], xyz[2], ".", color=_BLUE, label="estimates, 1σ" if number == 0 else None)
    axis.set_xlim(features[:, 0].min() - 30.0, features[:, 0].max() + 30.0)
    axis.set_ylim(-simulation.scenario.world.depth - 3.0, 2.5)
    axis.set_ylabel("z, up [m]")
    axis.set_title(section.name, loc="left", fontsize=10)


def _latest(outcome: Outcome) -> list[tuple[Array, Array]]:
    """The last word on each feature: place [m, map] and covariance (3, 3)."""
    last: dict[int, tuple[CompositeMeasurement, int]] = {}
    for c in outcome.composites:
        last |= {f.key: (c, number) for number, f in enumerate(c.features)}
    out = []
    for c, number in last.values():
        at = slice(10 + 3 * number, 13 + 3 * number)
        base = outcome.heard.simulation.truth.at(c.start_ns).position[0]
        out.append((c.mean[at] + np.array([*base[:2], 0.0]), c.covariance[at, at]))
    return out
