"""A window's measurements and estimate as arrays, in the layout that the elimination's kernels take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fbn_common.types import Array, Mat4, Vec2, Vec3
from fbn_tracking.elimination import BASE, LOOK, MOTION, Whole, moved_poses
from fbn_tracking.factors import inverse, whitener
from fbn_tracking.track import Detection, Ping, Track


class State(NamedTuple):
    """An estimate: poses in the world (n, 4, 4), drift (3) [m/s], features (m, 3): r, phi, theta at their anchors."""

    T: Array
    drift: Vec3
    q: Array

    def moved(self, border: Array, poses: Array, layout: Layout) -> State:
        """After a step of the border's columns and of all poses (n, 6)."""
        q = self.q + border[layout.features[:, None] + np.arange(3)]
        return State(moved_poses(self.T, poses), self.drift + border[:3], q)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A state with the names of its rows: index of the first ping, and features by key."""

    state: State
    first: int
    rows: Mapping[int, int]

    def T(self, index: int) -> Mat4:
        """T_world_base at a ping."""
        return np.asarray(self.state.T[index - self.first])

    def q(self, key: int) -> Vec3:
        """A feature's r, phi, theta at its anchor."""
        return np.asarray(self.state.q[self.rows[key]])

    def poses(self) -> dict[int, Mat4]:
        """All poses by index."""
        return dict(enumerate(self.state.T, self.first))


class Layout(NamedTuple):
    """The border's columns: drift, then in the order of time each pose that stays and the features it saw first."""

    poses: Whole  # (n,): first column, -1 of poses that are eliminated
    features: Whole  # (m,): first column
    top: Whole  # (n,): columns in use once a pose has come
    width: int

    def columns(self, poses: Sequence[int], features: Sequence[int]) -> Whole:
        """Columns of these rows of poses, the drift, and these rows of features, in this order."""
        blocks = [self.poses[row] + np.arange(6) for row in poses]
        return np.concatenate((*blocks, np.arange(3), *(self.features[row] + np.arange(3) for row in features)))


@dataclass(slots=True)
class Rows:
    """An array that grows by rows at constant cost."""

    data: NDArray[Any]
    size: int = 0

    @classmethod
    def of(cls, data: NDArray[Any]) -> Rows:
        """These rows to begin with."""
        return cls(data, len(data))

    def add(self, row: Array | Sequence[int]) -> None:
        """Append one row."""
        if self.size == len(self.data):
            self.data = np.concatenate((self.data, np.zeros_like(self.data[: max(1, self.size)])))
        self.data[self.size] = row
        self.size += 1

    def view(self) -> NDArray[Any]:
        """The rows so far."""
        return self.data[: self.size]


@dataclass(slots=True)
class System:
    """All measurements of a window; rows of pings, detections and features in the order in which they came."""

    base: Array
    weak: float  # rad: loose bound on theta at the first detection
    motion: Rows = field(default_factory=lambda: Rows(np.zeros((64, MOTION))))
    looks: Rows = field(default_factory=lambda: Rows(np.zeros((64, LOOK))))
    at: Rows = field(default_factory=lambda: Rows(np.zeros((64, 4), np.int64)))
    anchors: list[int] = field(default_factory=list)  # row of each feature's first pose

    def add_ping(self, ping: Ping, linked: bool, earth: bool) -> None:
        """Append a pose, linked to the one before, with its earth measurement."""
        row = np.zeros(MOTION)
        if linked:
            row[:3], row[3:12], row[12] = ping.increment, ping.R_increment.ravel(), ping.dt
            row[13:49] = ping.link_whitener.ravel()
        if earth:
            row[49:53], row[53:] = ping.earth_mean, ping.earth_whitener.ravel()
        self.motion.add(row)

    def add_feature(self, track: Track, first: int) -> None:
        """Bring in a feature with its detections; ``first``: index of the window's first ping."""
        self.anchors.append(track.anchor - first)
        for detection in track.detections:
            self.add_detection(track, detection, len(self.anchors) - 1, first)

    def add_detection(self, track: Track, detection: Detection, feature: int, first: int) -> None:
        """One detection of the feature in this row."""
        origin = track.detections[0]
        row = np.concatenate((origin.look.mount.ravel(), detection.look.mount.ravel(), detection.z))
        self.looks.add(row)
        self.at.add((detection.index - first, origin.index - first, feature, detection is origin))

    def part(self, pings: int) -> tuple[System, Whole]:
        """What the first so many pings know, and the rows of the features they have."""
        features = np.flatnonzero(np.array(self.anchors, np.int64) < pings)
        at = self.at.view()
        mine = at[:, 0] < pings
        renamed = np.zeros(len(self.anchors), np.int64)
        renamed[features] = np.arange(len(features))
        at = at[mine]
        at[:, 2] = renamed[at[:, 2]]
        motion, looks = Rows.of(self.motion.view()[:pings]), Rows.of(self.looks.view()[mine])
        return System(self.base, self.weak, motion, looks, Rows.of(at), [self.anchors[f] for f in features]), features

    def layout(self, kept: Iterable[int]) -> Layout:
        """The border with these rows of poses, besides the features' anchors."""
        n, column = self.motion.size, 3
        poses, features, top = np.full(n, -1, np.int64), np.zeros(len(self.anchors), np.int64), np.full(n, 3, np.int64)
        begins = sorted({*kept, *self.anchors})
        for row in begins:
            poses[row], column = column, column + 6
            for feature, anchor in enumerate(self.anchors):
                if anchor == row:
                    features[feature], column = column, column + 3
            top[row:] = column
        return Layout(poses, features, top, column)

    def sorted_looks(self) -> tuple[Array, Whole, Whole]:
        """Detections by pose: rows, where they belong, and the start of each pose's."""
        at = self.at.view()
        order = np.argsort(at[:, 0], kind="stable")
        starts = np.searchsorted(at[order, 0], np.arange(self.motion.size + 1)).astype(np.int64)
        return self.looks.view()[order], at[order], starts


def base_row(xy: Vec2, mean: Array, covariance: Array) -> Array:
    """What is put in at the first pose: its x and y, and the prior on z, roll, pitch, yaw and drift (7)."""
    row = np.concatenate((xy, mean, whitener(inverse(covariance)).ravel()))
    assert len(row) == BASE
    return row
