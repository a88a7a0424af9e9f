"""Conversions of the standard messages, by hand: their records are flatter than they are."""

from __future__ import annotations

from typing import Any

import numpy as np

from fbn_common import records as r
from fbn_ros import conversion as c

Conversions = dict[type, c.Fields]


def conversions(factory: c.MessageFactory) -> Conversions:
    """The functions for every record of a standard type."""
    sensors = _imu(factory) | _fluid_pressure(factory) | _range(factory) | _nav_sat_fix(factory) | _joint_state(factory)
    return sensors | _odometry(factory) | _pose_stamped(factory) | _vector_stamped(factory)


def _matrix(factory: c.MessageFactory, ros_type: str, field: str, n: int) -> c.Codec:
    return c.array_codec((n, n), factory.numbers(ros_type, field))


def _imu(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.Imu.ros_type), c.header_codec(factory)
    quaternion, vector = c.quaternion_codec(factory), c.vector_codec(factory)
    matrix = _matrix(factory, r.Imu.ros_type, "orientation_covariance", 3)

    def to_message(record: r.Imu) -> Any:
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            orientation=quaternion.encode(record.orientation),
            orientation_covariance=matrix.encode(record.orientation_covariance),
            angular_velocity=vector.encode(record.angular_velocity),
            angular_velocity_covariance=matrix.encode(record.angular_velocity_covariance),
            linear_acceleration=vector.encode(record.linear_acceleration),
            linear_acceleration_covariance=matrix.encode(record.linear_acceleration_covariance),
        )

    def to_record(m: Any) -> r.Imu:
        stamp_ns, frame_id = header.decode(m.header)
        return r.Imu(
            stamp_ns,
            frame_id,
            orientation=quaternion.decode(m.orientation),
            orientation_covariance=c.named("orientation_covariance", matrix, m.orientation_covariance),
            angular_velocity=vector.decode(m.angular_velocity),
            angular_velocity_covariance=c.named("angular_velocity_covariance", matrix, m.angular_velocity_covariance),
            linear_acceleration=vector.decode(m.linear_acceleration),
            linear_acceleration_covariance=c.named(
                "linear_acceleration_covariance", matrix, m.linear_acceleration_covariance
            ),
        )

    return {r.Imu: c.Fields(to_message, to_record)}


def _fluid_pressure(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.FluidPressure.ros_type), c.header_codec(factory)

    def to_message(record: r.FluidPressure) -> Any:
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            fluid_pressure=float(record.fluid_pressure),
            variance=float(record.variance),
        )

    def to_record(m: Any) -> r.FluidPressure:
        stamp_ns, frame_id = header.decode(m.header)
        return r.FluidPressure(stamp_ns, frame_id, float(m.fluid_pressure), float(m.variance))

    return {r.FluidPressure: c.Fields(to_message, to_record)}


def _range(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.Range.ros_type), c.header_codec(factory)
    numbers = ("field_of_view", "min_range", "max_range", "range")

    def to_message(record: r.Range) -> Any:
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            radiation_type=int(record.radiation_type),
            **{name: float(getattr(record, name)) for name in numbers},
            variance=0.0,  # unknown
        )

    def to_record(m: Any) -> r.Range:
        stamp_ns, frame_id = header.decode(m.header)
        values = {name: float(getattr(m, name)) for name in numbers}
        return r.Range(stamp_ns, frame_id, int(m.radiation_type), **values)

    return {r.Range: c.Fields(to_message, to_record)}


def _nav_sat_fix(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.NavSatFix.ros_type), c.header_codec(factory)
    status = factory.message("sensor_msgs/msg/NavSatStatus")
    matrix = _matrix(factory, r.NavSatFix.ros_type, "position_covariance", 3)

    def to_message(record: r.NavSatFix) -> Any:
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            status=status(status=int(record.status), service=1),  # 1: GPS
            latitude=float(record.latitude),
            longitude=float(record.longitude),
            altitude=float(record.altitude),
            position_covariance=matrix.encode(record.position_covariance),
            position_covariance_type=int(record.position_covariance_type),
        )

    def to_record(m: Any) -> r.NavSatFix:
        stamp_ns, frame_id = header.decode(m.header)
        covariance = c.named("position_covariance", matrix, m.position_covariance)
        place = (float(m.latitude), float(m.longitude), float(m.altitude))
        return r.NavSatFix(
            stamp_ns, frame_id, int(m.status.status), *place, covariance, int(m.position_covariance_type)
        )

    return {r.NavSatFix: c.Fields(to_message, to_record)}


def _joint_state(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.JointState.ros_type), c.header_codec(factory)
    array = c.array_codec((-1,), factory.numbers(r.JointState.ros_type, "position"))

    def to_message(record: r.JointState) -> Any:
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            name=list(record.name),
            position=array.encode(record.position),
            velocity=array.encode(record.velocity),
            effort=array.encode(record.effort),
        )

    def to_record(m: Any) -> r.JointState:
        stamp_ns, frame_id = header.decode(m.header)
        arrays = (array.decode(m.position), array.decode(m.velocity), array.decode(m.effort))
        return r.JointState(stamp_ns, frame_id, tuple(m.name), *arrays)

    return {r.JointState: c.Fields(to_message, to_record)}


def _odometry(factory: c.MessageFactory) -> Conversions:
    message, header, pose = factory.message(r.Odometry.ros_type), c.header_codec(factory), c.pose_codec(factory)
    with_pose = factory.message("geometry_msgs/msg/PoseWithCovariance")
    with_twist = factory.message("geometry_msgs/msg/TwistWithCovariance")
    twist, vector = factory.message("geometry_msgs/msg/Twist"), c.vector_codec(factory)
    matrix = _matrix(factory, "geometry_msgs/msg/PoseWithCovariance", "covariance", 6)

    def to_message(record: r.Odometry) -> Any:
        velocity = twist(linear=vector.encode(record.twist[:3]), angular=vector.encode(record.twist[3:]))
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            child_frame_id=record.child_frame_id,
            pose=with_pose(pose=pose.encode(record.pose), covariance=matrix.encode(record.pose_covariance)),
            twist=with_twist(twist=velocity, covariance=matrix.encode(record.twist_covariance)),
        )

    def to_record(m: Any) -> r.Odometry:
        stamp_ns, frame_id = header.decode(m.header)
        linear, angular = m.twist.twist.linear, m.twist.twist.angular
        return r.Odometry(
            stamp_ns,
            frame_id,
            str(m.child_frame_id),
            pose=pose.decode(m.pose.pose),
            twist=np.concatenate((vector.decode(linear), vector.decode(angular))),
            pose_covariance=c.named("pose.covariance", matrix, m.pose.covariance),
            twist_covariance=c.named("twist.covariance", matrix, m.twist.covariance),
        )

    return {r.Odometry: c.Fields(to_message, to_record)}


def _pose_stamped(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.PoseWithCovarianceStamped.ros_type), c.header_codec(factory)
    with_pose, pose = factory.message("geometry_msgs/msg/PoseWithCovariance"), c.pose_codec(factory)
    matrix = _matrix(factory, "geometry_msgs/msg/PoseWithCovariance", "covariance", 6)

    def to_message(record: r.PoseWithCovarianceStamped) -> Any:
        return message(
            header=header.encode((record.stamp_ns, record.frame_id)),
            pose=with_pose(pose=pose.encode(record.pose), covariance=matrix.encode(record.covariance)),
        )

    def to_record(m: Any) -> r.PoseWithCovarianceStamped:
        stamp_ns, frame_id = header.decode(m.header)
        covariance = c.named("pose.covariance", matrix, m.pose.covariance)
        return r.PoseWithCovarianceStamped(stamp_ns, frame_id, pose.decode(m.pose.pose), covariance)

    return {r.PoseWithCovarianceStamped: c.Fields(to_message, to_record)}


def _vector_stamped(factory: c.MessageFactory) -> Conversions:
    message, header = factory.message(r.Vector3Stamped.ros_type), c.header_codec(factory)
    vector = c.vector_codec(factory)

    def to_message(record: r.Vector3Stamped) -> Any:
        return message(header=header.encode((record.stamp_ns, record.frame_id)), vector=vector.encode(record.vector))

    def to_record(m: Any) -> r.Vector3Stamped:
        stamp_ns, frame_id = header.decode(m.header)
        return r.Vector3Stamped(stamp_ns, frame_id, vector.decode(m.vector))

    return {r.Vector3Stamped: c.Fields(to_message, to_record)}
