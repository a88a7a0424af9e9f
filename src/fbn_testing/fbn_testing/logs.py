"""Short logs of plausible sensor messages, for tests of whatever moves messages about."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fbn_common import records as r
from fbn_common.types import NS, nanoseconds
from fbn_ros.bag import BagWriter

T0 = 1_700_000_000 * NS

RATES = {"actuators": 10.0, "imu/data": 10.0, "pressure": 10.0, "altitude": 5.0, "sonar/detections": 2.0}


def sensor_log(duration_s: float = 10.0, seed: int = 1000) -> Iterator[tuple[int, str, r.Record]]:
    """Log time, topic, record of a vehicle at rest, in order of log time; each message is logged 20-80 ms late."""
    rng = np.random.default_rng(seed)
    entries = []
    for topic, rate in RATES.items():
        for k in range(int(duration_s * rate)):
            stamp_ns = T0 + nanoseconds(k / rate)
            arrival_ns = stamp_ns + nanoseconds(rng.uniform(0.02, 0.08))
            entries.append((arrival_ns, topic, sensor_record(topic, stamp_ns, k, rng)))
    yield from sorted(entries, key=lambda e: e[:2])


def sensor_record(topic: str, stamp_ns: int, k: int, rng: np.random.Generator) -> r.Record:
    """A good message of a sensor's topic."""
    none = np.zeros(0)
    match topic:
        case "actuators":
            names = ("propeller", "pan", "tilt")
            return r.JointState(stamp_ns, "base_link", names, np.zeros(3), np.array([60.0 + k % 5, 0, 0]), none)
        case "imu/data":
            half = 0.5 * rng.normal(0.0, 0.02)
            level = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
            absent = -np.eye(3)
            covariance = 4e-4 * np.eye(3)
            return r.Imu(stamp_ns, "imu_link", level, covariance, np.zeros(3), absent, np.zeros(3), absent)
        case "pressure":
            return r.FluidPressure(stamp_ns, "pressure_link", 131_325.0 + rng.normal(0, 50.0), 2500.0)
        case "altitude":
            return r.Range(stamp_ns, "altimeter_link", 0, 0.125, 0.5, 50.0, 2.0 + 0.25 * (k % 3))
        case "sonar/detections":
            echo = r.SonarDetection(15.0 + k % 4, 1.5, 0.03125, 0.015625, 0.5)
            return r.SonarDetections(stamp_ns, "sonar", k, 4.0, 40.0, 0.0, 3.0, 0.25, (echo,) * (k % 3))
        case "gps/fix":
            return r.NavSatFix(stamp_ns, "gps_link", 0, 42.36, -71.08, 0.0, 4.0 * np.eye(3), 2)
        case "lbl/range":
            return r.BeaconRange(stamp_ns, "lbl_link", "a", 100.0 + k, 1.0, 0.1)
        case _:
            raise KeyError(topic)


def write_sensor_log(path: Path, duration_s: float = 10.0, seed: int = 1000) -> Path:
    """Write :func:`sensor_log` as a bag; gives its path."""
    with BagWriter(path) as writer:
        for log_time_ns, topic, record in sensor_log(duration_s, seed):
            writer.write(log_time_ns, topic, record)
    return path
