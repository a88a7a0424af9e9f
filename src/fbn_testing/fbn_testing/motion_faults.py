"""Each sensor of the front half with each fault: what the estimate does, how soon it is named, how it recovers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from fbn_common.estimator import Estimator
from fbn_common.geodesy import geodetic_from_enu
from fbn_common.motion_ekf.lockstep import Arrival, play
from fbn_common.records import BeaconRange, Innovation, NavSatFix, Odometry, Verdict
from fbn_common.types import NS, Array, seconds
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import DATUM, Twin, sail
from fbn_sim.faults import Fault, apply
from fbn_sim.sensors.sample import Entry
from fbn_testing.motion_voyage import front_half, in_map

SENSORS = {  # topic: name in answers
    "imu/data": "compass",
    "pressure": "depth",
    "altitude": "altimeter",
    "actuators": "actuators",
    "gps/fix": "gps",
    "lbl/range": "lbl",
}
KINDS = ("dropped", "frozen", "nan", "noise", "late", "duplicated", "bias")
BEACONS = {"north": (30.0, 60.0, -3.0), "west": (-60.0, 0.0, -3.0), "south": (20.0, -70.0, -3.0)}
SETTINGS = {
    f"reference.lbl.beacons.{name}.{axis}": value
    for name, place in BEACONS.items()
    for axis, value in zip("xyz", place, strict=True)
} | in_map(DATUM)
LENGTH_S, BEGIN_S, END_S = 110.0, 50.0, 75.0
SETTLED_S = 10.0  # after the fault's end, in which a sensor must be used again


@dataclass(frozen=True, slots=True)
class Cell:
    """What became of one fault."""

    sensor: str
    kind: str
    named_s: float | None  # after the fault's begin, first said by its name
    said: str
    drift: float  # m, most that dead reckoning was moved against the voyage without fault
    depth: float  # m, the same of z
    yaw: float  # rad, the same of yaw
    absolute: float  # m, the same of the reference filter's x and y
    used_again_s: float | None  # after the fault's end
    worst: float  # largest error of the last 5 s over its own standard deviation: x, y of reference, z, yaw
    sound: bool  # every output finite, every covariance positive definite


@dataclass
class Heard:
    """What is kept of a voyage."""

    odometry: dict[str, list[Odometry]] = field(default_factory=lambda: {"deadreck": [], "reference": []})
    answers: list[Innovation] = field(default_factory=list)
    complaints: list[tuple[int, str]] = field(default_factory=list)  # time, health's line
    sound: bool = True


def voyage(seed: int) -> tuple[Twin, list[Entry]]:
    """A voyage of the twin just under the surface, with GPS and three beacons all the way."""
    twin = sail(PredictParameters(), LENGTH_S, seed, depth=0.7)
    rng = np.random.default_rng([seed, 7])
    entries = [Entry(r.stamp_ns, topic, r) for topic, r in twin.records if topic != "gps/fix"]
    entries += [*_fixes(twin, rng), *_ranges(twin, rng)]
    return twin, sorted(entries, key=lambda e: e.log_time_ns)


def heard_with(entries: list[Entry], topic: str) -> list[Entry]:
    """The voyage to spoil a sensor on: GPS without beacons, beside which it would have nothing to say."""
    return [e for e in entries if topic != "gps/fix" or e.topic != "lbl/range"]


def _fixes(twin: Twin, rng: np.random.Generator) -> Iterator[Entry]:
    slow = rng.normal(0.0, 1.6, 2)
    for k in range(100, len(twin.stamp_ns), 100):
        place = twin.position[k] + twin.rotation[k] @ np.array([-0.3, 0.0, 0.35])
        x, y = place[:2] + slow + rng.normal(0.0, 0.3, 2)
        g = geodetic_from_enu(np.array([x, y, 0.0]), DATUM)
        stamp = twin.stamp_ns[k]
        yield Entry(stamp, "gps/fix", NavSatFix(stamp, "gps", 0, g.latitude, g.longitude, 0.0, 3.36 * np.eye(3), 2))


def _ranges(twin: Twin, rng: np.random.Generator) -> Iterator[Entry]:
    for i, k in enumerate(range(150, len(twin.stamp_ns), 67)):
        name = list(BEACONS)[i % len(BEACONS)]
        distance = float(np.linalg.norm(twin.position[k] - np.array(BEACONS[name])) + rng.normal(0.0, 0.3))
        stamp = twin.stamp_ns[k]
        yield Entry(stamp, "lbl/range", BeaconRange(stamp, "base_link", name, distance, 0.36, 0.0))


def listen(entries: list[Entry]) -> Heard:
    """Run the front half over a log; health is asked for at each step."""
    heard, nodes = Heard(), front_half(SETTINGS)
    records: list[Arrival] = [(e.log_time_ns, e.topic, e.record) for e in entries]
    now = records[0][0]
    for made in play(nodes, records):
        for topic, record in made:
            now = max(now, record.stamp_ns)
            if isinstance(record, Odometry):
                heard.odometry[topic.partition("/")[0]].append(record)
                heard.sound &= _sound(record)
            elif isinstance(record, Innovation):
                heard.answers.append(record)
        heard.complaints += [(now, line) for line in _lines(nodes)]
    return heard


def _lines(nodes: dict[str, Estimator]) -> Iterator[str]:
    for estimator in nodes.values():
        health = estimator.health()
        if health.level:
            yield from health.message.split("; ")


def _sound(line: Odometry) -> bool:
    covariance = line.pose_covariance
    finite = np.isfinite(line.pose.position).all() and np.isfinite(line.twist).all() and np.isfinite(covariance).all()
    return bool(finite and np.linalg.eigvalsh(covariance)[0] > 0.0)


def cell(twin: Twin, entries: list[Entry], good: Heard, topic: str, kind: str) -> Cell:
    """One sensor with one fault, against the same voyage without it."""
    begin, end = (twin.stamp_ns[0] + round(t * NS) for t in (BEGIN_S, END_S))
    fault = Fault(topic=topic, kind=kind, start=BEGIN_S, end=END_S)
    spoilt = sorted(apply(entries, "fault", fault, twin.stamp_ns[0], 1), key=lambda e: e.log_time_ns)
    heard, name = listen(spoilt), SENSORS[topic]
    moved = {node: _moved(good.odometry[node], heard.odometry[node]) for node in good.odometry}
    at, said = _named(good, heard, name, begin)
    used = [a.stamp_ns for a in heard.answers if _of(a, name) and a.verdict is Verdict.USED and a.stamp_ns >= end]
    return Cell(
        name, kind, at, said, float(moved["deadreck"][:, 0].max()), float(moved["deadreck"][:, 1].max()),
        float(moved["deadreck"][:, 2].max()), float(moved["reference"][:, 0].max()),
        seconds(min(used) - end) if used else None, _worst(twin, heard), heard.sound,
    )  # fmt: skip


def _of(answer: Innovation, name: str) -> bool:
    return answer.sensor.partition(".")[0] == name


def _named(good: Heard, heard: Heard, name: str, begin: int) -> tuple[float | None, str]:
    """When the fault was first said with the sensor's name, in words not heard without it; and the words."""
    usual = {a.reason for a in good.answers if _of(a, name)}
    said = [(a.stamp_ns, a.reason) for a in heard.answers if _of(a, name) and a.reason and a.reason not in usual]
    known = {line for _, line in good.complaints}
    said += [(t, line) for t, line in heard.complaints if line.startswith(name) and line not in known]
    said = [s for s in said if s[0] >= begin]
    if not said:
        return None, ""
    at, words = min(said)
    return seconds(at - begin), words


def _moved(good: list[Odometry], heard: list[Odometry]) -> Array:
    """Differences (n, 3) of one track against another at the same stamps: in the plane [m], z [m], yaw [rad]."""
    other = {o.stamp_ns: o for o in good}
    pairs = [(other[o.stamp_ns], o) for o in heard if o.stamp_ns in other]
    rows = []
    for a, b in pairs:
        step = b.pose.position - a.pose.position
        turn = 2.0 * np.arcsin(min(1.0, abs(_yaw_half(a, b))))
        rows.append((float(np.hypot(step[0], step[1])), abs(float(step[2])), turn))
    return np.array(rows)


def _yaw_half(a: Odometry, b: Odometry) -> float:
    """Sine of half the rotation about z between two nearly level attitudes."""
    (x0, y0, z0, w0), (x1, y1, z1, w1) = a.pose.orientation, b.pose.orientation
    return float(w0 * z1 - z0 * w1 + y0 * x1 - x0 * y1)


def _worst(twin: Twin, heard: Heard) -> float:
    """Largest error over its standard deviation in the last 5 s: x, y of reference, z of dead reckoning."""
    found = []
    for node, axes in (("reference", (0, 1, 2)), ("deadreck", (2,))):
        for line in heard.odometry[node]:
            k = twin.index(line.stamp_ns)
            if twin.stamp_ns[-1] - line.stamp_ns < 5 * NS and 0 <= k < len(twin.stamp_ns):
                error = np.abs(line.pose.position - twin.position[k])
                found += [float(error[i] / np.sqrt(line.pose_covariance[i, i])) for i in axes]
    return max(found)
