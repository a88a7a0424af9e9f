"""The thread of dead reckoning that the states hang on: where their pose is in it, and how they move along it."""

from __future__ import annotations

from collections.abc import Callable
from math import exp

import numpy as np

from fbn_common.records import CompositeMeasurement, Odometry, Pose
from fbn_common.types import Array, seconds
from fbn_global.odometry import History, Link, Reckoned, carry, link, pose_vector, positive_part
from fbn_global.parameters import MotionParameters
from fbn_global.state import DRIFT, HEAD, State, advance_head, decay_drift, restart

Step = Callable[[State], State]


class Reckoning:
    """History of odometry, dead reckoning at the time of the states' pose (``start``), and the drift's model."""

    def __init__(self, parameters: MotionParameters) -> None:
        self.p = parameters
        self.history = History(parameters.history_s)
        self.start: Reckoned | None = None
        self._stationary = parameters.drift_sigma**2 * np.eye(3)
        self._time_constant = parameters.drift_time_constant
        self._last: CompositeMeasurement | None = None

    @property
    def now(self) -> Reckoned | None:
        """The latest dead reckoning there is."""
        return self.history.latest or self.start

    def jumped(self, odometry: Odometry) -> bool:
        """Whether this odometry is farther from the last one than the vehicle can have gone: a new origin."""
        last = self.history.latest
        return last is not None and self.too_far(last, pose_vector(odometry.pose), odometry.stamp_ns)

    def too_far(self, start: Reckoned, pose: Array, stamp_ns: int) -> bool:
        """Whether the vehicle can't have gone from one to the other."""
        moved = float(np.hypot(*(pose[:2] - start.pose[:2])))
        return moved > 1.0 + self.p.speed_limit * seconds(stamp_ns - start.stamp_ns)

    def at_end(self, stamp_ns: int, pose: Pose) -> Reckoned:
        """Dead reckoning at a composite's end, as the composite has it; surge's heading from the odometry."""
        known, vector = self.history.at(stamp_ns), pose_vector(pose)
        if known is not None:
            return Reckoned(stamp_ns, vector, known.heading, known.variance)
        last = self.start or Reckoned(stamp_ns, vector, np.zeros(2), np.zeros(4))
        bow = np.array([np.cos(vector[5]), np.sin(vector[5])])
        return Reckoned(stamp_ns, vector, last.heading + seconds(stamp_ns - last.stamp_ns) * bow, last.variance)

    def tie(self, end: Reckoned) -> tuple[Reckoned, Link]:
        """From the states' pose to another time."""
        assert self.start is not None
        return self.start, link(self.start, end, self._stationary, self._time_constant, self.p.noise)

    def carried(self, state: State, end: Reckoned) -> tuple[Array, Array]:
        """Pose (6,) and covariance (6, 6) of a state at another time."""
        start, tie = self.tie(end)
        pose, jacobian, noise = carry(state, start, end, tie)
        return pose, jacobian @ state.covariance[:HEAD, :HEAD] @ jacobian.T + noise

    def move_to(self, end: Reckoned) -> Step:
        """The step that moves a state's pose to another time; from now on the states' pose is there."""
        start, tie = self.tie(end)
        decay, stationary = exp(-abs(tie.duration_s) / self._time_constant), self._stationary
        self.start = end

        def move(state: State) -> State:
            if tie.duration_s == 0.0:
                return state
            pose, jacobian, noise = carry(state, start, end, tie)
            moved = advance_head(state, jacobian, pose - jacobian @ state.mean[:HEAD], noise, ())
            return decay_drift(moved, decay, stationary)

        return move

    def drift_elapses(self, composite: CompositeMeasurement) -> Step:
        """The drift's step to a composite's window, as the tracker let it relax; a tighter prior was renewed."""
        prior = 0.5 * (composite.prior_covariance[4:, 4:] + composite.prior_covariance[4:, 4:].T)
        before, self._last = self._last, composite
        self._time_constant = composite.drift_time_constant
        if composite.first or before is None or before.stamp_ns != composite.start_ns:
            self._stationary = prior
            return lambda state: state
        decay = exp(-seconds(before.stamp_ns - before.start_ns) / composite.drift_time_constant)
        wandered = prior - decay**2 * before.covariance[-3:, -3:]
        if np.linalg.eigvalsh(wandered)[0] < -1e-3 * np.trace(prior):
            mean = composite.prior_mean[4:]
            return lambda state: restart(state, DRIFT, mean, prior)
        stationary = positive_part(wandered) / max(1.0 - decay**2, 1e-6)
        self._stationary = stationary
        return lambda state: decay_drift(state, decay, stationary)
