"""Acoustic ranges of a sea trial (GOATS 2002, as gtsam carries it): outliers, and a beacon that lies.

The files hold odometry as chained poses, beacons and ranges, no times and no truth.  The reference filter gets the
odometry as predicted motion at an assumed speed, and is held against an independent computation: a robust
least-squares fit of the whole trajectory to all ranges at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from fbn_common import records as r
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.motion_ekf.parameters import CompassParameters, DepthParameters
from fbn_common.types import NS, Array
from fbn_reference.estimator import Reference
from fbn_reference.parameters import Beacon, LblParameters, MapParameters, ReferenceParameters

DATA = Path(gtsam.__file__).parent / "Data"
START_NS = 1_000 * NS
GRID_NS = 10_000_000
SPEED = 4.0  # m/s, assumed; brisk, so that the test is
SOUND = 1500.0  # m/s
WALK = 0.05  # m a root metre: odometry's random walk, of the size that the fit leaves over
HEADING = 0.08  # rad: how far the fit turns the chain's heading along the way
RANGE_SIGMA = 0.75  # m, as the files state it
SIGMA = 1.5  # m: what the fit leaves over is 0.84 m by median, 1.25 m as a deviation, and correlated along the way
OUTLIER = 5.0  # m, more than six times that


@dataclass(frozen=True)
class Trial:
    """Chained poses (n, 3) x, y, heading; beacons; ranges as (pose, beacon, metres)."""

    poses: Array
    beacons: dict[str, Array]
    ranges: list[tuple[int, str, float]]


def read(name: str) -> Trial:
    poses, beacons, ranges = [], {}, []
    for line in (DATA / name).read_text().splitlines():
        kind, *words = line.split()
        if kind == "VERTEX_SE2":
            poses.append([float(w) for w in words[2:5]])
        elif kind == "VERTEX_XY":
            beacons[words[0]] = np.array([float(w) for w in words[1:3]])
        elif kind == "EDGE_RANGE":
            ranges.append((int(words[1][1:]), words[2], float(words[3])))
    return Trial(np.array(poses), beacons, ranges)


@dataclass(frozen=True)
class Fit:
    """The whole trajectory by robust least squares: positions (n, 2), turn of the chain (n,), ranges less distances."""

    position: Array
    turn: Array
    residual: Array


def fit(trial: Trial) -> Fit:
    """First the chain as a rigid body, from many starts; then every pose, the chain's heading drifting."""
    chain, n = trial.poses[:, :2], len(trial.poses)
    at = np.array([k for k, _, _ in trial.ranges])
    beacon = np.array([trial.beacons[b] for _, b, _ in trial.ranges])
    measured = np.array([z for _, _, z in trial.ranges])
    steps = np.diff(chain, axis=0)
    length = np.maximum(np.hypot(*steps.T), 0.3)

    def turned(xy: Array, angle: Array) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]], axis=1)

    def misfit(position: Array) -> Array:
        return np.asarray(measured - np.hypot(*(position[at] - beacon).T))

    def rigid(p: Array) -> Array:
        return misfit(turned(chain, np.full(n, p[2])) + p[:2])

    grid = [(x, y, a) for x in (200.0, 600.0, 1000.0) for y in (-100.0, 200.0, 500.0) for a in (0.0, 1.6, 3.1, 4.7)]
    first = min((least_squares(rigid, g, loss="cauchy", f_scale=3.0) for g in grid), key=lambda s: s.cost).x

    def whole(p: Array) -> Array:
        position, turn = p[: 2 * n].reshape(n, 2), p[2 * n :]
        odometry = (np.diff(position, axis=0) - turned(steps, turn[:-1])) / (WALK * np.sqrt(length) + 0.02)[:, None]
        heading = np.diff(turn) / (0.01 * np.sqrt(length) + 0.002)
        scaled = misfit(position) / RANGE_SIGMA
        robust = np.sign(scaled) * 2.0 * np.sqrt(np.log1p((scaled / 2.0) ** 2))  # Cauchy
        return np.concatenate([odometry.ravel(), heading, robust])

    start = np.concatenate([(turned(chain, np.full(n, first[2])) + first[:2]).ravel(), np.full(n, first[2])])
    pattern = lil_matrix((len(whole(start)), 3 * n), dtype=int)
    for i in range(n - 1):
        for axis in (0, 1):
            pattern[2 * i + axis, [2 * i + axis, 2 * i + 2 + axis, 2 * n + i]] = 1
        pattern[2 * (n - 1) + i, [2 * n + i, 2 * n + i + 1]] = 1
    for row, k in enumerate(at):
        pattern[3 * (n - 1) + row, [2 * k, 2 * k + 1]] = 1
    best = least_squares(whole, start, jac_sparsity=pattern, x_scale="jac", max_nfev=100).x
    position = best[: 2 * n].reshape(n, 2)
    return Fit(position, best[2 * n :], misfit(position))


# --- the trial as the filter's inputs -------------------------------------------------------------------------


def stamps(trial: Trial) -> Array:
    """Whole grid steps, at the assumed speed."""
    steps = np.maximum(np.ceil(np.hypot(*np.diff(trial.poses[:, :2], axis=0).T) / SPEED / 0.01), 10)
    return START_NS + GRID_NS * np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def motions(trial: Trial, times: Array) -> Iterator[r.PredictedMotion]:
    """The chain's steps cut to the grid; what they are worth is in the noise, none of it in velocity or parameters."""
    none = [np.zeros((12, columns)) for columns in (6, 3, 15)]
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
                np.ones(15), *none, noise, quaternion_from_matrix(matrix_from_rpy(np.array([0.0, 0.0, heading]))),
            )  # fmt: skip


def measurements(trial: Trial, times: Array, turn: float) -> Iterator[tuple[int, str, r.Record]]:
    """Compass (the chain's heading, turned as the fit says at the start), depth 0, ranges with their travel time."""
    absent, none = np.diag([-1.0, 0.0, 0.0]), np.zeros(3)
    for stamp, pose in zip(times, trial.poses, strict=True):
        q = quaternion_from_matrix(matrix_from_rpy(np.array([0.0, 0.0, pose[2] + turn])))
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
        return Counter(a.verdict.name for a in self.answers if a.sensor == f"lbl.{beacon}")


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
        for topic, record in reference.advance(end):
            if topic == "reference/odometry":
                found[record.stamp_ns] = record
            elif topic == "reference/innovations":
                answers.append(record)
    stamped = np.array(sorted(found))
    nearest = stamped[np.clip(np.searchsorted(stamped, times), 0, len(stamped) - 1)]
    poses = [found[int(s)] for s in nearest]
    position = np.array([o.pose.position[:2] for o in poses])
    sigma = np.array([np.sqrt(np.linalg.eigvalsh(o.pose_covariance[:2, :2])[-1]) for o in poses])
    return Outcome(np.hypot(*(position - truth.position).T), sigma, answers)


@pytest.fixture(scope="module")
def trials() -> dict[str, tuple[Trial, Fit]]:
    found = {name: read(f"{name}.pyfg") for name in ("goats_15", "goats_16")}
    return {name: (trial, fit(trial)) for name, trial in found.items()}


def outliers(trial: Trial, truth: Fit, beacon: str) -> float:
    """Share of the beacon's ranges that the fit does not explain."""
    mine = [abs(x) > OUTLIER for x, (_, b, _) in zip(truth.residual, trial.ranges, strict=True) if b == beacon]
    return float(np.mean(mine))


def nis(o: Outcome) -> float:
    """Mean of the ranges used."""
    return float(np.mean([a.nis for a in o.answers if a.sensor.startswith("lbl") and a.verdict == r.Verdict.USED]))


def test_the_files_hold_what_their_publishers_say(trials) -> None:
    (first, _), (second, _) = trials["goats_15"], trials["goats_16"]
    assert (len(first.poses), len(first.beacons), len(first.ranges)) == (473, 3, 786)
    assert (len(second.poses), len(second.beacons), len(second.ranges)) == (201, 4, 572)


def test_ranges_with_outliers_hold_the_position_over_kilometres(trials) -> None:
    trial, truth = trials["goats_15"]
    o = run(trial, truth, start_sigma=10.0)
    # The fit itself is good to 1 m or so (ranges leave 0.84 m over, by median); it smooths, the filter does not.
    assert np.median(o.error) < 3.0
    assert np.percentile(o.error, 90) < 6.0
    for beacon in trial.beacons:  # the fit calls 3 to 6 % of them outliers
        verdicts = o.verdicts(beacon)
        assert verdicts["USED"] > 0.9 * verdicts.total()
        assert verdicts["GATED"] > 0
    # Errors of ranges are correlated along the way and not normal: a factor of two either way, not the 95 % band.
    assert 0.5 < nis(o) < 2.0


def test_a_beacon_that_is_not_where_it_is_said_to_be_is_dropped(trials) -> None:
    trial, truth = trials["goats_16"]
    assert outliers(trial, truth, "L1") > 0.9  # off by 24 m
    o = run(trial, truth, start_sigma=2.0)  # a fix from GPS before the dive
    liar = o.verdicts("L1")
    assert liar["USED"] < 0.1 * liar.total()
    assert liar["REFUSED"] > liar["GATED"]  # not only gated one by one
    for honest in ("L0", "L2", "L3"):
        assert o.verdicts(honest)["USED"] > 0.6 * o.verdicts(honest).total()
    assert np.percentile(o.error, 90) < 6.0


@pytest.mark.parametrize("start_sigma", [10.0, 1000.0])  # 0.6 and 0.8 of it is the start off
def test_a_beacon_that_lies_is_found_out_from_an_uncertain_start(trials, start_sigma: float) -> None:
    trial, truth = trials["goats_16"]
    o = run(trial, truth, start_sigma=start_sigma)
    assert np.percentile(o.error, 90) < 6.0
    assert o.verdicts("L1")["USED"] < 0.1 * o.verdicts("L1").total()
