"""Logs come back as they were written; damaged and wrong ones say what is the matter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fbn_common import records as r
from fbn_ros.bag import BagError, BagReader, BagTopic, BagWriter
from fbn_ros.conversion import ConversionError
from fbn_testing.compare import first_difference
from fbn_testing.examples import example
from fbn_testing.logs import sensor_log, sensor_record, write_sensor_log

RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sensor_log(tmp_path_factory.mktemp("logs") / "log", 20.0)


def test_a_log_comes_back_as_it_was_written(log: Path) -> None:
    with BagReader(log) as reader:
        assert reader.topics["imu/data"] == BagTopic("sensor_msgs/msg/Imu", 200)
        assert first_difference(reader.records(), sensor_log(20.0)) == ""
        assert reader.truncated == ""


def test_messages_of_the_same_time_keep_their_order(tmp_path: Path) -> None:
    pressures = [sensor_record("pressure", k + 1, k, RNG) for k in range(30)]
    big = [example(r.PredictedMotion, RNG) for _ in range(600)]  # several chunks
    with BagWriter(tmp_path / "bag") as writer:
        for record in pressures:
            writer.write(1000, "pressure", record)
            for motion in big[:20]:
                writer.write(1000, "predict/motion", motion)
    with BagReader(tmp_path / "bag") as reader:
        assert [record.stamp_ns for _, _, record in reader.records(["pressure"])] == list(range(1, 31))


def test_a_namespace_stands_in_front_of_the_topics(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(1, "ranger/pressure", sensor_record("pressure", 1, 0, RNG))
        writer.write(2, "other/pressure", sensor_record("pressure", 2, 0, RNG))
    with BagReader(tmp_path / "bag", namespace="ranger") as reader:
        assert [(t, topic) for t, topic, _ in reader.records()] == [(1, "pressure")]
    with pytest.raises(BagError, match="it has /other/pressure, /ranger/pressure"):
        BagReader(tmp_path / "bag", namespace="rangr")


def test_a_missing_bag_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="no such bag"):
        BagReader(tmp_path / "nothing")


def test_a_directory_without_a_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="holds no bag"):
        BagReader(tmp_path)


def test_an_empty_bag_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag"):
        pass
    with pytest.raises(BagError, match="empty"):
        BagReader(tmp_path / "bag")


@pytest.mark.parametrize("content", [b"", b"not a bag at all, by any measure", b"\x89MCAP0\r\n"])
def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "log.mcap"
    file.write_bytes(content)
    with pytest.raises(BagError, match="not a readable bag"):
        BagReader(file)


def test_of_a_truncated_bag_the_good_part_is_read_and_the_loss_is_said(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        for k in range(2000):
            writer.write(k, "predict/motion", example(r.PredictedMotion, RNG))
    file = next((tmp_path / "bag").glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with BagReader(tmp_path / "bag") as reader:
        times = [t for t, _, _ in reader.records()]
        assert "is damaged" in reader.truncated
    assert times == list(range(len(times)))
    assert 300 < len(times) < 2000


def test_a_recording_that_was_killed_has_no_metadata_and_is_read_all_the_same(log: Path, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    file = next(log.glob("*.mcap"))
    (tmp_path / "bag" / "log.mcap").write_bytes(file.read_bytes()[:-100])
    with BagReader(tmp_path / "bag") as reader:
        assert first_difference(reader.records(), sensor_log(20.0)) == ""


def test_a_topic_of_another_type_is_refused_by_name(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(1, "imu/data", sensor_record("pressure", 1, 0, RNG))
    with (
        BagReader(tmp_path / "bag") as reader,
        pytest.raises(BagError, match=r"imu/data is sensor_msgs/msg/FluidPressure"),
    ):
        list(reader.records())


def test_malformed_messages_are_left_out_and_counted(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(1, "pressure", sensor_record("pressure", 1, 0, RNG))
        writer.write(2, "pressure", r.FluidPressure(2, "", float("nan"), 1.0))
        writer.write_raw(3, "pressure", r.FluidPressure.ros_type, b"\x00\x01\x00\x00junk")
        writer.write(4, "pressure", sensor_record("pressure", 4, 0, RNG))
    with BagReader(tmp_path / "bag") as reader:
        assert [t for t, _, _ in reader.records()] == [1, 4]
        assert reader.refused == {"pressure": 2}
        assert [isinstance(e.record, ConversionError) for e in reader.entries()] == [False, True, True, False]


def test_a_bag_is_never_overwritten(log: Path) -> None:
    with pytest.raises(BagError, match="cannot write a bag here"):
        BagWriter(log)
