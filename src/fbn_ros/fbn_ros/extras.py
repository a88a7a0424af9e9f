"""What a node publishes beside its records, for people's tools: markers, and ``/tf`` where that is installed."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from fbn_common import records as r
from fbn_ros.markers import markers_of
from fbn_ros.overlay_markers import OverlayMarkers
from fbn_ros.tf import map_odom, odom_base, tf_message

Extra = Callable[[str, r.Record], None]

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

DRAWN = ("tracking/features", "tracking/composite", "global/map", "global/hypotheses")


def for_node(node: Node, outputs: tuple[str, ...]) -> Extra:
    """A function to be called with everything that a node with these outputs takes in or publishes."""
    made = (_markers(node, outputs), _overlays(node, outputs), _transforms(node, outputs))
    extras = [e for e in made if e is not None]

    def publish(topic: str, record: r.Record) -> None:
        for extra in extras:
            extra(topic, record)

    return publish


def _markers(node: Node, outputs: tuple[str, ...]) -> Extra | None:
    from visualization_msgs.msg import MarkerArray

    publishers = {t: node.create_publisher(MarkerArray, f"{t}/markers", _LATCHED) for t in DRAWN if t in outputs}
    if not publishers:
        return None

    def publish(topic: str, record: r.Record) -> None:
        publisher = publishers.get(topic)
        if publisher is not None and publisher.get_subscription_count():
            publisher.publish(markers_of(record))

    return publish


def _overlays(node: Node, outputs: tuple[str, ...]) -> Extra | None:
    """Each likely hypothesis's map, with what was swept, found and missed on it, from the global filter's node."""
    from visualization_msgs.msg import MarkerArray

    if "global/hypotheses" not in outputs:
        return None
    publisher, overlays = node.create_publisher(MarkerArray, "global/overlay/markers", _LATCHED), OverlayMarkers()

    def publish(topic: str, record: r.Record) -> None:
        overlays.take(record)
        if isinstance(record, r.MatchHypotheses) and publisher.get_subscription_count():
            markers = overlays.draw(record)
            if markers is not None:
                publisher.publish(markers)

    return publish


def _transforms(node: Node, outputs: tuple[str, ...]) -> Extra | None:
    """odom to base_link from dead reckoning's node, map to odom from the global filter's."""
    try:
        import tf2_msgs.msg as tf2
    except ImportError:
        return None
    if not {"deadreck/odometry", "global/odometry"} & set(outputs):
        return None
    publisher = node.create_publisher(tf2.TFMessage, "/tf", 100)
    dead_reckoned: dict[int, r.Odometry] = {}

    def publish(topic: str, record: r.Record) -> None:
        if topic == "deadreck/odometry" and topic in outputs and isinstance(record, r.Odometry):
            publisher.publish(tf_message(tf2, odom_base(record)))
        elif topic == "deadreck/odometry" and isinstance(record, r.Odometry):
            dead_reckoned[record.stamp_ns] = record
            if len(dead_reckoned) > 100:
                del dead_reckoned[min(dead_reckoned)]
        elif topic == "global/odometry" and isinstance(record, r.Odometry):
            partner = dead_reckoned.get(record.stamp_ns)
            if partner is not None:
                publisher.publish(tf_message(tf2, map_odom(record, partner)))

    return publish
