"""The tracker's time: per ping and cut, its smoother beside gtsam's IncrementalFixedLagSmoother; flat over hours.

tools/run python benchmarks/tracking.py
tools/run python benchmarks/tracking.py --hours 3

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
from typing import Any

import gtsam
import numpy as np
from graph import calibration
from rich.console import Console
from rich.table import Table

from fbn_bringup.offline import Step
from fbn_common.records import CompositeMeasurement, PingMotion, SonarDetections, TrackedFeatures
from fbn_common.types import NS
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
from fbn_tracking.estimator import Tracking
from fbn_tracking.window import Window

console = Console(highlight=False, width=110)
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


def quantiles(name: str, seconds: list[float], made: Table) -> None:
    """A row of median, 95 % and worst [ms]."""
    made.add_row(name, str(len(seconds)), *(f"{1e3 * np.quantile(seconds, q):.1f}" for q in (0.5, 0.95, 1.0)))


def speed(rate: float, density: int, limit_s: float = 0.0) -> Table:
    """Times at a ping rate [Hz]; ``density`` times as many features as usual; the whole mission where no limit is."""
    rows = ("left_near", "right_near", "left_far", "right_far")
    changes = {"sensors.sonar.timing.rate": rate} | ({"mission.limit": limit_s} if limit_s else {})
    for row in rows:
        changes |= {f"world.rows.{row}.count": 5 * density, f"world.rows.{row}.step": (22.0 / density, 0.0)}
    heard = hear("depth_of_features", 1000, changes)
    gc.collect()
    gc.freeze()  # going through a whole mission in memory for garbage is no part of the tracker's work
    (plain,) = timed(heard)
    times = Times()
    with beside(times):
        list(timed(heard))
    scans = [r for r in chain(*(_records(s) for s in heard.steps)) if isinstance(r, SonarDetections)]
    echoes = sum(len(s.detections) for s in scans) / len({s.stamp_ns for s in scans})
    title = f"Tracker at {rate:.0f} Hz, {echoes:.1f} echoes a ping [ms of CPU time]"
    made = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for column in ("", "n", "median", "95 %", "worst"):
        made.add_column(column, justify="right" if column else "left")
    quantiles("a ping, all of it", plain.ping, made)
    quantiles("a ping with a cut", plain.cut, made)
    quantiles("smoother: our window", times.smoother, made)
    quantiles(f"smoother: fixed lag of {LAG_S:.0f} s ({times.failures} failures)", times.peer, made)
    return made


def _records(step: Step) -> list[PingMotion | SonarDetections]:
    return [record for _, _, record in step.logged]


def flat(hours: float) -> None:
    """Time and memory, mission after mission without a restart."""
    for number, times in enumerate(timed(hear("depth_of_features", 1000, {"sensors.sonar.timing.rate": 2.0}), hours)):
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        median, high = 1e3 * np.quantile(times.ping, [0.5, 0.95])
        console.print(f"mission {number + 1:3d}: ping {median:.2f} ms, 95 % {high:.2f} ms, most memory {memory:.0f} MB")


def main() -> int:
    """Print the tables, or the hours."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=0.0, help="run so long without a restart instead")
    given = parser.parse_args()
    loop = calibration()
    if given.hours:
        flat(given.hours)
    else:
        console.print(speed(2.0, 1), "", speed(4.0, 2), "")
    console.print(f"[dim]a fixed Python loop took {loop * 1e3:.0f} ms before and {calibration() * 1e3:.0f} ms after")
    return 0


if __name__ == "__main__":
    sys.exit(main())
