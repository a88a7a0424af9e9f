"""A square-root filter against an information-form one, on the linearised windows of the tracker itself.

python -m fbn_testing.square_root_study --seeds 0:50 --figure square_root.png
python -m fbn_testing.square_root_study --seeds 0:50 --jobs 2 --keep square_root

Of each simulated mission (``depth_of_features``) one window of every length is taken as the tracker had linearised
it, whitened.  QR of that Jacobian and Cholesky of its information matrix are each done in double and in single
precision, with the sonar as precise as it is and more so; the truth is QR in extended precision.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from fbn_common.types import Array, nanoseconds
from fbn_testing.feature_runs import Heard, hear, tracker_of
from fbn_testing.gtsam_window import DRIFT, feature_key, graph_of, pose_key, values_of
from fbn_testing.seeds import How, add_options, run_seeds, seed_range
from fbn_testing.square_root import (
    Conditions,
    Errors,
    errors,
    information_condition,
    inverse,
    reference_corner,
    root_conditions,
)
from fbn_tracking.window import Window

console = Console(highlight=False, width=150)
LENGTHS = (15, 30, 60, 90)  # pings; the tracker's own windows are 15 to 90 long
PRECISIONS = (1.0, 10.0, 100.0, 1000.0)  # the sonar's sigmas of range and bearing over what they are
TYPES = {"double": np.float64, "single": np.float32}
WAYS = {"square root": True, "information": False}
UNCUT = {"composite.pings": 90, "composite.wait_pings": 90, "composite.window": 180}
BEGIN_S, LIMIT_S = 110.0, 205.0  # of the mission: features are in view from then on; the longest window is full by then
_OFF = 0.01  # of a variance: what is more than this off is of no use to a consistent filter


class System(NamedTuple):
    """A whitened Jacobian (m, n), the kept variables last, and which rows are the sonar's."""

    A: Array
    kept: int
    sonar: NDArray[np.bool_]  # (m,)


class Case(NamedTuple):
    """One window at one precision of the sonar, in one precision of arithmetic."""

    length: int
    precision: float
    arithmetic: str
    conditions: Conditions
    errors: dict[str, Errors]  # by way


class Mission(NamedTuple):
    """One seed: all its windows, and the time they took."""

    cases: list[Case]
    cpu_s: float


def examine_mission(seed: int) -> Mission:
    """Every window of one seed's mission, examined."""
    began = time.process_time()
    taken = windows(hear("depth_of_features", seed, {"mission.limit": LIMIT_S}))
    cases = [case for length, window in taken for case in examine(linearised(window), length)]
    return Mission(cases, time.process_time() - began)


def windows(heard: Heard) -> Iterator[tuple[int, Window]]:
    """The first window of each length in which features are tracked."""
    tracker, wanted = tracker_of(heard, UNCUT), set(LENGTHS)
    begin_ns = heard.steps[0].end_ns + nanoseconds(BEGIN_S)
    for step in (step for step in heard.steps if step.end_ns > begin_ns):
        for _, topic, record in step.logged:
            tracker.put(topic, record)
        tracker.advance(step.end_ns)
        window = tracker.window
        if window is not None and window.features and len(window.pings) in wanted:
            wanted.remove(len(window.pings))
            yield len(window.pings), window
        if not wanted:
            return


def linearised(window: Window) -> System:
    """The system a composite of the whole window is made of: base, P2, anchors, drift and features are kept."""
    ends = [window.first, window.last, *(t.anchor for t in window.features.values())]
    kept_poses = list(dict.fromkeys(ends))
    kept = [*map(pose_key, kept_poses), DRIFT, *map(feature_key, window.features)]
    ordering = gtsam.Ordering()
    for key in (*(pose_key(i) for i in window.pings if i not in kept_poses), *kept):
        ordering.push_back(key)
    A, _ = graph_of(window).linearize(values_of(window)).jacobian(ordering)
    rows = np.ascontiguousarray(A[np.any(A, axis=1)])
    features = 3 * len(window.features)
    return System(rows, 6 * len(kept_poses) + 3 + features, np.asarray(np.any(rows[:, -features:], axis=1)))


def examine(system: System, length: int) -> Iterator[Case]:
    """Every precision of the sonar, in every arithmetic, both ways."""
    for precision in PRECISIONS:
        A = np.where(system.sonar[:, None], precision, 1.0) * system.A
        truth, of_root = inverse(reference_corner(A, system.kept)), root_conditions(A)
        for name, dtype in TYPES.items():
            both = {way: errors(A, system.kept, truth, by_qr, dtype) for way, by_qr in WAYS.items()}
            yield Case(length, precision, name, Conditions(*of_root, information_condition(A, dtype)), both)


def table(cases: list[Case]) -> Table:
    """By length, precision and arithmetic: condition numbers, errors with their spread, failures."""
    made = Table(title="Marginal covariance of what a composite is made of", title_justify="left", box=None)
    numbers = ("cond R", "cond R, scaled", "cond RᵀR")
    found = [heading for way in WAYS for heading in (f"{way}: error", "worst", "failed", "> 1 %")]
    for column in ("pings", "sonar", "arithmetic", "windows", *numbers, *found):
        made.add_column(column, justify="right")
    for length, precision, arithmetic in sorted({(c.length, c.precision, c.arithmetic) for c in cases}):
        rows = [c for c in cases if (c.length, c.precision, c.arithmetic) == (length, precision, arithmetic)]
        made.add_row(
            str(length), f"1/{precision:.0f} σ", arithmetic, str(len(rows)),
            *(f"{np.median(values):.0e}" for values in zip(*(_numbers(c.conditions) for c in rows), strict=True)),
            *(cell for way in WAYS for cell in _cells([c.errors[way] for c in rows])),
        )  # fmt: skip
    return made


def _numbers(found: Conditions) -> tuple[float, float, float]:
    return found.root, found.root_scaled, found.information


def _cells(found: list[Errors]) -> tuple[str, str, str, str]:
    worst = [e.worst for e in found if not e.failed]
    median, most = (f"{np.median(worst):.0e}", f"{max(worst):.0e}") if worst else ("", "")
    return median, most, str(sum(e.failed for e in found)), str(sum(e.worst > _OFF for e in found if not e.failed))


def draw(cases: list[Case], target: Path) -> None:
    """Errors over the square root's condition number: one slope where QR is used, twice that where ``A^T A`` is."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(11, 4.2), sharey=True)
    for axis, arithmetic in zip(axes, TYPES, strict=True):
        rows = [c for c in cases if c.arithmetic == arithmetic]
        for way, marker, color in (("square root", "o", "#1f5fa8"), ("information", "s", "#b03a2e")):
            x = np.array([c.conditions.root for c in rows])
            y = np.array([c.errors[way].worst for c in rows])
            failed = np.isnan(y)
            axis.loglog(x[~failed], y[~failed], marker, ms=4, mfc="none", color=color, label=way)
            if failed.any():
                label = f"{way}: not positive definite ({failed.sum()})"
                axis.loglog(x[failed], np.full(failed.sum(), 1e4), "x", ms=5, color=color, label=label)
        axis.axhline(_OFF, color="#808080", ls=":")
        axis.set_title(f"{arithmetic} precision", loc="left", fontsize=10)
        axis.set_xlabel("condition number of the square root")
        axis.legend(fontsize=8, loc="upper left" if arithmetic == "double" else "lower right")
    axes[0].set_ylabel("worst relative error of a variance")
    figure.tight_layout()
    figure.savefig(target, dpi=120)
    pyplot.close(figure)


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:50", help="first:last, the last one excluded")
    parser.add_argument("--figure", type=Path, help="PNG: errors over condition numbers")
    add_options(parser)
    given = parser.parse_args()
    missions = run_seeds(examine_mission, seed_range(given.seeds), "missions", How(given.jobs, given.keep))
    cases = [case for m in missions for case in m.cases]
    console.print(table(cases))
    if given.figure:
        draw(cases, given.figure)
    console.print(f"[dim]{np.mean([m.cpu_s for m in missions]):.1f} s of CPU time a seed")


if __name__ == "__main__":
    main()
