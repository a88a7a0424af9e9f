"""The tracker's time: per ping and cut, its smoother beside gtsam's IncrementalFixedLagSmoother; flat over hours.

tools/run python benchmarks/tracking.py
tools/run python benchmarks/tracking.py --seeds 0:50
tools/run python benchmarks/tracking.py --hours 3 --figure hours.png

How well it finds what is there: ``python -m fbn_testing.feature_study``.
"""

from __future__ import annotations

import argparse
import gc
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np
from graph import calibration
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from fbn_bringup.offline import Step
from fbn_common.records import CompositeMeasurement, PingMotion, SonarDetections, TrackedFeatures
from fbn_common.types import NS, Array
from fbn_testing.feature_runs import Heard, hear
from fbn_testing.gtsam_window import (
    DRIFT,
    base_factors,
    chain_factors,
    feature_key,
    pose_key,
    track_factor,
    values_of,
)
from fbn_testing.seeds import seed_range
from fbn_tracking.estimator import Tracking
from fbn_tracking.window import Window

console = Console(highlight=False, width=120)
errors = Console(stderr=True)
SHORT_S = 200.0  # of the mission, where it is one benchmark among others
LAG_S = 30.0  # of the fixed-lag smoother: an infant's ten seconds and its feature's stay


@dataclass
class Times:
    """Seconds of CPU time."""

    ping: list[float] = field(default_factory=list)  # everything that a ping takes, without cuts
    cut: list[float] = field(default_factory=list)  # a ping at whose end the window was cut
    smoother: list[float] = field(default_factory=list)  # our update alone
    peer: list[float] = field(default_factory=list)  # the fixed-lag smoother's, on the same factors
    failures: int = 0  # of the peer
    tracker: Tracking | None = None


class Peer:
    """gtsam's fixed-lag smoother, given the measurements of our windows as they come; anchors are kept alive."""

    def __init__(self, times: Times) -> None:
        self.times = times
        self.window: Window | None = None
        self.smoother = gtsam.IncrementalFixedLagSmoother(LAG_S)
        self.known: set[tuple[int, int, str]] = set()  # detections given: feature, ping, array
        self.last = -1

    def update(self, window: Window) -> None:
        """What is new in the window; the first of a window starts anew and is not timed."""
        begins = window is not self.window
        if begins:
            self.window, self.last, self.known = window, window.first, set()
            self.smoother = gtsam.IncrementalFixedLagSmoother(LAG_S)
        factors, values = self._new(window, begins)
        now = window.pings[window.last].stamp_ns / NS
        stamps = dict.fromkeys(values.keys(), now)
        for i in range(factors.size()):
            stamps |= dict.fromkeys(factors.at(i).keys(), now)
        dated = gtsam.FixedLagSmootherKeyTimestampMap()
        for pair in stamps.items():
            dated.insert(pair)
        began = time.thread_time()
        try:
            self.smoother.update(factors, values, dated)
            self.smoother.calculateEstimate()
        except (RuntimeError, IndexError):
            self.times.failures += 1
            self.window = None
            return
        if not begins:
            self.times.peer.append(time.thread_time() - began)

    def _new(self, window: Window, begins: bool) -> tuple[Any, gtsam.Values]:
        factors, values, ours = gtsam.NonlinearFactorGraph(), gtsam.Values(), values_of(window)
        pings = list(window.pings.values())
        added = [p for p in pings if p.index > self.last]
        for factor in (*(base_factors(window.base, pings[0]) if begins else ()), *chain_factors(added)):
            factors.add(factor)
        keys = [pose_key(p.index) for p in (pings if begins else added)] + [DRIFT] * begins
        for track in window.features.values():
            known = {k for k in self.known if k[0] == track.key}
            keys += [] if known else [feature_key(track.key)]
            for d in track.detections:
                name = (track.key, d.index, d.look.array)
                if name not in known:
                    self.known.add(name)
                    factors.add(track_factor(track, d, window.weak_theta_sigma))
        for key in keys:
            values.insert(key, ours.atPose3(key) if gtsam.symbolChr(key) == ord("x") else ours.atPoint3(key))
        self.last = window.last
        return factors, values


@contextmanager
def beside(times: Times) -> Iterator[None]:
    """While this lasts, every window's smoother is timed and has the peer beside it."""
    peer, own = Peer(times), Window.update

    def update(window: Window) -> None:
        began = time.thread_time()
        own(window)
        times.smoother.append(time.thread_time() - began)
        peer.update(window)

    Window.update = update  # type: ignore[method-assign]
    try:
        yield
    finally:
        Window.update = own  # type: ignore[method-assign]


def timed(heard: Heard, hours: float = 0.0) -> Iterator[Times]:
    """The tracker on a mission, over and over for so many hours of its time (once for 0); times of each round."""
    tracker = Tracking()
    span = heard.steps[-1].end_ns - heard.steps[0].end_ns + NS
    for round_ in range(max(1, int(hours * 3600.0 * NS / span))):
        times = Times(tracker=tracker)
        for step in heard.steps:
            shift = round_ * span
            for _, topic, record in step.logged:
                tracker.put(topic, shifted(record, shift))
            began = time.thread_time()
            records = [output.record for output in tracker.advance(step.end_ns + shift)]
            took = time.thread_time() - began
            if any(isinstance(r, CompositeMeasurement) for r in records):
                times.cut.append(took)
            elif any(isinstance(r, TrackedFeatures) for r in records):
                times.ping.append(took)
        yield times


def shifted(record: PingMotion | SonarDetections, by_ns: int) -> PingMotion | SonarDetections:
    """The record as of a later time."""
    if isinstance(record, PingMotion):
        return replace(record, stamp_ns=record.stamp_ns + by_ns, previous_ns=record.previous_ns + by_ns)
    return replace(record, stamp_ns=record.stamp_ns + by_ns)


ROWS = {
    "a ping, all of it": lambda plain, beside: plain.ping,
    "a ping with a cut": lambda plain, beside: plain.cut,
    "smoother: our window": lambda plain, beside: beside.smoother,
    f"smoother: gtsam's fixed lag of {LAG_S:.0f} s": lambda plain, beside: beside.peer,
}


class Mission(NamedTuple):
    """One mission's times: the tracker alone, and with the peer beside its smoother."""

    plain: Times
    beside: Times
    echoes: float  # a ping


def fly(rate: float, density: int, seed: int, limit_s: float = 0.0) -> Mission:
    """A mission at a ping rate [Hz]; ``density`` times as many features as usual; all of it where no limit is."""
    rows = ("left_near", "right_near", "left_far", "right_far")
    changes = {"sensors.sonar.timing.rate": rate} | ({"mission.limit": limit_s} if limit_s else {})
    for row in rows:
        changes |= {f"world.rows.{row}.count": 5 * density, f"world.rows.{row}.step": (22.0 / density, 0.0)}
    heard = hear("depth_of_features", seed, changes)
    gc.collect()
    gc.freeze()  # going through a whole mission in memory for garbage is no part of the tracker's work
    (plain,) = timed(heard)
    times = Times()
    with beside(times):
        list(timed(heard))
    gc.unfreeze()
    scans = [r for r in chain(*(_records(s) for s in heard.steps)) if isinstance(r, SonarDetections)]
    return Mission(plain, times, sum(len(s.detections) for s in scans) / len({s.stamp_ns for s in scans}))


def speed(rate: float, density: int, limit_s: float = 0.0) -> Table:
    """Times of the mission of seed 1000: a row for each kind of work."""
    mission = fly(rate, density, 1000, limit_s)
    title = f"Tracker at {rate:.0f} Hz, {mission.echoes:.1f} echoes a ping [ms of CPU time]"
    made = _table(title, "", "n", "median", "95 %", "worst")
    for name, of in ROWS.items():
        seconds = of(mission.plain, mission.beside)
        made.add_row(name, str(len(seconds)), *(f"{1e3 * np.quantile(seconds, q):.1f}" for q in (0.5, 0.95, 1.0)))
    made.add_row("fixed lag: failures", str(mission.beside.failures))
    return made


def speed_over(rate: float, density: int, seeds: range, limit_s: float) -> Table:
    """The same over seeds: of each seed's median, 95 % and worst the median, and the range of nine seeds in ten."""
    missions = [fly(rate, density, seed, limit_s) for seed in progress(seeds, f"{rate:.0f} Hz", console=errors)]
    echoes = np.mean([m.echoes for m in missions])
    title = f"Tracker at {rate:.0f} Hz, {echoes:.1f} echoes a ping, {len(seeds)} seeds [ms of CPU time]"
    made = _table(title, "", "median", "5 to 95 % of seeds", "95 %", "5 to 95 % of seeds", "worst", "worst of all")
    for name, of in ROWS.items():
        seconds = [of(m.plain, m.beside) for m in missions]
        middle, high, worst = (np.array([1e3 * np.quantile(s, q) for s in seconds if s]) for q in (0.5, 0.95, 1.0))
        cells = (_spread(middle), _spread(high), (f"{np.median(worst):.1f}", f"{worst.max():.1f}"))
        made.add_row(name, *chain(*cells))
    made.add_row("fixed lag: failures", str(sum(m.beside.failures for m in missions)))
    return made


def _spread(values: Array) -> tuple[str, str]:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:.1f}", f"{low:.1f} to {high:.1f}"


def _table(title: str, *columns: str) -> Table:
    made = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for column in columns:
        made.add_column(column, justify="right" if column else "left")
    return made


def _records(step: Step) -> list[PingMotion | SonarDetections]:
    return [record for _, _, record in step.logged]


class Round(NamedTuple):
    """One mission of many without a restart."""

    hours: float  # of the tracker's time, at its end
    ping: tuple[float, float, float]  # ms: median, 95 %, worst
    memory: float  # MB, resident


def flat(hours: float, target: Path | None) -> None:
    """Time and memory, mission after mission without a restart."""
    heard = hear("depth_of_features", 1000, {"sensors.sonar.timing.rate": 2.0})
    span = (heard.steps[-1].end_ns - heard.steps[0].end_ns) / NS / 3600.0
    gc.collect()
    gc.freeze()
    rounds = []
    for number, times in enumerate(timed(heard, hours)):
        low, high, worst = (1e3 * float(q) for q in np.quantile(times.ping, [0.5, 0.95, 1.0]))
        rounds.append(Round((number + 1) * span, (low, high, worst), resident()))
    console.print(hour_table(rounds))
    if target:
        draw(rounds, target)


def resident() -> float:
    """Memory of this process now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def hour_table(rounds: list[Round]) -> Table:
    """One row for the rounds of each half hour."""
    title = "Pings and memory over hours without a restart [ms of CPU time, MB]"
    made = _table(title, "hours", "rounds", "median", "95 %", "worst", "memory")
    for half in sorted({int(2.0 * r.hours) for r in rounds}):
        some = [r for r in rounds if int(2.0 * r.hours) == half]
        low, high, worst = np.array([r.ping for r in some]).T
        cells = (f"{np.median(low):.2f}", f"{np.median(high):.2f}", f"{worst.max():.1f}", f"{some[-1].memory:.0f}")
        made.add_row(f"{0.5 * half:.1f} to {0.5 * half + 0.5:.1f}", str(len(some)), *cells)
    return made


def draw(rounds: list[Round], target: Path) -> None:
    """Milliseconds a ping, and memory, over hours."""
    from matplotlib import pyplot

    figure, (above, below) = pyplot.subplots(2, 1, figsize=(8, 4.6), sharex=True)
    hours = [r.hours for r in rounds]
    for n, (label, color) in enumerate((("median", "#1f5fa8"), ("95 %", "#b03a2e"))):
        above.plot(hours, [r.ping[n] for r in rounds], "o-", ms=3, color=color, label=label)
    above.set_ylabel("a ping [ms of CPU]")
    above.legend(fontsize=8)
    below.plot(hours, [r.memory for r in rounds], "o-", ms=3, color="#404040")
    below.set_ylabel("memory [MB]")
    below.set_xlabel("hours of pings at 2 Hz")
    for axis in (above, below):
        axis.set_ylim(0.0, 1.15 * axis.get_ylim()[1])
        axis.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(target, dpi=120)
    pyplot.close(figure)


def main() -> int:
    """Print the tables, or the hours."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=0.0, help="run so long without a restart instead")
    parser.add_argument("--seeds", help="first:last, the last one excluded: the spread over seeds instead")
    parser.add_argument("--limit", type=float, default=0.0, help="only so many seconds of each mission")
    parser.add_argument("--figure", type=Path, help="PNG of the hours")
    given = parser.parse_args()
    loop = calibration()
    if given.hours:
        flat(given.hours, given.figure)
    elif given.seeds:
        seeds = seed_range(given.seeds)
        for rate, density in ((2.0, 1), (4.0, 2)):
            console.print(speed_over(rate, density, seeds, given.limit), "")
    else:
        console.print(speed(2.0, 1, given.limit), "", speed(4.0, 2, given.limit), "")
    console.print(f"[dim]a fixed Python loop took {loop * 1e3:.0f} ms before and {calibration() * 1e3:.0f} ms after")
    return 0


if __name__ == "__main__":
    sys.exit(main())
