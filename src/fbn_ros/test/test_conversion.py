"""Records become messages and come back the same; what cannot be a record is refused by name."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

from fbn_common import records as r
from fbn_ros.cdr import Cdr
from fbn_ros.conversion import Conversion, ConversionError, MessageFactory
from fbn_ros.definitions import RosbagsMessages
from fbn_ros.messages import RclpyMessages
from fbn_testing.compare import difference
from fbn_testing.examples import RECORD_TYPES, example
from fbn_testing.logs import sensor_record

RNG = np.random.default_rng(7)


@pytest.fixture(params=[RosbagsMessages, RclpyMessages], ids=["rosbags", "rclpy"], scope="module")
def factory(request: pytest.FixtureRequest) -> MessageFactory:
    return request.param()  # type: ignore[no-any-return]


@pytest.mark.parametrize("kind", RECORD_TYPES, ids=lambda k: k.__name__)
@pytest.mark.parametrize("items", [0, 3])
def test_a_record_comes_back_from_its_message_as_it_was(
    kind: type[r.Record], items: int, factory: MessageFactory
) -> None:
    conversion = Conversion(factory)
    record = example(kind, RNG, items)
    assert difference(record, conversion.to_record("t", kind, conversion.to_message(record))) == ""


@pytest.mark.parametrize("kind", RECORD_TYPES, ids=lambda k: k.__name__)
def test_ros_and_the_bag_library_write_bytes_that_the_other_reads(kind: type[r.Record]) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    cdr, ros = Cdr(), Conversion(RclpyMessages())
    record = example(kind, RNG)
    assert difference(record, cdr.decode("t", kind, bytes(serialize_message(ros.to_message(record))))) == ""
    message = deserialize_message(cdr.encode(record), ros.factory.message(kind.ros_type))
    assert difference(record, ros.to_record("t", kind, message)) == ""


def test_arrays_come_back_fresh_aligned_and_writable() -> None:
    cdr = Cdr()
    motion = cdr.decode("t", r.PredictedMotion, cdr.encode(example(r.PredictedMotion, RNG)))
    for array in (motion.noise, motion.increment, motion.jacobian_velocity):
        assert array.flags.c_contiguous and array.flags.aligned and array.flags.writeable and array.flags.carray


@pytest.mark.parametrize("kind", [r.PredictedMotion, r.Odometry])
def test_a_record_made_of_its_numbers_is_the_one_made_of_its_fields(kind: type[r.Packed]) -> None:
    record = example(kind, RNG)
    others = {f.name: getattr(record, f.name) for f in dataclasses.fields(kind) if f.name not in kind.layout}
    packed = kind.packed(record.numbers, **others)
    assert difference(packed, record) == ""
    assert difference(pickle.loads(pickle.dumps(kind.packed(record.numbers, **others))), record) == ""
    changed = dataclasses.replace(packed, stamp_ns=3)
    assert (changed.stamp_ns, changed.numbers.tolist()) == (3, record.numbers.tolist())
    with pytest.raises(AttributeError, match="nonsense"):
        packed.nonsense  # noqa: B018


FLAT = (
    *(r.PredictedMotion, r.PingMotion, r.VehicleParameters, r.Odometry, r.ReferenceFix, r.PoseWithCovarianceStamped),
    *(r.Imu, r.FluidPressure, r.Innovation),
)


@pytest.mark.parametrize("kind", FLAT, ids=lambda k: k.__name__)
def test_the_quick_way_writes_the_bytes_of_the_slow_way(kind: type[r.Record]) -> None:
    cdr = Cdr()
    for _ in range(20):  # frame ids of all lengths, so every alignment
        record = example(kind, RNG)
        slow = cdr.serialiser.write(cdr.conversion.to_message(record), kind.ros_type)
        assert cdr.encode(record) == slow
        assert cdr.quick(kind) is not None
        assert difference(cdr.quick(kind).decode(slow), record) == ""


@pytest.mark.parametrize(
    "kind", [r.PredictedMotion, r.PingMotion, r.Odometry, r.Imu, r.Innovation], ids=lambda k: k.__name__
)
def test_the_quick_way_refuses_what_the_slow_way_refuses_and_by_the_same_name(kind: type[r.Record]) -> None:
    cdr = Cdr()
    record = example(kind, RNG)
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            spoilt = dataclasses.replace(record, **{field.name: np.full_like(value, np.nan)})  # type: ignore[arg-type]
            with pytest.raises(ConversionError) as caught:
                cdr.decode("t", kind, cdr.encode(spoilt))
            assert caught.value.field == field.name
    data = cdr.encode(record)
    for length in (0, 3, 10, 30, len(data) - 1):
        with pytest.raises(ConversionError, match="the bytes of a"):
            cdr.decode("t", kind, data[:length])


def test_single_precision_shows_in_what_a_subscriber_gets() -> None:
    swept = dataclasses.replace(example(r.CompositeMeasurement, RNG).swept, width=1, height=1, scans=np.array([1 / 3]))
    composite = dataclasses.replace(example(r.CompositeMeasurement, RNG), swept=swept)
    assert Cdr().as_sent(composite).swept.scans[0] == np.float32(1 / 3)


def test_records_of_double_precision_are_passed_on_untouched() -> None:
    odometry = example(r.Odometry, RNG)
    assert Cdr().as_sent(odometry) is odometry


def changed(topic: str, **fields: Any) -> r.Record:
    return dataclasses.replace(sensor_record(topic, 5_000_000_000, 3, RNG), **fields)  # type: ignore[arg-type]


NAN = float("nan")
BAD = {
    "a pressure that is no number": (changed("pressure", fluid_pressure=NAN), "fluid_pressure"),
    "a negative variance": (changed("pressure", variance=-1.0), "variance"),
    "a quaternion of zero norm": (changed("imu/data", orientation=np.zeros(4)), "orientation"),
    "a quaternion far from unit norm": (changed("imu/data", orientation=np.array([0, 0, 0, 2.0])), "orientation"),
    "a NaN in a quaternion": (changed("imu/data", orientation=np.array([NAN, 0, 0, 1.0])), "orientation"),
    "a NaN in a covariance": (
        changed("imu/data", orientation_covariance=np.full((3, 3), NAN)),
        "orientation_covariance",
    ),
    "a negative diagonal": (changed("gps/fix", position_covariance=-np.eye(3)), "position_covariance"),
    "an impossible latitude": (changed("gps/fix", latitude=91.0), "latitude"),
    "a range that is no number": (changed("altitude", range=NAN), "range"),
    "more velocities than names": (changed("actuators", velocity=np.zeros(4)), "velocity"),
    "an infinite rate": (changed("actuators", velocity=np.array([np.inf, 0, 0])), "velocity"),
    "a negative travel time": (changed("lbl/range", travel_delay=-0.1), "travel_delay"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_malformed_measurement_is_refused_by_topic_and_field(case: str, factory: MessageFactory) -> None:
    record, field = BAD[case]
    conversion = Conversion(factory)
    message = conversion.to_message(record)
    with pytest.raises(ConversionError) as caught:
        conversion.to_record("some/topic", type(record), message)
    assert (caught.value.topic, caught.value.field) == ("some/topic", field)
    assert caught.value.stamp_ns == 5_000_000_000


ABSENT = {
    "no orientation": changed("imu/data", orientation=np.zeros(4), orientation_covariance=-np.eye(3)),
    "no rates": changed("imu/data", angular_velocity=np.full(3, NAN), angular_velocity_covariance=-np.eye(3)),
    "no fix, so no position": changed("gps/fix", status=-1, latitude=NAN, longitude=NAN),
    "no altitude in a fix": changed("gps/fix", altitude=NAN),
    "bottom out of reach": changed("altitude", range=float("inf")),
    "no effort": changed("actuators", effort=np.full(3, NAN)),
}


@pytest.mark.parametrize("case", ABSENT)
def test_what_a_message_may_leave_out_is_not_refused(case: str) -> None:
    conversion = Conversion(RosbagsMessages())
    record = ABSENT[case]
    conversion.to_record("t", type(record), conversion.to_message(record))


def test_a_covariance_of_the_wrong_size_is_refused() -> None:
    conversion = Conversion(RosbagsMessages())
    good = example(r.CompositeMeasurement, RNG, 2)
    message = conversion.to_message(dataclasses.replace(good, covariance=np.eye(18)))
    with pytest.raises(ConversionError, match="covariance: expected 19"):
        conversion.to_record("tracking/composite", r.CompositeMeasurement, message)
    message.covariance = np.zeros(17)
    with pytest.raises(ConversionError, match="covariance: expected a square matrix, got 17 numbers"):
        conversion.to_record("tracking/composite", r.CompositeMeasurement, message)


def test_an_error_inside_a_list_says_where() -> None:
    conversion = Conversion(RosbagsMessages())
    message = conversion.to_message(example(r.TrackedFeatures, RNG, 3))
    message.features[1].stage = 9
    with pytest.raises(ConversionError, match=r"features.1.stage: expected 0 \(INFANT\)"):
        conversion.to_record("tracking/features", r.TrackedFeatures, message)


@pytest.mark.parametrize("length", [0, 3, 20, 200])
def test_bytes_that_end_early_are_refused(length: int) -> None:
    cdr = Cdr()
    data = cdr.encode(sensor_record("imu/data", 1, 0, RNG))
    with pytest.raises(ConversionError, match="the bytes of a sensor_msgs/msg/Imu"):
        cdr.decode("imu/data", r.Imu, data[:length])


def test_a_stamp_with_more_than_a_second_of_nanoseconds_is_refused() -> None:
    conversion = Conversion(RosbagsMessages())
    message = conversion.to_message(sensor_record("pressure", 1, 0, RNG))
    message.header.stamp.nanosec = 2_000_000_000
    with pytest.raises(ConversionError, match=r"header\.stamp\.nanosec"):
        conversion.to_record("pressure", r.FluidPressure, message)
