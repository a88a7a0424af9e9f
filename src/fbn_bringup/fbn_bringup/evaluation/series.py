"""Time series of a run as arrays: poses with covariance, innovations, and the traffic of a topic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from fbn_common.records import Innovation, Odometry, Pose, PoseWithCovarianceStamped, Verdict
from fbn_common.types import NS, Array

Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Poses over time in one frame: stamps (n,) [ns], strictly increasing, and arrays of the same length.

    ``covariance`` (n, 6, 6) is in ROS order: x, y, z [m], rotations about the frame's fixed axes [rad].
    """

    stamp_ns: Stamps
    position: Array  # (n, 3) m
    orientation: Array  # (n, 4) x, y, z, w
    covariance: Array  # (n, 6, 6)

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def rotation(self) -> Rotation:
        """R_world_base of every sample."""
        return Rotation.from_quat(self.orientation)

    def where(self, keep: Mask | Stamps) -> Track:
        """The samples kept by a mask (n,), or those of these indices."""
        return Track(self.stamp_ns[keep], self.position[keep], self.orientation[keep], self.covariance[keep])

    def between(self, start_ns: int, end_ns: int) -> Track:
        """The samples with start <= stamp <= end."""
        return self.where((self.stamp_ns >= start_ns) & (self.stamp_ns <= end_ns))

    def within(self, other: Track) -> Track:
        """The samples inside the other track's span of time, where it can be interpolated."""
        if not len(other):
            return self.where(np.zeros(len(self), dtype=bool))
        return self.between(int(other.stamp_ns[0]), int(other.stamp_ns[-1]))

    def at(self, stamp_ns: Stamps) -> Track:
        """Poses at these stamps, all inside the span: linear in position, on the shortest arc in orientation.

        The covariance is that of the sample before.
        """
        if len(self) == 1:
            return self.where(np.zeros(len(stamp_ns), dtype=np.int64))
        times, wanted = (self.stamp_ns - self.stamp_ns[0]) / NS, (stamp_ns - self.stamp_ns[0]) / NS
        position = np.stack([np.interp(wanted, times, axis) for axis in self.position.T], axis=-1)
        orientation = Slerp(times, self.rotation)(wanted).as_quat()
        before = np.clip(np.searchsorted(self.stamp_ns, stamp_ns, side="right") - 1, 0, len(self) - 1)
        return Track(stamp_ns, position, orientation, self.covariance[before])

    def shifted(self, offset: Array) -> Track:
        """The same track moved by an offset (3,) [m]."""
        return Track(self.stamp_ns, self.position + offset, self.orientation, self.covariance)

    def distance(self) -> Array:
        """Horizontal way covered since the first sample (n,) [m]; at 1 Hz, so that jitter does not add to it."""
        keep = every(self.stamp_ns, NS)
        steps = np.linalg.norm(np.diff(self.position[keep, :2], axis=0), axis=1)
        way = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(self.stamp_ns, self.stamp_ns[keep], way)


def every(stamp_ns: Stamps, period_ns: int) -> Stamps:
    """Indices of samples about a period apart: the first, the last, and the first of each period between."""
    if not len(stamp_ns):
        return np.zeros(0, dtype=np.int64)
    _, first = np.unique((stamp_ns - stamp_ns[0]) // period_ns, return_index=True)
    return np.unique(np.append(first, len(stamp_ns) - 1)).astype(np.int64)


def track(records: Sequence[Odometry] | Sequence[PoseWithCovarianceStamped]) -> Track:
    """The track of records; out-of-order ones are sorted, and of equal stamps the last stays."""
    stamps = np.array([r.stamp_ns for r in records], dtype=np.int64)
    poses: list[Pose] = [r.pose for r in records]
    covariances = [r.pose_covariance if isinstance(r, Odometry) else r.covariance for r in records]
    made = Track(
        stamps,
        np.array([p.position for p in poses]).reshape(-1, 3),
        np.array([p.orientation for p in poses]).reshape(-1, 4),
        np.array(covariances).reshape(-1, 6, 6),
    )
    order = np.argsort(stamps, kind="stable")
    last_of_equal = np.append(np.diff(stamps[order]) > 0, True)[: len(order)]
    return made.where(order[last_of_equal])


@dataclass(frozen=True, slots=True, eq=False)
class Innovations:
    """All answers to one sensor's measurements in one estimator, in the order published."""

    node: str
    sensor: str
    stamp_ns: Stamps
    nis: Array  # (n,)
    dof: npt.NDArray[np.int64]  # (n,)
    verdict: npt.NDArray[np.int64]  # (n,)
    reason: tuple[str, ...]
    innovation: tuple[Array, ...]
    sigma: tuple[Array, ...]

    def has(self, verdict: Verdict) -> Mask:
        """Mask (n,) of the measurements with this verdict."""
        return np.asarray(self.verdict == verdict)


def innovations(node: str, sensor: str, records: Sequence[Innovation]) -> Innovations:
    """The table of one sensor's innovation records."""
    return Innovations(
        node,
        sensor,
        np.array([r.stamp_ns for r in records], dtype=np.int64),
        np.array([r.nis for r in records]),
        np.array([r.dof for r in records], dtype=np.int64),
        np.array([int(r.verdict) for r in records], dtype=np.int64),
        tuple(r.reason for r in records),
        tuple(r.innovation for r in records),
        tuple(r.sigma for r in records),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Traffic:
    """When a topic's messages were measured and logged."""

    topic: str
    stamp_ns: Stamps
    log_ns: Stamps

    @property
    def rate(self) -> float:
        """Messages per second of the topic's own span [Hz]; 0 for fewer than two."""
        span = int(self.log_ns[-1] - self.log_ns[0]) if len(self.log_ns) > 1 else 0
        return (len(self.log_ns) - 1) * NS / span if span > 0 else 0.0

    @property
    def latency(self) -> Array:
        """Time from measurement to log (n,) [s]."""
        return np.asarray((self.log_ns - self.stamp_ns) / NS)

    def longest_gap(self) -> float:
        """The longest time between two consecutive messages [s]."""
        return float(np.diff(np.sort(self.log_ns)).max() / NS) if len(self.log_ns) > 1 else 0.0
