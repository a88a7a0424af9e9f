"""Quality of service by a topic's role; for rclpy and as a bag states it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fbn_common.graph import Qos, Topic

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile
    from rosbags.interfaces import Qos as BagQos

LEASE_S = 2.0  # s: a publisher that gives no sign of life so long is gone
LOCK_STEP_DEPTH = 2000  # messages: no node is more than a few steps behind, and a step holds some dozens


def profile(topic: Topic, *, lock_step: bool = False, lease: bool = False) -> QoSProfile:
    """The rclpy profile of a topic; with ``lease``, liveliness is offered or asked.

    In lock step all topics are reliable, deep, and kept for late joiners.
    """
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

    best_effort = topic.qos is Qos.SENSOR and not lock_step
    latched = topic.qos is Qos.LATCHED or lock_step
    chosen = QoSProfile(
        depth=LOCK_STEP_DEPTH if lock_step else topic.depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    if lease and topic.qos is not Qos.SENSOR and not lock_step:
        chosen.liveliness = LivelinessPolicy.AUTOMATIC
        chosen.liveliness_lease_duration = Duration(seconds=LEASE_S)
    return chosen


def bag_qos(topic: Topic) -> BagQos:
    """What a bag says of a topic, so that whoever plays it offers the same."""
    from rosbags.interfaces import Qos as BagQos
    from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(2147483647, 4294967295)
    return BagQos(
        history=QosHistory.KEEP_LAST,
        depth=topic.depth,
        reliability=QosReliability.BEST_EFFORT if topic.qos is Qos.SENSOR else QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if topic.qos is Qos.LATCHED else QosDurability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )
