"""What a check finds in logs that are wrong in one thing each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbn_bringup.check.findings import Log, Severity
from fbn_bringup.check.log import check_bag, judge
from fbn_bringup.evaluation.series import Traffic
from fbn_bringup.simulation import project_root
from fbn_common import records as r
from fbn_common.types import NS
from fbn_ros.bag import BagReader, BagWriter

Change = Callable[[r.Record], r.Record | None]


@pytest.fixture(scope="module")
def good(short_bag) -> dict[str, list[tuple[int, r.Record]]]:
    """A good log's messages by topic: time of logging, and record."""
    found: dict[str, list[tuple[int, r.Record]]] = {}
    with BagReader(short_bag) as bag:
        for log_ns, topic, record in bag.records():
            if not topic.startswith("truth"):
                found.setdefault(topic, []).append((log_ns, record))
    return found


def log_of(messages: dict[str, list[tuple[int, r.Record]]], topic: str = "", change: Change = lambda x: x) -> Log:
    """A log with one topic's records changed, or left out where the change gives None."""
    records, traffic = {}, {}
    for name, pairs in messages.items():
        kept = [(t, change(x) if name == topic else x) for t, x in pairs]
        kept = [(t, x) for t, x in kept if x is not None]
        if kept:
            records[name] = [x for _, x in kept]
            traffic[name] = Traffic(name, *np.array([(x.stamp_ns, t) for t, x in kept], dtype=np.int64).T)
    return Log(records, traffic)


def errors(log: Log) -> list[str]:
    return [f"{f.topic}: {f.text}" for f in judge("log", log).findings if f.severity == Severity.ERROR]


def texts(log: Log) -> str:
    return "\n".join(f"{f.topic}: {f.text}" for f in judge("log", log).findings)


def test_a_good_log_has_no_error(good):
    assert errors(log_of(good)) == []


@pytest.mark.parametrize("topic", ["imu/data", "pressure", "actuators"])
def test_without_compass_pressure_or_actuators_there_is_no_navigation(good, topic):
    verdict = judge("log", log_of(good, topic, lambda x: None))
    assert not verdict.can_navigate and topic in verdict.missing


@pytest.mark.parametrize("topic", ["sonar/detections", "gps/fix", "altitude"])
def test_what_is_only_wanted_is_a_warning_that_says_what_is_done_without(good, topic):
    verdict = judge("log", log_of(good, topic, lambda x: None))
    assert verdict.can_navigate
    assert any(f.topic == topic and f.severity == Severity.WARNING and f.remedy for f in verdict.findings)


@pytest.mark.parametrize(("factor", "unit"), [(100.0, "hPa"), (1_000.0, "kPa"), (100_000.0, "bar")])
def test_pressure_in_another_unit_is_recognised(good, factor, unit):
    log = log_of(good, "pressure", lambda p: dataclasses.replace(p, fluid_pressure=p.fluid_pressure / factor))
    assert any(unit in e and "pressure" in e for e in errors(log))


def test_gauge_pressure_is_recognised(good):
    log = log_of(good, "pressure", lambda p: dataclasses.replace(p, fluid_pressure=p.fluid_pressure - 101_325.0))
    assert any("gauge" in e for e in errors(log))


def test_a_propeller_in_revolutions_per_minute_is_recognised(good):
    log = log_of(good, "actuators", lambda a: dataclasses.replace(a, velocity=a.velocity * 60 / (2 * np.pi)))
    assert any("revolutions per minute" in e for e in errors(log))


def test_a_compass_heading_as_yaw_is_recognised_by_the_course(good):
    def turned(c: r.Record) -> r.Record:
        roll, pitch, yaw = Rotation.from_quat(c.orientation).as_euler("xyz")
        return dataclasses.replace(c, orientation=Rotation.from_euler("xyz", [roll, pitch, np.pi / 2 - yaw]).as_quat())

    assert any("compass heading" in e for e in errors(log_of(circling(good), "imu/data", turned)))


def circling(good: dict[str, list[tuple[int, r.Record]]]) -> dict[str, list[tuple[int, r.Record]]]:
    """The same log of a vehicle that goes in a circle on the surface, so that headings of all directions are seen."""
    start, radius, rate = good["imu/data"][0][1].stamp_ns, 30.0, 2 * np.pi / 90

    def compass(c: r.Record) -> r.Record:
        yaw = rate * (c.stamp_ns - start) / NS + np.pi / 2
        return dataclasses.replace(c, orientation=Rotation.from_euler("z", yaw).as_quat())

    def fix(f: r.Record) -> r.Record:
        angle = rate * (f.stamp_ns - start) / NS
        north, east = (
            radius * np.sin(angle) / 111_081.0,
            radius * np.cos(angle) / (111_320.0 * np.cos(np.radians(42.0))),
        )
        return dataclasses.replace(f, status=0, latitude=42.0 + north, longitude=-71.0 + east)

    changes = {"imu/data": compass, "gps/fix": fix}
    return {t: [(at, changes.get(t, lambda x: x)(x)) for at, x in pairs] for t, pairs in good.items()}


def test_a_right_compass_in_a_circle_is_not_suspected(good):
    assert errors(log_of(circling(good))) == []


def test_pitch_with_the_bow_up_positive_is_recognised_by_the_depth(good):
    def flipped(c: r.Record) -> r.Record:
        roll, pitch, yaw = Rotation.from_quat(c.orientation).as_euler("xyz")
        return dataclasses.replace(c, orientation=Rotation.from_euler("xyz", [roll, -pitch, yaw]).as_quat())

    assert any("bow-up positive" in e for e in errors(log_of(good, "imu/data", flipped)))


def test_a_body_frame_of_forward_right_down_is_recognised(good):
    def over(c: r.Record) -> r.Record:
        turned = Rotation.from_quat(c.orientation) * Rotation.from_euler("x", np.pi)
        return dataclasses.replace(c, orientation=turned.as_quat())

    assert any("on its back" in e for e in errors(log_of(good, "imu/data", over)))


def test_a_frozen_compass_is_recognised(good):
    first = good["imu/data"][0][1].orientation
    log = log_of(good, "imu/data", lambda c: dataclasses.replace(c, orientation=first))
    assert any("never changes" in e for e in errors(log))


def test_fixes_at_null_island_are_errors(good):
    log = log_of(good, "gps/fix", lambda f: dataclasses.replace(f, status=0, latitude=0.0, longitude=0.0))
    assert any("latitude 0, longitude 0" in e for e in errors(log))


def test_bearings_in_degrees_are_recognised(good):
    log = log_of(good, "sonar/detections", lambda p: dataclasses.replace(p, bearing_max=np.degrees(p.bearing_max)))
    assert any("degrees" in e for e in errors(log))


def test_stamps_of_the_future_and_of_zero_and_gaps_are_found(good):
    ahead = log_of(good, "pressure", lambda p: dataclasses.replace(p, stamp_ns=p.stamp_ns + NS))
    assert "after the time of logging" in texts(ahead)
    unset = log_of(good, "pressure", lambda p: dataclasses.replace(p, stamp_ns=0))
    assert any("stamps of zero" in e for e in errors(unset))
    start = good["pressure"][0][1].stamp_ns
    silent = log_of(good, "pressure", lambda p: None if 20 * NS < p.stamp_ns - start < 40 * NS else p)
    assert "silent for 20." in texts(silent)


def test_a_clock_that_jumps_back_is_named(good):
    middle = good["pressure"][len(good["pressure"]) // 2][1].stamp_ns
    log = log_of(
        good, "pressure", lambda p: dataclasses.replace(p, stamp_ns=p.stamp_ns - 60 * NS * (p.stamp_ns > middle))
    )
    assert "the clock jumped back by" in texts(log)


def test_an_empty_bag_and_a_truncated_one_are_told_apart(fbn, tmp_path):
    with BagWriter(tmp_path / "empty"):
        pass
    status, _, err = fbn("check", tmp_path / "empty")
    assert status == 1 and "empty" in err
    (tmp_path / "cut").mkdir()
    sample = project_root() / "bags" / "charles_river_2006"  # long enough for several chunks: whole ones are read
    data = next(sample.glob("*.mcap")).read_bytes()
    (tmp_path / "cut" / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    verdict = check_bag(tmp_path / "cut")
    assert verdict.log.traffic, "the good part is read"
    assert any("damaged" in f.text for f in verdict.findings)


def test_a_topic_of_another_type_is_an_error_with_the_type_expected(tmp_path, short_bag):
    with BagReader(short_bag) as source, BagWriter(tmp_path / "bag") as bag:
        for log_ns, topic, record in source.records(["imu/data", "pressure", "actuators", "altitude"]):
            bag.write(
                log_ns, "pressure" if topic == "altitude" else "altitude" if topic == "pressure" else topic, record
            )
    verdict = check_bag(tmp_path / "bag")
    assert not verdict.can_navigate
    assert any(f.topic == "pressure" and "expected sensor_msgs/msg/FluidPressure" in f.text for f in verdict.findings)
