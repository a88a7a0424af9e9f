"""One window of the tracking problem: a chain of poses, the drift, the features seen; smoothed after every ping.

Everything is kept as plain records too, so that the system can be built anew: for the cut, and after a failure.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from fbn_common.types import Array, Mat4, Vec3
from fbn_tracking import factors
from fbn_tracking.geometry import anchored_point
from fbn_tracking.solver import Solution, solve
from fbn_tracking.system import Estimate, State, System, base_row
from fbn_tracking.track import Detection, Ping, Track


@dataclass(frozen=True, slots=True, eq=False)
class Base:
    """What is put in from outside at a window's first pose: z, roll, pitch, yaw and drift (7), and its covariance.

    ``fresh``: the first of a chain, whose own earth measurement belongs to the window too.  ``deviation``: variance
    of yaw's error that stays [rad^2]; the covariance is that given this error.  ``by_drift``: how much of that error
    goes with the drift (3,) [rad s/m].
    """

    T: Mat4
    mean: Array
    covariance: Array
    fresh: bool
    deviation: float = 0.0
    by_drift: Vec3 = field(default_factory=lambda: np.zeros(3))


@dataclass(slots=True, eq=False)
class Window:
    """Poses, features and estimate of one window; ``pings`` by index, in order."""

    base: Base
    pings: dict[int, Ping]
    weak_theta_sigma: float
    features: dict[int, Track] = field(default_factory=dict)
    failures: int = 0
    system: System = field(init=False)
    estimate: Estimate = field(init=False)
    _rows: dict[int, int] = field(default_factory=dict)
    _solution: Solution | None = None
    _smoothed: int = 0  # pings taken in by the solution

    def __post_init__(self) -> None:
        self.system, self._rows = self._build(), {key: row for row, key in enumerate(self.features)}
        self.estimate = Estimate(dead_reckoned(self.base, list(self.pings.values())), self.first, self._rows)

    @property
    def first(self) -> int:
        """Index of the base's ping."""
        return next(iter(self.pings))

    @property
    def last(self) -> int:
        """Index of the latest ping."""
        return next(reversed(self.pings))

    def T(self, index: int) -> Mat4:
        """The estimate of a pose, T_world_base."""
        return self.estimate.T(index)

    def place(self, track: Track) -> Vec3:
        """The estimate of a feature's place in the world [m]."""
        point, _, _ = anchored_point(self.T(track.anchor), track.detections[0].look.mount, self.estimate.q(track.key))
        return point

    def drift(self) -> Vec3:
        """The estimate of the drift (3) [m/s]."""
        return self.estimate.state.drift

    def dead_reckoned(self) -> dict[int, Mat4]:
        """The poses by their links alone, T_world_base by index, no feature having said anything."""
        return dict(zip(self.pings, dead_reckoned(self.base, list(self.pings.values())).T, strict=True))

    def start(self, T: Array, drift: Vec3) -> None:
        """Begin with these initial values, of all poses and the drift, instead of dead reckoning's."""
        self._set(State(T, drift, self.estimate.state.q))

    def add_ping(self, ping: Ping) -> None:
        """Append a pose with its link and earth measurement."""
        T = propagate(self.T(self.last), self.drift(), ping)
        self.pings[ping.index] = ping
        self.system.add_ping(ping, linked=True, earth=True)
        state = self.estimate.state
        self._set(state._replace(T=np.concatenate((state.T, T[None]))))

    def add_feature(self, track: Track, q: Vec3) -> None:
        """Bring in a feature at ``q`` with all its detections."""
        track.graduated = True
        self._rows[track.key] = len(self.features)
        self.features[track.key] = track
        self.system.add_feature(track, self.first)
        state = self.estimate.state
        self._set(state._replace(q=np.concatenate((state.q, q[None]))))

    def add_detection(self, track: Track, detection: Detection) -> None:
        """One more detection of a feature of this window."""
        track.detections.append(detection)
        self.system.add_detection(track, detection, self._rows[track.key], self.first)

    def give_up(self, keys: Iterable[int]) -> None:
        """Forget these features and all they said; poses and drift start from dead reckoning again."""
        for key in keys:
            self.features.pop(key).retired = True
        q = np.array([self.estimate.q(key) for key in self.features]).reshape(-1, 3)
        self._solution = None
        self.__post_init__()
        self._set(self.estimate.state._replace(q=q))

    def update(self) -> None:
        """Smooth; a numerical failure is counted, and the features given up: the motion alone cannot fail."""
        try:
            self._solve()
        except RuntimeError:
            self.failures += 1
            self.give_up(list(self.features))
            self._solve()

    def smoothed(self, index: int) -> bool:
        """Whether the smoother has taken in this ping."""
        return self._solution is not None and index - self.first < self._smoothed

    def transition(self, index: int) -> tuple[Array, Array, Array]:
        """How a pose follows from the one before and the drift: Jacobians (6, 6), (6, 3), noise (6, 6)."""
        ping, before, here = self.pings[index], self.T(index - 1), self.T(index)
        _, H1, H2, Hb = factors.link_kernel(
            before, here, self.drift(), ping.increment, ping.R_increment, ping.dt, ping.link_whitener
        )
        inverse = np.linalg.inv(H2)
        return -inverse @ H1, -inverse @ Hb, inverse @ inverse.T

    def joint(self, index: int, tracks: list[Track]) -> Array:
        """Joint covariance of a pose, these tracks' other anchors, the drift and the tracks, in this order.

        Poses 6 (rotation vector, then translation, in the body frame), others 3.
        """
        if self._solution is None or self._solution.layout.poses[index - self.first] < 0:
            self._solve((index,))
        assert self._solution is not None
        columns = self._solution.layout.columns
        poses = dict.fromkeys([index, *(t.anchor for t in tracks)])
        root = self._solution.root(columns([i - self.first for i in poses], [self._rows[t.key] for t in tracks]))
        return root @ root.T

    def _solve(self, kept: tuple[int, ...] = ()) -> None:
        rows = [index - self.first for index in (self.last, *kept)]
        self._solution = solve(self.system, self.estimate.state, rows, exact=False)
        self._smoothed = len(self.pings)
        self._set(self._solution.state)

    def _set(self, state: State) -> None:
        self.estimate = Estimate(state, self.first, self._rows)

    def _build(self) -> System:
        """The system of all records."""
        base = self.base
        system = System(base_row(base.T[:2, 3], base.mean, base.covariance), self.weak_theta_sigma)
        for number, ping in enumerate(self.pings.values()):
            system.add_ping(ping, number > 0, number > 0 or base.fresh)
        for track in self.features.values():
            system.add_feature(track, self.first)
        return system


def propagate(T: Mat4, drift: Vec3, ping: Ping) -> Mat4:
    """The pose at ``ping`` from that at the ping before, by increment and drift."""
    current = T[:3, :3].T @ np.array([drift[0], drift[1], 0.0]) + np.array([drift[2], 0.0, 0.0])
    out = T.copy()
    out[:3, 3] += T[:3, :3] @ (ping.increment + current * ping.dt)
    out[:3, :3] = T[:3, :3] @ ping.R_increment
    return out


def dead_reckoned(base: Base, pings: list[Ping]) -> State:
    """Initial values of a chain: base, drift, and every pose by its link; no features."""
    T = [base.T]
    for ping in pings[1:]:
        T.append(propagate(T[-1], base.mean[4:], ping))
    return State(np.array(T), base.mean[4:].copy(), np.zeros((0, 3)))
