"""The transforms of ``/tf`` from what is published anyway: odom to base_link, and map to odom (REP 105)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fbn_common.lie import matrix_from_quaternion, quaternion_from_matrix
from fbn_common.records import Odometry, Pose
from fbn_common.types import NS


class Transform(NamedTuple):
    """Takes coordinates of ``child`` to ``parent``."""

    stamp_ns: int
    parent: str
    child: str
    pose: Pose


def odom_base(odometry: Odometry) -> Transform:
    """What dead reckoning says, as it is."""
    return Transform(odometry.stamp_ns, odometry.frame_id, odometry.child_frame_id, odometry.pose)


def map_odom(on_map: Odometry, dead_reckoned: Odometry) -> Transform:
    """``T_map_odom = T_map_base T_odom_base^-1`` of two poses of the same time."""
    R_map_base = matrix_from_quaternion(on_map.pose.orientation)
    R_odom_base = matrix_from_quaternion(dead_reckoned.pose.orientation)
    R_map_odom = np.ascontiguousarray(R_map_base @ R_odom_base.T)
    position = on_map.pose.position - R_map_odom @ dead_reckoned.pose.position
    pose = Pose(position, quaternion_from_matrix(R_map_odom))
    return Transform(on_map.stamp_ns, on_map.frame_id, dead_reckoned.frame_id, pose)


def tf_message(tf2_msgs: Any, transform: Transform) -> Any:
    """The TFMessage of one transform; ``tf2_msgs.msg`` is passed in, for it is not installed everywhere."""
    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
    from geometry_msgs.msg import Transform as RosTransform
    from std_msgs.msg import Header

    x, y, z = transform.pose.position.tolist()
    qx, qy, qz, qw = transform.pose.orientation.tolist()
    stamp = Time(sec=transform.stamp_ns // NS, nanosec=transform.stamp_ns % NS)
    body = RosTransform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    header = Header(stamp=stamp, frame_id=transform.parent)
    return tf2_msgs.TFMessage(
        transforms=[TransformStamped(header=header, child_frame_id=transform.child, transform=body)]
    )
