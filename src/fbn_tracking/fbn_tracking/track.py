"""The tracker's own records: arrays, pings, looks, detections and tracks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import exp
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.lapack import dtrtri

from fbn_common.kernels import kernel
from fbn_common.lie import matrix_from_quaternion, product
from fbn_common.records import PingMotion, Pose, SonarDetections
from fbn_common.sonar import SonarArray
from fbn_common.types import NS, Array, Mat3, Mat4, Vec3
from fbn_tracking.factors import inverse, whitener
from fbn_tracking.geometry import carried, elevation_shape
from fbn_tracking.heading import given_deviation, information_given_deviation
from fbn_tracking.parameters import FeatureParameters

if TYPE_CHECKING:
    from fbn_tracking.motion_check import MotionCheck

_LEAST_VARIANCE = 1e-12  # m^2, rad^2: below it a covariance is not invertible in double precision


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One array's view at one ping; ``limits``: range min, max, bearing min, max, elevation shape a, c."""

    index: int  # of the ping
    array: str
    mount: Mat4  # T_base_array
    limits: Array
    detection_probability: float


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """An echo with its look; ``z``: r, phi, their sigmas, elevation shape a, c."""

    look: Look
    stamp_ns: int
    z: Array

    @property
    def index(self) -> int:
        """Of the ping."""
        return self.look.index


@dataclass(slots=True, eq=False)
class Ping:
    """A pose of the window: how the vehicle came here from the ping before, and what the arrays looked at."""

    index: int
    stamp_ns: int
    motion: PingMotion
    dt: float  # s since the ping before
    increment: Vec3
    R_increment: Mat3
    link_covariance: Array
    link_whitener: Array
    earth_mean: Array
    earth_whitener: Array
    travelled: Array  # (2,): variance of position [m^2] and heading [rad^2] gathered since the start of the chain
    looks: list[Look] = field(default_factory=list)

    @property
    def sees_floor(self) -> bool:
        """Whether the altimeter saw the bottom."""
        return self.motion.altitude_variance >= 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """One elevation at which a track may lie: unknowns (5) and their world point with covariance (5, 5)."""

    x: Array  # r, phi, theta, drift slack x, y
    point: Vec3
    covariance: Array
    given_poses: Mat3  # covariance of the point were the poses and the drift exact
    energy: float
    static: float
    cost: float  # minus log posterior: half the energy, looks that missed it, prior


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """Where a feature lay at the end of the window before: for matching, never for fusing."""

    point: Vec3
    covariance: Mat3
    stamp_ns: int


@dataclass(slots=True, eq=False)
class Track:
    """An infant, a feature, or a feature that has to be found again after a cut (it has a memory)."""

    key: int
    first_seen_ns: int
    last_seen_ns: int
    seen: int = 0  # detections in all its life
    score: float = 0.0
    detections: list[Detection] = field(default_factory=list)  # in this window
    misses: list[Look] = field(default_factory=list)  # looks of this window that should have seen it and did not
    modes: list[Mode] = field(default_factory=list)  # likeliest first
    placed_drift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # of their poses [m/s]
    motion: MotionCheck | None = None  # of an infant with enough detections
    memory: Memory | None = None
    graduated: bool = False  # its variable is in the graph
    retired: bool = False

    @property
    def anchor(self) -> int:
        """Index of the ping that saw it first in this window."""
        return self.detections[0].index

    @property
    def existence(self) -> float:
        """Probability that there is something."""
        return 1.0 / (1.0 + exp(-min(max(self.score, -50.0), 50.0)))


def make_look(message: SonarDetections, index: int, array: SonarArray, feature: FeatureParameters) -> Look:
    """The look of a message; what it leaves out (not positive, not ordered) comes from the array's parameters."""
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = array.rotation_base_array, array.position_base
    limits = np.array([array.range_min, array.range_max, array.bearing_min, array.bearing_max, 0.0, 0.0])
    if 0.0 <= message.range_min < message.range_max < np.inf:
        limits[:2] = message.range_min, message.range_max
    if 0.0 <= message.bearing_min < message.bearing_max <= np.pi:
        limits[2:4] = message.bearing_min, message.bearing_max
    lobe = message.lobe_width if 0.0 < message.lobe_width < np.pi else array.lobe_width
    limits[4:] = elevation_shape(0.5 * lobe, feature.alpha, feature.elevation == "cubic")
    return Look(index, message.frame_id, mount, limits, array.detection_probability)


def first_ping(motion: PingMotion, deviation: float) -> Ping:
    """A ping that starts a chain; its earth measurement is all that is known, given yaw's deviation.

    ``deviation``: its variance [rad^2]; with 0 the dead service's own information is taken.
    """
    information = motion.earth_information
    if deviation or motion.previous_ns != motion.stamp_ns:  # where a chain broke, what the filter knows starts one
        information = inverse(given_deviation(motion.earth_covariance, deviation) + _LEAST_VARIANCE * np.eye(4))
    none = np.zeros((6, 6))
    return Ping(
        0, motion.stamp_ns, motion, 0.0, np.zeros(3), np.eye(3), none, none,
        motion.earth.copy(), whitener(information), np.zeros(2),
    )  # fmt: skip


def next_ping(before: Ping, motion: PingMotion, deviation: float) -> Ping:
    """The ping after ``before``, linked to it by the dead service's increment; ``deviation`` as in `first_ping`."""
    information = motion.earth_information
    if deviation:
        information = information_given_deviation(before.motion, motion, motion.increment_covariance, deviation)
    covariance = motion.increment_covariance + _LEAST_VARIANCE * np.eye(6)
    gathered = np.array([0.5 * (covariance[0, 0] + covariance[1, 1]), covariance[5, 5]])
    return Ping(
        before.index + 1,
        motion.stamp_ns,
        motion,
        (motion.stamp_ns - before.stamp_ns) / NS,
        np.ascontiguousarray(motion.increment.position),
        matrix_from_quaternion(motion.increment.orientation),
        covariance,
        inverse_root(covariance),
        motion.earth.copy(),
        whitener(information),
        before.travelled + gathered,
    )


def inverse_root(covariance: Array) -> Array:
    """``W`` with ``W^T W`` the inverse of a covariance (n, n); what rounding made indefinite carries no information."""
    try:
        W, _ = dtrtri(np.linalg.cholesky(covariance), lower=1)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return np.ascontiguousarray((vectors / np.sqrt(np.where(values > 0.0, values, np.inf))).T)
    return np.ascontiguousarray(W)


def pose_matrix(pose: Pose) -> Mat4:
    """The pose as a matrix (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix_from_quaternion(pose.orientation), pose.position
    return T


@kernel
def array_pose(T_world_base: Mat4, mount: Mat4) -> tuple[Mat3, Vec3]:
    """Rotation and position of an array in the world, C-ordered."""
    return product(T_world_base, mount), carried(T_world_base, mount[:3, 3])


def stack_poses(looks: Iterable[Look], poses: Mapping[int, Mat4]) -> tuple[Array, Array]:
    """Array rotations (n, 3, 3) and positions (n, 3) of looks, from poses by ping index."""
    pairs = [array_pose(poses[look.index], look.mount) for look in looks]
    return np.array([R for R, _ in pairs]).reshape(-1, 3, 3), np.array([p for _, p in pairs]).reshape(-1, 3)
