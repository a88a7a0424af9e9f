"""The reference filter on the acoustic ranges of a sea trial: outliers, and a beacon that lies.

python -m fbn_testing.sea_trial_study

The filter gets the trial's odometry as predicted motion at an assumed speed, and is held against a robust fit of the
whole trajectory (:mod:`fbn_testing.sea_trial`), good to a metre or so.  Some 16 s of CPU time in all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.series import Stamps
from fbn_bringup.ui import number, out, progress, table
from fbn_common import records as r
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.motion_ekf.parameters import CompassParameters, DepthParameters
from fbn_common.types import NS, Array, Quaternion
from fbn_reference.estimator import Reference
from fbn_reference.parameters import Beacon, LblParameters, MapParameters, ReferenceParameters
from fbn_testing.sea_trial import RANGE_SIGMA, WALK, Fit, Trial, fit, read

START_NS = 1_000 * NS
GRID_NS = 10_000_000
SPEED = 4.0  # m/s, assumed; brisk, so that a run is
SOUND = 1500.0  # m/s
HEADING = 0.08  # rad: how far the fit turns the chain's heading along the way
SIGMA = 1.5  # m: what the fit leaves over is 0.84 m by median, 1.25 m as a deviation, and correlated along the way
OUTLIER = 5.0  # m, more than six times that
BEACONS = ("L0", "L1", "L2", "L3")
STARTS = {"goats_15": (10.0,), "goats_16": (2.0, 10.0, 100.0, 1000.0)}  # m, to which the first position is known


def stamps(trial: Trial) -> Stamps:
    """Whole grid steps, at the assumed speed."""
    steps = np.maximum(np.ceil(np.hypot(*np.diff(trial.poses[:, :2], axis=0).T) / SPEED / 0.01), 10)
    return np.asarray(START_NS + GRID_NS * np.concatenate([[0], np.cumsum(steps)]), dtype=np.int64)


def upright(heading: float) -> Quaternion:
    """The attitude without roll and pitch."""
    return quaternion_from_matrix(matrix_from_rpy(np.array([0.0, 0.0, heading])))


def motions(trial: Trial, times: Stamps) -> Iterator[r.PredictedMotion]:
    """The chain's steps cut to the grid; what they are worth is in the noise, none of it in velocity or parameters."""
    by_velocity, by_rotation, by_parameters = (np.zeros((12, columns)) for columns in (6, 3, 15))
    noise = np.diag([WALK**2 * SPEED * 0.01] * 2 + [1e-8] + [1e-8, 1e-8, 1e-6] + [0.01] * 2 + [1e-6] * 4)
    for k, (a, b) in enumerate(zip(trial.poses[:-1], trial.poses[1:], strict=True)):
        count = int(times[k + 1] - times[k]) // GRID_NS
        turn = (b[2] - a[2] + np.pi) % (2.0 * np.pi) - np.pi
        for i in range(count):
            heading = a[2] + turn * i / count
            c, s = np.cos(heading), np.sin(heading)
            x, y = (b[:2] - a[:2]) / count
            increment = np.array([c * x + s * y, -s * x + c * y, 0.0])
            velocity = np.concatenate([increment / 0.01, [0.0, 0.0, turn / count / 0.01]])
            begin = int(times[k]) + i * GRID_NS
            yield r.PredictedMotion(
                begin + GRID_NS, begin, increment, np.array([0.0, 0.0, turn / count]), velocity, velocity,
                np.ones(15), by_velocity, by_rotation, by_parameters, noise, upright(heading),
            )  # fmt: skip


def measurements(trial: Trial, times: Stamps, turn: float) -> Iterator[tuple[int, str, r.Record]]:
    """Compass (the chain's heading, turned as the fit says at the start), depth 0, ranges with their travel time."""
    absent, none = np.diag([-1.0, 0.0, 0.0]), np.zeros(3)
    for stamp, pose in zip(times, trial.poses, strict=True):
        q = upright(pose[2] + turn)
        covariance = np.diag([1e-3, 1e-3, HEADING**2])
        yield int(stamp), "imu/data", r.Imu(int(stamp), "base_link", q, covariance, none, absent, none, absent)
        yield int(stamp), "pressure", r.FluidPressure(int(stamp), "base_link", 101325.0, 1e4)
    for k, beacon, distance in trial.ranges:
        delay = 2.0 * distance / SOUND
        heard = int(times[k]) + round(delay / 2.0 * NS)
        yield heard, "lbl/range", r.BeaconRange(heard, "base_link", beacon, distance, RANGE_SIGMA**2, delay)


@dataclass
class Outcome:
    """The filter's positions at the poses, its own standard deviations, and its answers to ranges by beacon."""

    error: Array  # (n,) m, against the fit
    sigma: Array  # (n,) m
    answers: list[r.Innovation]

    def verdicts(self, beacon: str) -> Counter[str]:
        """How many of the beacon's ranges came to which end."""
        return Counter(a.verdict.name for a in self.answers if a.sensor == f"lbl.{beacon}")

    @property
    def nis(self) -> float:
        """Mean over the ranges used."""
        used = [a.nis for a in self.answers if a.sensor.startswith("lbl") and a.verdict == r.Verdict.USED]
        return float(np.mean(used))


def run(trial: Trial, truth: Fit, start_sigma: float) -> Outcome:
    """The trial through the reference filter, started beside the fit's start by as much as it is told."""
    times = stamps(trial)
    beacons = {name: Beacon(float(xy[0]), float(xy[1]), 0.0, 0.5) for name, xy in trial.beacons.items()}
    start = truth.position[0] + start_sigma * np.array([0.6, -0.8])
    reference = Reference(
        ReferenceParameters(
            compass=CompassParameters(deviation=HEADING),
            depth=DepthParameters(frozen_after=0),  # of a made-up depth
            lbl=LblParameters(beacons=beacons, sigma_min=SIGMA),
            map=MapParameters(datum_given=True, start_x=start[0], start_y=start[1], start_sigma=start_sigma),
        )
    )
    prior = np.diag(np.concatenate([np.full(12, 1e-4), np.full(3, 1e-6)]))
    reference.put("predict/parameters", r.VehicleParameters(START_NS, "map", np.ones(15) * 0.1, prior))
    log = sorted(measurements(trial, times, float(truth.turn[0])), key=lambda entry: entry[0])
    moved, i = motions(trial, times), 0
    found: dict[int, r.Odometry] = {}
    answers: list[r.Innovation] = []
    for end in range(START_NS + NS // 5, int(times[-1]) + NS, NS // 5):
        for motion in moved:
            reference.put("predict/motion", motion)
            if motion.stamp_ns >= end:
                break
        while i < len(log) and log[i][0] <= end:
            reference.put(log[i][1], log[i][2])
            i += 1
        for _, record in reference.advance(end):
            if isinstance(record, r.Odometry):
                found[record.stamp_ns] = record
            elif isinstance(record, r.Innovation):
                answers.append(record)
    stamped = np.array(sorted(found))
    nearest = stamped[np.clip(np.searchsorted(stamped, times), 0, len(stamped) - 1)]
    poses = [found[int(s)] for s in nearest]
    position = np.array([o.pose.position[:2] for o in poses])
    sigma = np.array([np.sqrt(np.linalg.eigvalsh(o.pose_covariance[:2, :2])[-1]) for o in poses])
    return Outcome(np.hypot(*(position - truth.position).T), sigma, answers)


def outliers(trial: Trial, truth: Fit, beacon: str) -> float:
    """Share of the beacon's ranges that the fit does not explain."""
    mine = [abs(x) > OUTLIER for x, (_, b, _) in zip(truth.residual, trial.ranges, strict=True) if b == beacon]
    return float(np.mean(mine))


def main() -> None:
    """Run all trials and starts and print their table."""
    lines = [(name, sigma) for name, sigmas in STARTS.items() for sigma in sigmas]
    trials = {name: read(name) for name in STARTS}
    truths = {name: fit(trial) for name, trial in trials.items()}
    titles = ("start [m]", "median [m]", "90 %", "at the end", "sigma", "NIS", *BEACONS)
    shown = table("Ranges of a sea trial", "log", *(t.replace("[", "\\[") for t in titles))
    with progress("sea trial") as advance:
        for i, (name, sigma) in enumerate(lines):
            advance(i / len(lines), f"{name}, {sigma:g} m")
            trial, truth = trials[name], truths[name]
            shown.add_row(name, f"{sigma:g}", *_cells(trial, truth, run(trial, truth, sigma)))
    shown.caption = "each beacon: ranges used / refused, and the share more than 5 m off the fit"
    out.print(shown)


def _cells(trial: Trial, truth: Fit, o: Outcome) -> tuple[str, ...]:
    """Errors, what was stated of them, NIS of the ranges used, and each beacon."""
    values = (*np.percentile(o.error, [50, 90]), o.error[-1], np.median(o.sigma), o.nis)
    told = (_told(trial, truth, o, name) if name in trial.beacons else "" for name in BEACONS)
    return *(number(float(v), 1) for v in values), *told


def _told(trial: Trial, truth: Fit, o: Outcome, beacon: str) -> str:
    verdicts = o.verdicts(beacon)
    refused = verdicts.total() - verdicts["USED"]
    return f"{verdicts['USED']} / {refused} ({outliers(trial, truth, beacon):.0%})"


if __name__ == "__main__":
    main()
