"""What the tracker takes in: checks at the edge, and the waiting of pings and scans for one another."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from fbn_common.records import Innovation, PingMotion, Record, SonarDetection, SonarDetections, Verdict
from fbn_common.types import Array

_SYMMETRY = 1e-6  # relative


def refusal(sensor: str, stamp_ns: int, verdict: Verdict, reason: str) -> Innovation:
    """An answer that carries no numbers."""
    return Innovation(stamp_ns, sensor, sensor, 0.0, 0, verdict, reason, np.zeros(0), np.zeros(0))


def motion_fault(motion: PingMotion) -> str:
    """What is wrong with a ping's motion; empty when nothing is."""
    arrays = {
        "increment": np.concatenate((motion.increment.position, motion.increment.orientation)),
        "pose": np.concatenate((motion.pose.position, motion.pose.orientation)),
        "increment_covariance": motion.increment_covariance,
        "earth": motion.earth,
        "earth_information": motion.earth_information,
        "earth_covariance": motion.earth_covariance,
        "drift_covariance": motion.drift_covariance,
        "altitude": np.array([motion.altitude, motion.altitude_variance, motion.drift_time_constant]),
        "heading_drift": motion.heading_drift,
        "heading_deviation": np.array([motion.heading_deviation]),
    }
    shapes = {"increment_covariance": (6, 6), "earth": (4,), "earth_information": (4, 4), "earth_covariance": (4, 4)}
    for name, value in arrays.items():
        if value.shape != shapes.get(name, value.shape):
            return f"{name}: expected shape {shapes[name]}, got {value.shape}"
        if not np.isfinite(value).all():
            return f"{name}: not finite"
    for pose in (motion.increment, motion.pose):
        if abs(float(np.linalg.norm(pose.orientation)) - 1.0) > 0.01:
            return "a quaternion is not of unit norm"
    for name in ("increment_covariance", "earth_information", "earth_covariance", "drift_covariance"):
        if not _semidefinite(arrays[name]):
            return f"{name}: not symmetric and positive semidefinite"
    if motion.previous_ns > motion.stamp_ns:
        return "previous is after the stamp"
    if motion.heading_deviation < 0.0:
        return "heading_deviation: negative"
    return "" if motion.drift_time_constant > 0.0 else "drift_time_constant: must be positive"


def _semidefinite(matrix: Array) -> bool:
    size = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > _SYMMETRY * max(size, 1e-300):
        return False
    return size == 0.0 or float(np.linalg.eigvalsh(matrix)[0]) >= -_SYMMETRY * size


def detection_fault(echo: SonarDetection, scan: SonarDetections) -> str:
    """What is wrong with one echo; empty when nothing is."""
    if not np.isfinite([echo.range, echo.bearing, echo.range_sigma, echo.bearing_sigma, echo.intensity]).all():
        return "not finite"
    if echo.range <= 0.0:
        return "range is not positive"
    if not 0.0 < echo.bearing < np.pi:
        return "bearing is not between 0 and pi"
    return "a sigma is negative" if min(echo.range_sigma, echo.bearing_sigma) < 0.0 else ""


@dataclass(slots=True)
class Intake:
    """Pings and scans in waiting."""

    arrays: Collection[str]
    ping_wait_ns: int
    motions: dict[int, PingMotion] = field(default_factory=dict)
    scans: dict[tuple[int, str], SonarDetections] = field(default_factory=dict)
    answers: list[Innovation] = field(default_factory=list)

    def put(self, record: Record) -> None:
        """Keep a well-formed record; answer any other."""
        if isinstance(record, PingMotion):
            self._put_motion(record)
        elif isinstance(record, SonarDetections):
            self._put_scan(record)
        else:
            self.answers.append(refusal("", record.stamp_ns, Verdict.REFUSED, f"unexpected {type(record).__name__}"))

    def _put_motion(self, motion: PingMotion) -> None:
        fault = motion_fault(motion)
        if not fault and motion.stamp_ns in self.motions:
            fault = "a second motion of the same ping"
        if fault:
            self.answers.append(refusal("ping_motion", motion.stamp_ns, Verdict.REFUSED, fault))
        else:
            self.motions[motion.stamp_ns] = motion

    def _put_scan(self, scan: SonarDetections) -> None:
        name, key = scan.frame_id, (scan.stamp_ns, scan.frame_id)
        if name not in self.arrays:
            known = ", ".join(sorted(self.arrays))
            reason = f"unknown array {name!r}; parameters describe {known}"
        elif key in self.scans:
            reason = "a second scan of the same array and ping"
        else:
            self.scans[key] = scan
            return
        self.answers.append(refusal(name, scan.stamp_ns, Verdict.REFUSED, reason))

    def take_motions(self, now_ns: int) -> list[PingMotion]:
        """The motions due, by stamp."""
        due = sorted(stamp for stamp in self.motions if stamp <= now_ns)
        return [self.motions.pop(stamp) for stamp in due]

    def take_scans(self, stamp_ns: int) -> list[SonarDetections]:
        """The scans of a ping, by array."""
        due = sorted(key for key in self.scans if key[0] == stamp_ns)
        return [self.scans.pop(key) for key in due]

    def expire(self, now_ns: int) -> list[Innovation]:
        """Answers for scans whose ping's motion never came, or cannot come for long."""
        late = sorted(key for key in self.scans if key[0] < now_ns - self.ping_wait_ns)
        early = sorted(key for key in self.scans if key[0] > now_ns + self.ping_wait_ns)
        for key in (*late, *early):
            del self.scans[key]
        return [
            *(refusal(name, stamp, Verdict.LATE, "no motion came for its ping") for stamp, name in late),
            *(refusal(name, stamp, Verdict.REFUSED, "stamp too far ahead of the clock") for stamp, name in early),
        ]


def usable(scan: SonarDetections, limit: int) -> tuple[list[SonarDetection], list[Innovation]]:
    """The well-formed echoes, at most ``limit`` (the strongest), in a settled order; and the answers for the rest."""
    faults: dict[str, int] = {}
    good = []
    for echo in scan.detections:
        fault = detection_fault(echo, scan)
        if fault:
            faults[fault] = faults.get(fault, 0) + 1
        else:
            good.append(echo)
    good.sort(key=lambda e: (-e.intensity, e.range, e.bearing))
    if len(good) > limit:
        faults[f"beyond the {limit} strongest"] = len(good) - limit
    kept = sorted(good[:limit], key=lambda e: (e.range, e.bearing, -e.intensity))
    answers = [
        refusal(scan.frame_id, scan.stamp_ns, Verdict.REFUSED, f"{count} echoes: {fault}")
        for fault, count in faults.items()
    ]
    return kept, answers
