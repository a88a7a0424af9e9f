"""How well position holds without GPS: a log's last fixes are kept from the estimators, and are the truth.

Definitions (docs/concepts.md, "What an error is"):

error
    The antenna's position by ``reference/odometry`` less the withheld fix, horizontally.  It contains the error of
    the fix itself (metres).
distance
    The way between the fixes of the withheld part, at 1/5 Hz, so that their jitter does not add to it.
NEES
    ``e^T (P + R)^-1 e`` with the filter's and the fix's covariance; 2 is expected of its mean over missions.  Errors of
    one mission are correlated, so a single one says little.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fbn_bringup.configuration import load_parameters
from fbn_bringup.evaluation.consistency import nees
from fbn_bringup.evaluation.run import Item, RunError
from fbn_bringup.evaluation.series import Stamps, Track, every, track
from fbn_bringup.offline import run_offline
from fbn_common import records as r
from fbn_common.geodesy import GeodeticPoint, enu_from_geodetic
from fbn_common.graph import GRAPH
from fbn_common.types import NS, Array

NODES = ("fbn_predict", "fbn_deadreck", "fbn_reference")
FIXES = "gps/fix"
STILL_WATER = {"fbn_predict.doubt.water": [1e-6, 1e-6, 1e-6], "fbn_reference.walk.water": 0.0}
_WAY_PERIOD_NS = 5 * NS


@dataclass(frozen=True, slots=True, eq=False)
class Withheld:
    """One mission's estimate over the part without GPS; arrays (n,) are by withheld fix."""

    seconds: float  # since the last fix that was given
    distance: float  # m
    stamp_ns: Stamps
    error: Array  # (n, 2) m, estimate less fix, east and north
    nees: Array
    water: Array  # (2,) m/s, the last estimate, towards east and north
    water_sigma: Array

    @property
    def final(self) -> float:
        """Horizontal error at the end [m]."""
        return float(np.hypot(*self.error[-1]))

    @property
    def mean(self) -> float:
        """Mean horizontal error over the part [m]."""
        return float(np.hypot(self.error[:, 0], self.error[:, 1]).mean())

    @property
    def final_percent(self) -> float:
        """Error at the end, in % of the distance."""
        return 100.0 * self.final / self.distance

    @property
    def mean_percent(self) -> float:
        """Mean error, in % of the distance."""
        return 100.0 * self.mean / self.distance


def withhold(log: Sequence[Item], files: Sequence[Path], overrides: Mapping[str, Any], share: float = 0.4) -> Withheld:
    """Run the estimators on a log of which the fixes after the first ``share`` of the time are withheld.

    Raises RunError for a log that such a run says nothing of, ParameterError for unknown parameters.
    """
    fixes = [x for _, topic, x in log if topic == FIXES and isinstance(x, r.NavSatFix) and x.status >= 0]
    if not 0.0 < share < 1.0:
        raise RunError(f"the share of the time with GPS must lie between 0 and 1, got {share}")
    if len(fixes) < 20:
        raise RunError(f"{len(fixes)} good fixes are too few to withhold some: GPS is needed throughout")
    cut_ns = fixes[0].stamp_ns + round(share * (fixes[-1].stamp_ns - fixes[0].stamp_ns))
    given = (item for item in log if not (item[1] == FIXES and item[2].stamp_ns > cut_ns))
    parameters = load_parameters(GRAPH.only(NODES), files, overrides)
    outputs = _run(parameters, given)
    kept = [f for f in fixes if f.stamp_ns > cut_ns]
    return _judge(outputs, kept, np.array(parameters["fbn_reference"].gps.position), cut_ns)


def _run(parameters: dict[str, Any], log: Iterable[Item]) -> dict[str, list[r.Record]]:
    wanted = ("reference/odometry", "reference/datum", "reference/parameters")
    outputs: dict[str, list[r.Record]] = {topic: [] for topic in wanted}

    def sink(_: int, topic: str, record: r.Record) -> None:
        if topic in outputs:
            outputs[topic].append(record)

    run_offline(GRAPH.only(NODES), parameters, log, sink)
    if not outputs["reference/datum"]:
        raise RunError("the reference filter never took a fix: run `fbn check` on the log")
    return outputs


def _judge(outputs: dict[str, list[r.Record]], fixes: list[r.NavSatFix], antenna: Array, cut_ns: int) -> Withheld:
    """Errors of the estimate against the withheld fixes."""
    estimate: Track = track(outputs["reference/odometry"])  # type: ignore[arg-type]
    datum = outputs["reference/datum"][-1]
    assert isinstance(datum, r.Datum)
    point = GeodeticPoint(datum.latitude, datum.longitude, datum.height)
    fixes = [f for f in fixes if estimate.stamp_ns[0] <= f.stamp_ns <= estimate.stamp_ns[-1]]
    if len(fixes) < 2:
        raise RunError("the estimate ends before the withheld fixes: run `fbn check` on the log")
    stamps = np.array([f.stamp_ns for f in fixes], dtype=np.int64)
    true = np.array([enu_from_geodetic(f.latitude, f.longitude, datum.height, point)[:2] for f in fixes])
    at = estimate.at(stamps)
    error = (at.position + at.rotation.apply(antenna))[:, :2] - true
    covariance = at.covariance[:, :2, :2] + np.array([f.position_covariance[:2, :2] for f in fixes])
    steps = np.diff(true[every(stamps, _WAY_PERIOD_NS)], axis=0)
    water, sigma = _water(outputs["reference/parameters"])
    way = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    return Withheld((int(stamps[-1]) - cut_ns) / NS, way, stamps, error, nees(error, covariance), water, sigma)


def _water(parameters: list[r.Record]) -> tuple[Array, Array]:
    """The last estimate of the water velocity (2,) [m/s] and its standard deviations; NaN without one."""
    if not parameters:
        return np.full(2, np.nan), np.full(2, np.nan)
    last = parameters[-1]
    assert isinstance(last, r.VehicleParameters)
    return last.mean[12:14], np.sqrt(np.diag(last.covariance)[12:14])
