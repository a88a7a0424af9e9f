"""Rules of frames: is the compass in ENU and the body forward-left-up, judged by how the vehicle moved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pymap3d
from scipy.spatial.transform import Rotation

from fbn_bringup.check.findings import Finding, Log, Severity, stamps
from fbn_bringup.evaluation.series import Stamps
from fbn_common import records as r
from fbn_common.types import NS, Array

BASELINE_S: Final = 10  # s between the fixes that a course is taken from
SHORTEST: Final = 4.0  # m between them
FEWEST: Final = 5  # courses, or changes of depth, to judge by
REMEDY: Final = "convert orientation to ENU and forward-left-up (REP-103) where the sensor's driver ends"


def orientation(log: Log) -> Iterator[Finding]:
    """A compass that is absent, frozen, upside down, or in NED."""
    compass = log.of("imu/data", r.Imu)
    compass = [c for c in compass if np.isfinite(c.orientation).all() and np.linalg.norm(c.orientation) > 0.1]
    if not compass:
        return
    if all(c.orientation_covariance[0, 0] == -1.0 for c in compass):
        yield Finding(
            Severity.ERROR,
            "imu/data",
            "says that it has no orientation (covariance -1)",
            "a three-axis compass is needed",
        )
        return
    if np.ptp([c.orientation for c in compass], axis=0).max() == 0.0:
        yield Finding(
            Severity.ERROR, "imu/data", "the orientation never changes", "check the driver: the compass is frozen"
        )
        return
    rpy = np.unwrap(Rotation.from_quat([c.orientation for c in compass]).as_euler("xyz"), axis=0)
    times = stamps(compass)
    if abs(np.median(np.abs(np.angle(np.exp(1j * rpy[:, 0])))) - np.pi) < np.pi / 4:
        yield Finding(
            Severity.ERROR, "imu/data", "lies on its back (roll about 180 deg): looks like forward-right-down", REMEDY
        )
    yield from _heading(times, rpy[:, 2], log)
    yield from _pitch(times, rpy[:, 1], log)


def _heading(times: Stamps, yaw: Array, log: Log) -> Iterator[Finding]:
    """Compare the heading with the course over ground."""
    when, course = courses(log.of("gps/fix", r.NavSatFix))
    if len(when) < FEWEST or not len(times):
        return
    heading = np.interp(when, times, yaw)
    as_enu, as_compass = _agreement(course - heading), _agreement(course - (np.pi / 2 - heading))
    if abs(as_compass) > 0.8 and abs(np.angle(as_compass)) < 0.7 and abs(as_enu) < 0.9 * abs(as_compass):
        text = (
            "the heading turns against the course over ground: looks like a compass heading (north 0, clockwise) as yaw"
        )
        yield Finding(Severity.ERROR, "imu/data", text, REMEDY)
    elif abs(as_enu) > 0.8 and abs(np.angle(as_enu)) > 0.7:
        text = f"the heading is {np.degrees(np.angle(as_enu)):.0f} deg off the course over ground"
        yield Finding(
            Severity.WARNING,
            "imu/data",
            text,
            "yaw is 0 to the east and grows to the left; check mount and declination",
        )


def _agreement(difference: Array) -> complex:
    """Mean of unit vectors: length 1 when all differences are alike, its angle their mean."""
    return complex(np.mean(np.exp(1j * difference)))


def courses(fixes: list[r.NavSatFix]) -> tuple[Stamps, Array]:
    """Stamps (n,) and courses over ground (n,) [rad, ENU] between fixes some seconds apart."""
    good = [f for f in fixes if f.status >= 0 and abs(f.latitude) <= 90 and np.isfinite(f.latitude + f.longitude)]
    if len(good) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    latitude, longitude = np.array([f.latitude for f in good]), np.array([f.longitude for f in good])
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, 0.0, latitude[0], longitude[0], 0.0)
    times = stamps(good)
    later = np.searchsorted(times, times + BASELINE_S * NS)
    pairs = [(i, j) for i, j in enumerate(later) if j < len(times) and times[j] - times[i] < 2 * BASELINE_S * NS]
    a, b = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    de, dn = east[b] - east[a], north[b] - north[a]
    moved = np.hypot(de, dn) > SHORTEST
    return (times[a] + times[b])[moved] // 2, np.arctan2(dn, de)[moved]


def _pitch(times: Stamps, pitch: Array, log: Log) -> Iterator[Finding]:
    """Diving with the bow down: depth must grow with positive pitch."""
    pressures = log.of("pressure", r.FluidPressure)
    if len(pressures) < 10:
        return
    when, depth = stamps(pressures), np.array([p.fluid_pressure for p in pressures]) / 9_810.0
    grid = np.arange(max(when[0], times[0]), min(when[-1], times[-1]), 2 * NS)
    if len(grid) < 10:
        return
    rate = np.diff(np.interp(grid, when, depth)) / 2.0
    mean_pitch = np.interp((grid[:-1] + grid[1:]) // 2, times, pitch)
    changing = np.abs(rate) > 0.05
    if changing.sum() >= FEWEST and _likeness(mean_pitch[changing], rate[changing]) < -0.6:
        text = "the vehicle dives with negative pitch: looks like bow-up positive"
        yield Finding(
            Severity.ERROR, "imu/data", text, "positive pitch is bow down (forward-left-up, REP-103); " + REMEDY
        )


def _likeness(a: Array, b: Array) -> float:
    """Cosine between two series (n,): 1 when they have the same sign and shape; 0 when one is zero."""
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / length if length > 0.0 else 0.0
