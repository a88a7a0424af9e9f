"""What travels between estimators: one frozen record per message, plain numbers and arrays, no ROS.

Every record is the image of one ROS message (:attr:`Record.ros_type`), field for field and name for name, so
that one generic conversion serves all messages of ``fbn_msgs``; standard messages have a conversion of their
own in ``fbn_ros``.  In messages, ``stamp_ns`` and ``frame_id`` are the header, another ``*_ns`` field is a
``builtin_interfaces/Time`` without the suffix, :class:`Pose` is ``geometry_msgs/Pose``, an array is a flat
row-major ``float64[]`` (fixed size where the shape here is fixed) and an enumeration is ``uint8`` with
constants of the same names.

Units are SI and radians.  Covariances are row-major in the order named beside them.  Frames: ``map`` and
``odom`` are ENU, ``base_link`` is forward, left, up.  A *rotation vector* is in the frame named and
perturbs on the right: ``R Exp(theta)``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from math import prod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from fbn_common.types import Array, Mat2, Mat3, Mat4, Mat6, Quaternion, Vec2, Vec3, Vec6


def shaped(*shape: int) -> Any:
    """A field holding a float64 array of this shape; -1 is any length, and (-1, -1) a square matrix."""
    return field(metadata={"shape": shape})


def zeros(*shape: int) -> Any:
    """The same, zero where nothing is stated."""
    return field(metadata={"shape": shape}, default_factory=lambda: np.zeros(shape))


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A position [m] and an orientation (unit quaternion x, y, z, w)."""

    position: Vec3 = shaped(3)
    orientation: Quaternion = shaped(4)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Base of all stamped records; ``stamp_ns`` is the time of measurement [ns]."""

    ros_type: ClassVar[str] = ""
    stamp_ns: int


class Run(NamedTuple):
    """Where a field is among a message's numbers: ``numbers[start:stop]``; shape () is a single one, None a pose."""

    start: int
    stop: int
    shape: tuple[int, ...] | None


def laid_out(**shapes: tuple[int, ...] | None) -> dict[str, Run]:
    """The runs of fields of these shapes, one after the other."""
    runs, stop = {}, 0
    for name, shape in shapes.items():
        start, stop = stop, stop + (7 if shape is None else prod(shape))
        runs[name] = Run(start, stop, shape)
    return runs


class Packed(Record):
    """A record of many numbers, which come by the hundred a second and are mostly passed on without a look at them.

    It is made of its fields, as every record is, or of all its ``numbers`` in one run, in the order of its message
    (:attr:`layout`); what it was not made of is made when somebody asks for it.
    """

    __slots__ = ("numbers",)
    layout: ClassVar[dict[str, Run]]
    numbers: Array

    @classmethod
    def packed(cls, numbers: Array, **others: object) -> Self:
        """One of these numbers (n,), kept and not copied, and of the fields that are not among them."""
        record = object.__new__(cls)
        object.__setattr__(record, "numbers", numbers)
        for name, value in others.items():
            object.__setattr__(record, name, value)
        return record

    if not TYPE_CHECKING:  # a checker is to know the fields by their own types, and no others

        def __getattr__(self, name):
            value = self._numbers() if name == "numbers" else self._field(name)
            object.__setattr__(self, name, value)
            return value

    def _numbers(self) -> Array:
        parts = []
        for name, run in self.layout.items():
            value = getattr(self, name)
            parts += [value] if run.shape is not None else [value.position, value.orientation]
        return np.concatenate([np.asarray(part, np.float64).ravel() for part in parts])

    def _field(self, name: str) -> Array | Pose:
        run = self.layout.get(name)
        if run is None:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        start, stop, shape = run
        if shape is None:
            return Pose(self.numbers[start : start + 3], self.numbers[start + 3 : stop])
        return self.numbers[start:stop].reshape(shape)


def stacked(records: Iterable[Packed], width: int) -> Array:
    """The numbers of packed records, one a row (n, width)."""
    return np.frombuffer(b"".join([record.numbers.data for record in records])).reshape(-1, width)


# --- sensors ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Imu(Record):
    """Three-axis compass: orientation of ``base_link`` in ENU; a first covariance element of -1 says absent."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/Imu"
    frame_id: str
    orientation: Quaternion = shaped(4)
    orientation_covariance: Mat3 = shaped(3, 3)  # rad^2, fixed axes x y z
    angular_velocity: Vec3 = shaped(3)  # rad/s, body
    angular_velocity_covariance: Mat3 = shaped(3, 3)
    linear_acceleration: Vec3 = shaped(3)  # m/s^2, body
    linear_acceleration_covariance: Mat3 = shaped(3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class FluidPressure(Record):
    """Absolute pressure."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/FluidPressure"
    frame_id: str
    fluid_pressure: float  # Pa
    variance: float  # Pa^2; 0 = unknown


@dataclass(frozen=True, slots=True, eq=False)
class Range(Record):
    """Altimeter along ``altimeter_link`` x; outside [min_range, max_range] there is no bottom."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/Range"
    frame_id: str
    radiation_type: int
    field_of_view: float  # rad
    min_range: float  # m
    max_range: float  # m
    range: float  # m


@dataclass(frozen=True, slots=True, eq=False)
class NavSatFix(Record):
    """GPS; a status below 0 is no fix, whatever the position says."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/NavSatFix"
    frame_id: str
    status: int
    latitude: float  # deg
    longitude: float  # deg
    altitude: float  # m
    position_covariance: Mat3 = shaped(3, 3)  # m^2, ENU
    position_covariance_type: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class JointState(Record):
    """Actuators by name: ``propeller`` (velocity), ``pan``, ``tilt``, ``rudder``, ``stern_plane`` (position)."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/JointState"
    frame_id: str
    name: tuple[str, ...]
    position: Array = shaped(-1)  # rad
    velocity: Array = shaped(-1)  # rad/s
    effort: Array = shaped(-1)


@dataclass(frozen=True, slots=True, eq=False)
class BeaconRange(Record):
    """Range to an acoustic beacon; it belongs to ``stamp - travel_delay / 2``."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/BeaconRange"
    frame_id: str
    beacon_id: str
    range: float  # m
    range_variance: float  # m^2
    travel_delay: float  # s, round trip


@dataclass(frozen=True, slots=True, eq=False)
class SonarDetection:
    """One echo of one ping in the array's frame (z along the array's axis)."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/SonarDetection"
    range: float  # m
    bearing: float  # rad, angle phi to the array's z axis
    range_sigma: float  # m
    bearing_sigma: float  # rad
    intensity: float  # 0..1


@dataclass(frozen=True, slots=True, eq=False)
class SonarDetections(Record):
    """All echoes of one array and ping, also when there are none; ``frame_id`` names the array."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/SonarDetections"
    frame_id: str
    ping: int
    range_min: float  # m
    range_max: float  # m
    bearing_min: float  # rad
    bearing_max: float  # rad
    lobe_width: float  # rad, full width of theta around the axis
    detections: tuple[SonarDetection, ...]


# --- predict ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class PredictedMotion(Packed):
    """Motion over ``[start_ns, stamp_ns]``; rows of all matrices: increment 3, rotation vector 3, velocity 6.

    Velocity is over ground: linear 3 [m/s], angular 3 [rad/s], in the body frame.  Parameters: angular
    actuation 3, damping 6, linear actuation 3, water velocity 3 (map axes, m/s).
    """

    ros_type: ClassVar[str] = "fbn_msgs/msg/PredictedMotion"
    layout: ClassVar[dict[str, Run]] = laid_out(
        increment=(3,), rotation=(3,), velocity_start=(6,), velocity_end=(6,), parameters=(15,), attitude_start=(4,),
        jacobian_velocity=(12, 6), jacobian_attitude=(12, 3), jacobian_parameters=(12, 15), noise=(12, 12),
    )  # fmt: skip
    start_ns: int
    increment: Vec3 = shaped(3)  # m, body frame at start
    rotation: Vec3 = shaped(3)  # rad, body frame at start
    velocity_start: Vec6 = shaped(6)  # as used
    velocity_end: Vec6 = shaped(6)
    parameters: Array = shaped(15)  # as used
    jacobian_velocity: Array = shaped(12, 6)  # by the velocity at start
    jacobian_attitude: Array = shaped(12, 3)  # by the rotation vector of the attitude at start
    jacobian_parameters: Array = shaped(12, 15)
    noise: Array = shaped(12, 12)  # of all that is not among those
    attitude_start: Quaternion = shaped(4)  # as used, body to world


@dataclass(frozen=True, slots=True, eq=False)
class VehicleParameters(Record):
    """The 15 parameters of :class:`PredictedMotion`, valid from the stamp on, and further ones of compass and water.

    Further: coefficients of the compass's deviation by heading (1, sin, cos, sin 2, cos 2) [rad], the steady part of
    the water's velocity, about which it wanders, and the top layer's own motion, both east and north [m/s].
    """

    ros_type: ClassVar[str] = "fbn_msgs/msg/VehicleParameters"
    frame_id: str
    mean: Array = shaped(15)
    covariance: Array = shaped(15, 15)
    further: Array = zeros(9)
    further_covariance: Array = zeros(9, 24)  # with the 15, then among themselves; all zero = not stated


# --- dead reckoning and reference ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Odometry(Packed):
    """Pose of ``child_frame_id`` in ``frame_id`` and body velocity; covariances in ROS order (fixed axes)."""

    ros_type: ClassVar[str] = "nav_msgs/msg/Odometry"
    layout: ClassVar[dict[str, Run]] = laid_out(
        pose=None, pose_covariance=(6, 6), twist=(6,), twist_covariance=(6, 6)
    )  # fmt: skip
    frame_id: str
    child_frame_id: str
    pose: Pose
    twist: Vec6 = shaped(6)  # m/s, rad/s, body
    pose_covariance: Mat6 = shaped(6, 6)
    twist_covariance: Mat6 = shaped(6, 6)


@dataclass(frozen=True, slots=True, eq=False)
class PingMotion(Record):
    """The dead service: how the vehicle moved since the previous ping, and what was learnt of the earth frame.

    ``previous_ns == stamp_ns`` starts a chain: the increment is the identity and ``earth`` holds all that is
    known.  The true displacement over the ping interval dt is
    ``increment + (R^T (drift_x, drift_y, 0) + (drift_surge, 0, 0)) dt`` plus white noise of
    ``increment_covariance``, where the drift (world x, y and body forward velocity errors) is nearly
    constant: zero mean, ``drift_covariance``, correlation time ``drift_time_constant``.
    """

    ros_type: ClassVar[str] = "fbn_msgs/msg/PingMotion"
    frame_id: str
    previous_ns: int
    increment: Pose  # body frame of the previous ping
    pose: Pose  # odom
    altitude: float  # m; see altitude_variance
    altitude_variance: float  # m^2; negative = unknown
    drift_time_constant: float  # s
    increment_covariance: Mat6 = shaped(6, 6)  # xyz, rotation vector (right perturbation)
    earth: Vec3 = shaped(4)  # z, roll, pitch, yaw
    earth_information: Mat4 = shaped(4, 4)  # 0 = none
    earth_covariance: Mat4 = shaped(4, 4)  # the filter's marginal, for gating and linearising; never to be fused
    velocity: Vec6 = shaped(6)  # body, over ground
    drift_covariance: Mat3 = shaped(3, 3)  # m^2/s^2
    heading_deviation: float = 0.0  # rad, standard deviation of yaw's error that stays from ping to ping
    heading_drift: Vec3 = zeros(3)  # rad m/s, covariance of that error of yaw (true less stated) with the drift


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceFix(Record):
    """The xy information gained since the last fix, as an equivalent measurement of position in ``map``.

    ``marginal`` is all the publisher's doubt of its position, errors that last from fix to fix included: whoever
    is surer than that gains nothing by the fix.
    """

    ros_type: ClassVar[str] = "fbn_msgs/msg/ReferenceFix"
    frame_id: str
    xy: Vec2 = shaped(2)  # m
    covariance: Mat2 = shaped(2, 2)  # m^2, of the information gained alone
    marginal: Mat2 = shaped(2, 2)  # m^2, never to be fused


class Verdict(IntEnum):
    """What became of a measurement."""

    USED = 0
    GATED = 1  # well formed, but improbable: outside its gate
    REFUSED = 2  # malformed, or a rule forbids it; the reason says which
    LATE = 3  # older than the history


@dataclass(frozen=True, slots=True, eq=False)
class Innovation(Record):
    """One measurement's answer: innovation, its standard deviations, NIS and the verdict with its reason."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/Innovation"
    frame_id: str
    sensor: str
    nis: float
    dof: int
    verdict: Verdict
    reason: str
    innovation: Array = shaped(-1)
    sigma: Array = shaped(-1)


# --- tracking --------------------------------------------------------------------------------------------


class Stage(IntEnum):
    """How far an object has come in the tracker."""

    INFANT = 0
    FEATURE = 1
    RETIRED = 2


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFeature:
    """One object of the tracker, in ``odom``."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/TrackedFeature"
    key: int
    stage: Stage
    detections: int
    first_seen_ns: int
    last_seen_ns: int
    position: Vec3 = shaped(3)
    covariance: Mat3 = shaped(3, 3)
    rival_probability: float = 0.0  # that it lies at the other elevation that its echoes leave open; 0: there is none
    rival_position: Vec3 = zeros(3)  # there


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFeatures(Record):
    """Infants and features now; ``pings`` counts all pings so far."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/TrackedFeatures"
    frame_id: str
    pings: int
    features: tuple[TrackedFeature, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CompositeFeature:
    """What a composite says of one of its features, beside the mean and the covariance."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/CompositeFeature"
    key: int  # the same feature keeps its key from composite to composite
    detections: int  # within this composite
    expected: float  # pings of this composite that should have seen it, weighed by place in the beam
    first_seen_ns: int
    last_seen_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class SweptArea:
    """How often the sonar looked at each cell of an ENU grid, xy relative to the base."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/SweptArea"
    cell_size: float  # m
    width: int  # cells along x
    height: int  # cells along y
    origin: Vec2 = shaped(2)  # m, lower corner of cell (0, 0)
    scans: Array = shaped(-1)  # row-major, rows along y; float32 in the message


@dataclass(frozen=True, slots=True, eq=False)
class CompositeMeasurement(Record):
    """A snippet of path and features as one Gaussian; x and y are relative to the base (P2 of the one before).

    Order of ``mean`` and ``covariance``: base z, roll, pitch, yaw | P2 x, y, z, roll, pitch, yaw | features
    x, y, z each | drift (world x, y and body forward velocity error of dead reckoning, m/s).
    ``prior_mean`` and ``prior_covariance`` (base z, roll, pitch, yaw | drift) is the part of it that was put
    in from outside at the base; who already holds knowledge of the base divides it out.
    The first of a chain has ``first = True``: its base starts from nothing.
    """

    ros_type: ClassVar[str] = "fbn_msgs/msg/CompositeMeasurement"
    frame_id: str
    sequence: int
    start_ns: int  # of the base
    first: bool
    pings: int
    distance_travelled: float  # m
    drift_time_constant: float  # s
    features: tuple[CompositeFeature, ...]
    swept: SweptArea
    mean: Array = shaped(-1)  # 10 + 3 n + 3
    covariance: Array = shaped(-1, -1)
    prior_mean: Array = shaped(7)
    prior_covariance: Array = shaped(7, 7)
    base_odom: Pose = field(default_factory=lambda: Pose(np.zeros(3), np.array([0.0, 0, 0, 1])))  # dead-reckoned
    p2_odom: Pose = field(default_factory=lambda: Pose(np.zeros(3), np.array([0.0, 0, 0, 1])))  # dead-reckoned


# --- global ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Datum(Record):
    """Geodetic origin of ``map``."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/Datum"
    frame_id: str
    latitude: float  # deg
    longitude: float  # deg
    height: float  # m over the ellipsoid


@dataclass(frozen=True, slots=True, eq=False)
class MapFeature:
    """One feature of the map as now believed."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/MapFeature"
    id: int
    name: str
    prior: bool  # from the prior map; else found on this mission
    existence: float  # probability
    visibility: float  # detections per scan
    target: bool
    position: Vec3 = shaped(3)  # m, map


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMap(Record):
    """All features; ``covariance`` of the positions in their order (x, y, z each)."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/FeatureMap"
    frame_id: str
    datum_latitude: float  # deg
    datum_longitude: float  # deg
    datum_height: float  # m
    features: tuple[MapFeature, ...]
    covariance: Array = shaped(-1, -1)


@dataclass(frozen=True, slots=True, eq=False)
class MatchHypothesis:
    """One account of which tracked feature is which map feature."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/MatchHypothesis"
    id: int
    parent: int
    log_score: float  # NAPS: log ratio to the null hypothesis
    posterior: float
    positive: float
    negative: float
    map_ids: tuple[int, ...]
    feature_keys: tuple[int, ...]
    pose: Pose  # map
    pose_covariance: Mat6 = shaped(6, 6)  # ROS order


@dataclass(frozen=True, slots=True, eq=False)
class MatchHypotheses(Record):
    """The bank of hypotheses, best first; the one with no pairs is the null hypothesis."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/MatchHypotheses"
    frame_id: str
    hypotheses: tuple[MatchHypothesis, ...]


class Localization(IntEnum):
    """Where the global filter stands."""

    UNMATCHED = 0
    MATCHED = 1
    AMBIGUOUS = 2
    LOST = 3


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationStatus(Record):
    """Matched or not, how sure, and where the target is."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/LocalizationStatus"
    frame_id: str
    matched: bool
    state: Localization
    posterior: float
    features_matched: int
    target_id: int  # -1 = the map names none
    target_range: float  # m
    target_bearing: float  # rad, body, left positive
    seconds_since_matched: float  # s; negative = never
    reason: str  # why the state is what it is
    target_position: Vec3 = shaped(3)  # m, map
    target_covariance: Mat3 = shaped(3, 3)  # m^2
    target_position_body: Vec3 = shaped(3)  # m, base_link
    target_covariance_body: Mat3 = shaped(3, 3)  # m^2, of the target relative to the vehicle


@dataclass(frozen=True, slots=True, eq=False)
class PoseWithCovarianceStamped(Record):
    """A pose in ``frame_id``; covariance in ROS order (xyz, then fixed-axis rotations)."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseWithCovarianceStamped"
    frame_id: str
    pose: Pose
    covariance: Mat6 = shaped(6, 6)


@dataclass(frozen=True, slots=True, eq=False)
class Vector3Stamped(Record):
    """A vector in ``frame_id``."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Vector3Stamped"
    frame_id: str
    vector: Vec3 = shaped(3)


# --- replay ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class TopicCount:
    """How many messages of a topic."""

    ros_type: ClassVar[str] = "fbn_msgs/msg/TopicCount"
    topic: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class NodeProgress(Record):
    """Lock-step replay: ``node`` has taken in step ``step`` (data before the stamp) and published so much.

    The player sends it too, as ``player``: these are the messages sent so far, and time is now the stamp.
    """

    ros_type: ClassVar[str] = "fbn_msgs/msg/NodeProgress"
    frame_id: str
    node: str
    step: int
    published: tuple[TopicCount, ...]
