"""The graph, declared once: which node, which topics, which types, which quality of service.

The node adapters, the launch file, the supervisor, the offline runner, the replay, the test harness and the
topic tables of the docs all derive from :data:`GRAPH`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from fbn_common import records as r


class Qos(Enum):
    """Quality of service by role."""

    SENSOR = "best effort, keep last"
    FLOW = "reliable, deep enough for 10 s"
    LATCHED = "reliable, transient local"


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic's contract; ``depth`` is the number of messages kept (10 s of them for a flow).

    ``without`` says what its takers do when nothing comes.
    """

    name: str
    record: type[r.Record]
    qos: Qos
    depth: int
    about: str
    without: str = ""

    @property
    def ros_type(self) -> str:
        return self.record.ros_type


@dataclass(frozen=True, slots=True)
class Node:
    """One estimator's node; ``inputs`` in the order in which data of equal stamp is processed.

    ``feedback`` are inputs that close a loop: what is published during one step of a lock-step replay is used
    in the next.  ``period_s`` is that of the live timer that advances the estimator.
    """

    name: str
    package: str
    estimator: str  # module:class
    parameters: str  # module:class
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period_s: float
    about: str
    feedback: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Graph:
    """All topics, and the nodes in the order of the data's way through them."""

    topics: dict[str, Topic]
    nodes: tuple[Node, ...]

    def node(self, name: str) -> Node:
        """The node of this name (with or without the ``fbn_`` in front); KeyError names those there are."""
        for node in self.nodes:
            if name in (node.name, node.name.removeprefix("fbn_")):
                return node
        raise KeyError(f"no node {name!r}; there are {', '.join(n.name for n in self.nodes)}")

    def only(self, names: tuple[str, ...]) -> Graph:
        """The same graph with these nodes alone."""
        kept = {self.node(name).name for name in names}
        return Graph(self.topics, tuple(n for n in self.nodes if n.name in kept))

    def publisher(self, topic: str) -> Node | None:
        """Who publishes the topic; None for a sensor's."""
        return next((n for n in self.nodes if topic in n.outputs), None)

    def external_inputs(self) -> tuple[str, ...]:
        """Topics that some node wants and none of these nodes publishes: what a log must supply."""
        made = {topic for node in self.nodes for topic in node.outputs}
        wanted = dict.fromkeys(t for n in self.nodes for t in (*n.inputs, *n.feedback) if t not in made)
        return tuple(wanted)


def _innovations(node: str) -> Topic:
    return Topic(f"{node}/innovations", r.Innovation, Qos.FLOW, 1000, f"every measurement's answer in {node}")


_TOPICS: Final = (
    Topic(
        "imu/data",
        r.Imu,
        Qos.SENSOR,
        100,
        "3-axis compass: orientation with covariance",
        "attitude by prediction alone, heading drifts",
    ),
    Topic("pressure", r.FluidPressure, Qos.SENSOR, 100, "absolute pressure", "depth by prediction alone"),
    Topic("altitude", r.Range, Qos.SENSOR, 100, "altimeter", "no bottom: up and down look alike to the sonar"),
    Topic(
        "gps/fix",
        r.NavSatFix,
        Qos.SENSOR,
        20,
        "GPS, while on the surface",
        "position by dead reckoning and beacons alone",
    ),
    Topic(
        "lbl/range",
        r.BeaconRange,
        Qos.SENSOR,
        50,
        "range to an acoustic beacon",
        "position by dead reckoning and GPS alone",
    ),
    Topic(
        "actuators",
        r.JointState,
        Qos.SENSOR,
        100,
        "propeller rate, and pan and tilt or fins",
        "motion at constant velocity, uncertainty grows fast",
    ),
    Topic(
        "sonar/detections",
        r.SonarDetections,
        Qos.SENSOR,
        100,
        "one per array and ping, also when empty",
        "no features, so no match to the map",
    ),
    Topic(
        "predict/motion",
        r.PredictedMotion,
        Qos.FLOW,
        1000,
        "motion increments with Jacobians and noise",
        "the filters stand still",
    ),
    Topic("predict/parameters", r.VehicleParameters, Qos.LATCHED, 10, "the parameters that predict now uses"),
    Topic(
        "deadreck/odometry",
        r.Odometry,
        Qos.FLOW,
        300,
        "smooth pose, odom to base_link",
        "the position on the map is not carried on between updates",
    ),
    Topic(
        "deadreck/ping_motion",
        r.PingMotion,
        Qos.FLOW,
        100,
        "the dead service, each ping",
        "no tracking: pings wait for their poses",
    ),
    Topic("reference/odometry", r.Odometry, Qos.FLOW, 300, "absolute pose, map to base_link; may jump"),
    Topic(
        "reference/parameters",
        r.VehicleParameters,
        Qos.LATCHED,
        10,
        "vehicle and water parameters, estimated",
        "prediction with the default parameters",
    ),
    Topic(
        "reference/fix",
        r.ReferenceFix,
        Qos.FLOW,
        100,
        "xy information gained",
        "position on the map from features alone",
    ),
    Topic(
        "reference/datum",
        r.Datum,
        Qos.LATCHED,
        1,
        "geodetic origin of map",
        "no place on a prior map until it comes",
    ),
    Topic("tracking/features", r.TrackedFeatures, Qos.FLOW, 50, "infants and features now"),
    Topic(
        "tracking/composite",
        r.CompositeMeasurement,
        Qos.FLOW,
        20,
        "path snippets with features",
        "the position on the map is not updated",
    ),
    Topic("global/pose", r.PoseWithCovarianceStamped, Qos.FLOW, 20, "pose on the map, each update"),
    Topic("global/odometry", r.Odometry, Qos.FLOW, 300, "dead reckoning carried onto the map"),
    Topic("global/map", r.FeatureMap, Qos.LATCHED, 1, "prior and found features"),
    Topic("global/hypotheses", r.MatchHypotheses, Qos.FLOW, 20, "the bank of hypotheses"),
    Topic("global/status", r.LocalizationStatus, Qos.LATCHED, 10, "matched or not, and the target"),
    *(_innovations(n) for n in ("predict", "deadreck", "reference", "tracking", "global")),
)

SIMULATOR_TOPICS: Final = (
    Topic("truth/odometry", r.Odometry, Qos.FLOW, 300, "true pose, map to base_link; no estimator takes it"),
    Topic("truth/water", r.Vector3Stamped, Qos.FLOW, 100, "true water velocity at the vehicle [m/s]"),
)

GRAPH: Final = Graph(
    topics={t.name: t for t in _TOPICS},
    nodes=(
        Node(
            "fbn_predict",
            "fbn_predict",
            "fbn_predict.estimator:Predict",
            "fbn_predict.parameters:PredictParameters",
            inputs=("actuators",),
            feedback=("reference/parameters", "deadreck/odometry"),
            outputs=("predict/parameters", "predict/motion", "predict/innovations"),
            period_s=0.01,
            about="integrates forces and torques into motion between measurements",
        ),
        Node(
            "fbn_deadreck",
            "fbn_deadreck",
            "fbn_deadreck.estimator:Deadreck",
            "fbn_deadreck.parameters:DeadreckParameters",
            inputs=("predict/parameters", "predict/motion", "imu/data", "pressure", "altitude", "sonar/detections"),
            outputs=("deadreck/odometry", "deadreck/ping_motion", "deadreck/innovations"),
            period_s=1 / 30,
            about="smooth, continuous pose that never jumps",
        ),
        Node(
            "fbn_reference",
            "fbn_reference",
            "fbn_reference.estimator:Reference",
            "fbn_reference.parameters:ReferenceParameters",
            inputs=("predict/parameters", "predict/motion", "imu/data", "pressure", "altitude", "gps/fix", "lbl/range"),
            outputs=(
                "reference/datum",
                "reference/odometry",
                "reference/parameters",
                "reference/fix",
                "reference/innovations",
            ),
            period_s=1 / 30,
            about="absolute xy and the vehicle's and the water's parameters",
        ),
        Node(
            "fbn_tracking",
            "fbn_tracking",
            "fbn_tracking.estimator:Tracking",
            "fbn_tracking.parameters:TrackingParameters",
            inputs=("deadreck/ping_motion", "sonar/detections"),
            outputs=("tracking/features", "tracking/composite", "tracking/innovations"),
            period_s=0.1,
            about="decides which detections are real things, and where",
        ),
        Node(
            "fbn_global",
            "fbn_global",
            "fbn_global.estimator:Global",
            "fbn_global.parameters:GlobalParameters",
            inputs=("reference/datum", "reference/fix", "tracking/composite", "deadreck/odometry"),
            outputs=(
                "global/map",
                "global/pose",
                "global/odometry",
                "global/hypotheses",
                "global/status",
                "global/innovations",
            ),
            period_s=1 / 30,
            about="where on the prior map, and how sure",
        ),
    ),
)
