"""Time of an update of the global filter against map size and hypotheses; JCBB beside a plain one.

tools/run python benchmarks/matching.py --figure matching.png
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fbn_global.estimator import Global
from fbn_global.jcbb import jcbb
from fbn_global.parameters import BankParameters, GlobalParameters
from fbn_testing.composite_world import World
from fbn_testing.matching_worlds import lattice_world
from fbn_testing.plain_jcbb import PlainJcbb, crossing

SIZES = (12, 100, 1000, 5000)
HYPOTHESES = (1, 5, 20)


@dataclass(frozen=True, slots=True)
class Update:
    """Thread times [s] of the updates of one run, and how many hypotheses were alive beside the null, by median."""

    features: int
    allowed: int
    alive: int
    median: float
    worst: float


@dataclass(frozen=True, slots=True)
class Contest:
    """One size of problem: nodes searched, and thread times [s] by median over the seeds."""

    features: int
    sigma: float
    nodes: int
    ours: float
    plain: float

    @property
    def ratio(self) -> float:
        """How many times as long the plain one takes."""
        return self.plain / self.ours


def updates(sizes: tuple[int, ...] = SIZES, hypotheses: tuple[int, ...] = HYPOTHESES) -> list[Update]:
    """Runs over like rows, whose map may lie off by several rows: as many hypotheses live as are allowed."""
    made = []
    for features in sizes:
        run = World(lattice_world(1, features)).make()
        for allowed in hypotheses:
            bank = replace(BankParameters(), hypotheses=allowed, keep_log_ratio=1e3)
            estimator = Global(GlobalParameters(bank=bank), run.prior)
            seconds, alive = [], []
            for topic, record in run.entries:
                estimator.put(topic, record)
                began = time.thread_time()
                estimator.advance(record.stamp_ns)
                if topic == "tracking/composite":
                    seconds.append(time.thread_time() - began)
                    alive.append(int(estimator.health().values["hypotheses"]) - 1)
            made.append(Update(features, allowed, int(np.max(alive)), float(np.median(seconds)), max(seconds)))
    return made


def contests(seeds: range = range(5)) -> list[Contest]:
    """The compiled branch and bound against the plain one on the same inputs, ten found features."""
    noise, made = 0.25 * np.eye(2), []
    jcbb(*crossing(0, 10, 20, 1.0)[:2], 10, crossing(0, 10, 20, 1.0)[2], noise, 2, 1000)  # compiled
    for maps in (20, 100, 1000):
        for sigma in (1.0, 3.0, 5.0):
            rows = [_contest(seed, maps, sigma, noise) for seed in seeds]
            nodes, ours, plain = np.median(np.array(rows), axis=0)
            made.append(Contest(maps, sigma, int(nodes), float(ours), float(plain)))
    return made


def _contest(seed: int, maps: int, sigma: float, noise: np.ndarray) -> tuple[float, float, float]:  # type: ignore[type-arg]
    x, p, gate = crossing(seed, 10, maps, sigma)
    began = time.perf_counter()
    for _ in range(10):
        result = jcbb(x, p, 10, gate, noise, 2, 1_000_000)
    ours = (time.perf_counter() - began) / 10
    search = PlainJcbb(x, p, 10, gate, noise, 2)
    began = time.perf_counter()
    search.search([], 0, 0.0)
    plain = time.perf_counter() - began
    assert list(result.assigned) == search.best
    return result.nodes, ours, plain


def figure(path: Path, rows: list[Update], contested: list[Contest]) -> None:
    """How the time of an update grows with the map and the hypotheses, and JCBB's with what it searches (PNG)."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    drawn = Figure(figsize=(9.6, 4.0), dpi=150, layout="constrained")
    left, right = drawn.subplots(1, 2)
    for k, allowed in enumerate(sorted({r.allowed for r in rows})):
        own = [r for r in rows if r.allowed == allowed]
        x = [r.features for r in own]
        left.plot(x, [r.median for r in own], "o-", color=f"C{k}", markersize=4, label=f"at most {allowed}, median")
        left.plot(x, [r.worst for r in own], ":", color=f"C{k}", label="worst")
    left.set(xscale="log", yscale="log", xlabel="features on the map", ylabel="thread time of an update [s]")
    for name, values, mark in (
        ("compiled", [c.ours for c in contested], "o"), ("plain", [c.plain for c in contested], "s")
    ):  # fmt: skip
        right.plot([c.nodes for c in contested], values, mark, markersize=4, label=name)
    right.set(xscale="log", yscale="log", xlabel="nodes searched", ylabel="JCBB, ten found features [s]")
    right.xaxis.set_minor_formatter(NullFormatter())
    left.set_title("an update, by hypotheses alive", fontsize=9)
    for axes in (left, right):
        axes.grid(alpha=0.3, which="both")
        axes.legend(frameon=False, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    rows = []
    for size in SIZES:
        for r in updates((size,)):
            rows.append(r)
            told = f"{r.features:5d} features, {r.alive:2d} hypotheses: median {r.median:.3f} s, worst {r.worst:.3f} s"
            print(told, flush=True)
    contested = contests()
    for c in contested:
        where = f"JCBB, {c.features:4d} features, pose known to {c.sigma:.0f} m: {c.nodes:5d} nodes"
        print(f"{where}  {1e3 * c.ours:.3f} ms, plain {c.ratio:.0f} times as long")
    if given.figure:
        figure(given.figure, rows, contested)


if __name__ == "__main__":
    main()
