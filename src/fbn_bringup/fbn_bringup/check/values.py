"""Rules of value: units and frames that look wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from fbn_bringup.check.findings import Finding, Log, Severity
from fbn_common import records as r
from fbn_common.types import Array

ATMOSPHERE: Final = 101_325.0  # Pa
UNITS: Final = ((100.0, "hPa (mbar)"), (1_000.0, "kPa"), (100_000.0, "bar"), (10_000.0, "dbar"))
ACTUATORS: Final = ("propeller", "pan", "tilt", "rudder", "stern_plane")
FASTEST: Final = 420.0  # rad/s, 4,000 rpm: more than propellers of small vehicles do


def malformed(log: Log) -> Iterator[Finding]:
    """Messages that the estimators will refuse."""
    for topic, reasons in log.malformed.items():
        total = sum(reasons.values())
        text = "; ".join(f"{reason} ({n})" for reason, n in reasons.most_common(3))
        share = total / max(total + len(log.records.get(topic, ())), 1)
        severity = Severity.ERROR if share > 0.5 else Severity.WARNING
        yield Finding(severity, topic, f"{total} malformed messages: {text}", "refused and counted; the rest is used")


def pressure(log: Log) -> Iterator[Finding]:
    """Pressure in another unit, or relative to the atmosphere."""
    values = np.array([p.fluid_pressure for p in log.of("pressure", r.FluidPressure)])
    values = values[np.isfinite(values)]
    if not len(values):
        return
    low = float(np.quantile(values, 0.02))
    for factor, unit in UNITS:
        if 0.85 <= low * factor / ATMOSPHERE <= 1.15:
            text = f"about {low:.4g} at the surface: looks like {unit}"
            yield Finding(Severity.ERROR, "pressure", text, f"convert to Pa: multiply by {factor:g}")
            return
    if low < 0.3 * ATMOSPHERE:
        text = f"about {low:.4g} Pa at the least: looks like gauge pressure"
        yield Finding(
            Severity.ERROR, "pressure", text, "absolute pressure is wanted: add the atmosphere's, about 101325 Pa"
        )
    elif low > 1.15 * ATMOSPHERE:
        text = f"never less than {low:.0f} Pa: the vehicle was never at the surface, or the sensor has an offset"
        yield Finding(Severity.NOTE, "pressure", text, "check the parameters for surface pressure and density")


def altitude(log: Log) -> Iterator[Finding]:
    """An altimeter that hardly ever sees the bottom."""
    ranges = log.of("altitude", r.Range)
    if ranges:
        seen = np.mean([a.min_range <= a.range <= a.max_range for a in ranges])
        if seen < 0.3:
            text = f"the bottom was seen in {100 * seen:.0f} % of the messages"
            yield Finding(
                Severity.WARNING, "altitude", text, "check min_range and max_range, and that ranges are in metres"
            )


def gps(log: Log) -> Iterator[Finding]:
    """Fixes that are none, at 0/0, or that claim to be exact."""
    fixes = log.of("gps/fix", r.NavSatFix)
    good = [f for f in fixes if f.status >= 0]
    if fixes and not good:
        yield Finding(
            Severity.WARNING,
            "gps/fix",
            "no message with a fix (status below 0)",
            "no absolute position; use LBL, or check the receiver",
        )
    zero = sum(abs(f.latitude) < 1e-6 and abs(f.longitude) < 1e-6 for f in good)
    if zero:
        yield Finding(
            Severity.ERROR,
            "gps/fix",
            f"{zero} fixes at latitude 0, longitude 0",
            "set status.status to -1 where there is no fix",
        )
    exact = sum(f.position_covariance_type == 0 or f.position_covariance[0, 0] <= 0.0 for f in good)
    if good and exact > 0.5 * len(good):
        text = f"{exact} of {len(good)} fixes state no covariance"
        yield Finding(
            Severity.WARNING,
            "gps/fix",
            text,
            "fill position_covariance; until then the default of the parameters holds",
        )


def actuators(log: Log) -> Iterator[Finding]:
    """Unknown names, and rates or angles in other units."""
    states = log.of("actuators", r.JointState)
    names = {name for s in states for name in s.name}
    if states and "propeller" not in names:
        text = f"no actuator named propeller; there are {', '.join(sorted(names)) or 'none'}"
        yield Finding(Severity.ERROR, "actuators", text, f"rename them; known are {', '.join(ACTUATORS)}")
    if unknown := sorted(names - set(ACTUATORS)):
        yield Finding(Severity.NOTE, "actuators", f"unknown actuators {', '.join(unknown)}", "they are left out")
    fastest = max(
        (
            abs(v)
            for s in states
            for n, v in zip(s.name, s.velocity, strict=False)
            if n == "propeller" and np.isfinite(v)
        ),
        default=0.0,
    )
    if fastest > FASTEST:
        text = f"the propeller turns at up to {fastest:.0f} rad/s: looks like revolutions per minute"
        yield Finding(Severity.ERROR, "actuators", text, "convert to rad/s: multiply by 2 pi / 60")
    if states and fastest == 0.0 and "propeller" in names:
        yield Finding(
            Severity.WARNING,
            "actuators",
            "the propeller never turns",
            "fill velocity [rad/s] of the joint named propeller",
        )
    widest = max(
        (
            abs(p)
            for s in states
            for n, p in zip(s.name, s.position, strict=False)
            if n in ACTUATORS[1:] and np.isfinite(p)
        ),
        default=0.0,
    )
    if widest > np.pi:
        yield Finding(
            Severity.ERROR, "actuators", f"angles of up to {widest:.0f} rad: look like degrees", "convert to rad"
        )


def sonar(log: Log) -> Iterator[Finding]:
    """Angles in degrees, pings lost, nothing ever detected."""
    pings = log.of("sonar/detections", r.SonarDetections)
    if not pings:
        return
    if max(max(abs(p.bearing_max), abs(p.bearing_min), p.lobe_width) for p in pings) > 2 * np.pi:
        yield Finding(
            Severity.ERROR,
            "sonar/detections",
            "bearings over 2 pi: look like degrees",
            "convert to rad, measured from the array's z axis",
        )
    outside = [not p.bearing_min <= d.bearing <= p.bearing_max for p in pings for d in p.detections]
    if outside and np.mean(outside) > 0.02:
        text = f"{100 * np.mean(outside):.0f} % of the detections lie outside [bearing_min, bearing_max]"
        yield Finding(
            Severity.WARNING,
            "sonar/detections",
            text,
            "bearing is the angle to the array's z axis, not to its look direction",
        )
    if not outside:
        yield Finding(
            Severity.WARNING, "sonar/detections", "no detection in any ping", "check the detector's thresholds"
        )
    for array in sorted({p.frame_id for p in pings}):
        numbers: Array = np.array([p.ping for p in pings if p.frame_id == array], dtype=float)
        lost = int((np.diff(numbers) - 1).clip(0).sum())
        if lost > 0.01 * len(numbers):
            yield Finding(
                Severity.WARNING,
                "sonar/detections",
                f"{lost} pings of {array} are missing",
                "publish every ping, also when it is empty",
            )
