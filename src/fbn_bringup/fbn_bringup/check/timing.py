"""Rules of time: rates, gaps, stamps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from fbn_bringup.check.findings import Finding, Log, Severity, stamps
from fbn_bringup.evaluation.series import Stamps, Traffic
from fbn_common.types import NS

LOWEST_RATE: Final = {
    "imu/data": 2.0,
    "pressure": 1.0,
    "actuators": 1.0,
    "altitude": 0.5,
    "sonar/detections": 0.5,
}  # Hz
GAP: Final = 5.0  # s without a message of a sensor that should always speak
FUTURE: Final = 0.05  # s that a stamp may lie after its logging: clocks differ
SLOW: Final = 1.0  # s from measurement to log, usually


def rates(log: Log) -> Iterator[Finding]:
    """Sensors that speak too seldom, or fall silent."""
    for topic, lowest in LOWEST_RATE.items():
        traffic = log.traffic.get(topic)
        if traffic is None or len(traffic.log_ns) < 2:
            continue
        if traffic.rate < lowest:
            text = f"{traffic.rate:.2f} Hz; {lowest:g} Hz or more is wanted"
            yield Finding(Severity.WARNING, topic, text, "raise the sensor's rate; uncertainty grows between messages")
        if traffic.longest_gap() > max(GAP, 10.0 / traffic.rate):
            yield Finding(Severity.WARNING, topic, _gap(traffic), "the estimators predict across it, and say so")


def _gap(traffic: Traffic) -> str:
    gaps = np.diff(traffic.log_ns) / NS
    where = (traffic.log_ns[int(gaps.argmax())] - traffic.log_ns[0]) / NS
    return f"silent for {gaps.max():.1f} s, {where:.0f} s after its first message"


def order(log: Log) -> Iterator[Finding]:
    """Stamps that go backwards, repeat, lie in the future, or were never set."""
    for topic, records in log.records.items():
        if not records:
            continue
        by_source: dict[str, list[int]] = {}
        for record in records:
            by_source.setdefault(getattr(record, "frame_id", ""), []).append(record.stamp_ns)
        steps = np.concatenate([np.diff(np.array(times, dtype=np.int64)) for times in by_source.values()])
        yield from _steps(topic, steps)
        if (stamps(records) <= 0).any():
            yield Finding(Severity.ERROR, topic, "stamps of zero", "set header.stamp to the time of measurement")


def _steps(topic: str, steps: Stamps) -> Iterator[Finding]:
    back, same = steps[steps < 0], int((steps == 0).sum())
    if len(back) and back.min() < -5 * NS:
        text = f"the clock jumped back by {-back.min() / NS:.1f} s"
        yield Finding(
            Severity.WARNING, topic, text, "the estimators start anew there; cut the log, or correct the stamps"
        )
    elif len(back):
        text = f"{len(back)} messages out of order, by up to {-back.min() / NS:.2f} s"
        yield Finding(Severity.NOTE, topic, text, "merged exactly while within the filters' history")
    if same:
        yield Finding(Severity.NOTE, topic, f"{same} repeated stamps", "duplicates are counted and left out")


def latency(log: Log) -> Iterator[Finding]:
    """Measurements logged before they were made, or long after."""
    for topic, traffic in log.traffic.items():
        late = traffic.latency
        if (late < -FUTURE).mean() > 0.01:
            text = f"stamps up to {-late.min():.2f} s after the time of logging"
            yield Finding(Severity.WARNING, topic, text, "synchronise the clocks; live, such data wait for their time")
        if np.median(late) > SLOW:
            text = f"logged {np.median(late):.1f} s after the measurement (median)"
            yield Finding(Severity.WARNING, topic, text, "live, data older than the history are refused as LATE")
