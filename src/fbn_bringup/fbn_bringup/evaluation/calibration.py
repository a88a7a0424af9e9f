"""Reliability of stated probabilities: of all the times that p is said, how many are right; table and diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import beta

Stated = Sequence[tuple[float, bool]]  # a probability, and whether it was so
EDGES = (0.01, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True, slots=True)
class Bin:
    """Probabilities stated in one interval: their number and mean, and what share was right, with a 95 % bound."""

    count: int
    stated: float
    right: float
    low: float
    high: float

    @property
    def honest(self) -> bool:
        """Whether what was stated lies within the bound (its samples taken as independent)."""
        return self.low <= self.stated <= self.high


def bins(stated: Stated, edges: Sequence[float] = EDGES) -> list[Bin]:
    """The bins that hold something; bounds by Clopper and Pearson (1934)."""
    p, right = (np.array(column) for column in zip(*stated, strict=True)) if len(stated) else (np.zeros(0), np.zeros(0))
    made = []
    for low, high in pairwise(edges):
        inside = (p >= low) & ((p < high) | (high == edges[-1]))
        n, k = int(inside.sum()), int(right[inside].sum())
        if n:
            bound = (beta.ppf(0.025, k, n - k + 1) if k else 0.0, beta.ppf(0.975, k + 1, n - k) if k < n else 1.0)
            made.append(Bin(n, float(p[inside].mean()), k / n, float(bound[0]), float(bound[1])))
    return made


def expected_error(stated: Stated) -> float:
    """Mean of how far each bin's rate of right ones lies from what was stated, by its number of statements."""
    made = bins(stated)
    total = sum(b.count for b in made)
    return sum(b.count * abs(b.right - b.stated) for b in made) / total if total else 0.0


def table(stated: Stated) -> list[str]:
    """The bins as lines of text."""
    lines = ["    stated    right   95 % bound        of"]
    for b in bins(stated):
        mark = "" if b.honest else "  outside"
        lines.append(f"    {b.stated:6.3f}   {b.right:6.3f}   {b.low:.3f} to {b.high:.3f}   {b.count:5d}{mark}")
    return lines


def diagram(path: Path, series: dict[str, Stated]) -> None:
    """A reliability diagram (PNG) of several series, and how often each probability was stated."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure = Figure(figsize=(5.4, 6.0), dpi=150, layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    above.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="as good as it says")
    for k, (name, stated) in enumerate(series.items()):
        made = bins(stated)
        x, y = [b.stated for b in made], [b.right for b in made]
        reach = np.array([[max(b.right - b.low, 0.0), max(b.high - b.right, 0.0)] for b in made]).T
        above.errorbar(x, y, reach, fmt="o-", markersize=4, linewidth=1, capsize=2, color=f"C{k}", label=name)
        below.plot(x, [b.count for b in made], "o-", markersize=3, linewidth=1, color=f"C{k}")
    above.set(ylabel="fraction right", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
    above.legend(frameon=False, loc="upper left")
    below.set(xlabel="posterior stated", ylabel="times stated", yscale="log")
    below.yaxis.set_minor_formatter(NullFormatter())
    for axes in (above, below):
        axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
