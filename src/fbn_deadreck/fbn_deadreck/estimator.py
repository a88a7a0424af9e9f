"""Dead reckoning: a smooth, continuous pose that never jumps, and the dead service at each ping."""

from __future__ import annotations

from collections import deque
from functools import cache

import numpy as np

from fbn_common.estimator import Output
from fbn_common.graph import GRAPH
from fbn_common.motion_ekf.core import State
from fbn_common.motion_ekf.filter import MotionFilter
from fbn_common.motion_ekf.intake import Intake
from fbn_common.motion_ekf.layout import BEACON_ROW, ESTIMATED_DEADRECK, SIZE_DEADRECK, X_VELOCITY
from fbn_common.motion_ekf.output import pose_of
from fbn_common.motion_ekf.sensors import Unusable, altitude_data
from fbn_common.motion_ekf.warm_up import rehearse
from fbn_common.records import PingMotion, Range, Record, SonarDetections, Verdict
from fbn_common.types import nanoseconds, seconds
from fbn_deadreck.dead_service import (
    earth_covariance,
    earth_information,
    earth_of,
    identity,
    increment,
    lasting_errors,
    pose_of_increment,
)
from fbn_deadreck.parameters import DeadreckParameters

PING_MOTION = "deadreck/ping_motion"


class Deadreck(MotionFilter):
    """EKF over pose, velocity and angular actuation; damping, thrust, water and sensor errors are considered.

    So are x and y: what compass and depth tell of the way already gone would make the track jump.
    """

    name = "deadreck"
    frame_id = "odom"
    size = SIZE_DEADRECK
    estimated = ESTIMATED_DEADRECK

    def __init__(self, parameters: DeadreckParameters, *, rehearsed: bool = True) -> None:
        self.own = parameters
        ranks = {topic: i for i, topic in enumerate(GRAPH.node("fbn_deadreck").inputs)}
        super().__init__(parameters, ranks, BEACON_ROW)
        if rehearsed:
            _rehearse()

    def _restart(self) -> None:
        super()._restart()
        self._pings: list[int] = []
        self._answered_ns = -1
        self._last: State | None = None
        self._altitudes: deque[tuple[int, float, float]] = deque(maxlen=200)

    def take(self, topic: str, record: Record, now_ns: int) -> list[Output]:
        """A ping asks for an answer; pings of several arrays at one stamp ask once."""
        if not isinstance(record, SonarDetections):
            return []
        stamp = record.stamp_ns
        if stamp > now_ns + nanoseconds(self.parameters.history.ahead):
            return [self.answers.say(stamp, "sonar", Verdict.REFUSED, "stamp too far ahead of the clock")]
        if self.ekf.head_ns >= 0 and stamp < max(self.ekf.base.stamp_ns, self.ekf.head_ns - self.ekf.history_ns):
            return [self.answers.say(stamp, "sonar", Verdict.LATE, "ping older than the history")]
        if stamp < self._answered_ns:
            return [self.answers.say(stamp, "sonar", Verdict.LATE, "a later ping has been answered")]
        if stamp > self._answered_ns and stamp not in self._pings:
            self._pings.append(stamp)
        return []

    def services(self, now_ns: int) -> list[Output]:
        """The dead service for each ping that the head has passed by the delay."""
        due = self.ekf.head_ns - nanoseconds(self.own.ping_delay)
        ready = sorted(s for s in self._pings if s <= due)
        self._pings = [s for s in self._pings if s > due]
        out = []
        for stamp in ready:
            if stamp < self.ekf.base.stamp_ns:
                out.append(self.answers.say(stamp, "sonar", Verdict.REFUSED, "ping before the filter's start"))
            else:
                out.append(Output(PING_MOTION, self._ping_motion(stamp)))
        return out

    def _ping_motion(self, stamp_ns: int) -> PingMotion:
        after = self.ekf.state_at(stamp_ns)
        before = self._last
        if before is not None and before.stamp_ns < max(self.ekf.base.stamp_ns, self.ekf.head_ns - self.ekf.history_ns):
            before = None  # the chain broke: a new one begins
        own_covariance = earth_covariance(after.x, after.covariance)
        if before is None:
            step, information = identity(), np.linalg.inv(own_covariance)
        else:
            step = increment(before, self.ekf.open_loop(before, stamp_ns), after, self.own.growth_horizon)
            information = earth_information(before, after, step)
        self._last, self._answered_ns = after, stamp_ns
        altitude, variance = self._altitude_at(stamp_ns)
        lasting = lasting_errors(after)
        return PingMotion(
            stamp_ns=stamp_ns,
            frame_id="odom",
            previous_ns=stamp_ns if before is None else before.stamp_ns,
            increment=pose_of_increment(step),
            pose=pose_of(after.x),
            altitude=altitude,
            altitude_variance=variance,
            drift_time_constant=self.own.drift_time_constant,
            increment_covariance=step.covariance,
            earth=earth_of(after.x),
            earth_information=0.5 * (information + information.T),
            earth_covariance=own_covariance,
            velocity=after.x[X_VELOCITY : X_VELOCITY + 6].copy(),
            drift_covariance=lasting.drift,
            heading_deviation=lasting.heading,
            heading_drift=lasting.heading_drift,
        )

    def measure(self, intake: Intake, topic: str, record: Record, now_ns: int) -> list[Output]:
        """As the base class; altitudes are kept for the pings too."""
        if isinstance(record, Range):
            self._keep_altitude(record)
        return super().measure(intake, topic, record, now_ns)

    def _keep_altitude(self, record: Range) -> None:
        try:
            data = altitude_data(record, self.parameters.altimeter)
        except Unusable:
            return
        if data is not None:
            self._altitudes.append((record.stamp_ns, float(data[0]), float(data[1])))

    def _altitude_at(self, stamp_ns: int) -> tuple[float, float]:
        """The nearest altitude and its variance; variance -1 where there is none of late."""
        window = nanoseconds(self.own.altitude_age)
        near = [(abs(s - stamp_ns), -s, a, v) for s, a, v in self._altitudes if abs(s - stamp_ns) <= window]
        if not near:
            return 0.0, -1.0
        age, _, altitude, variance = min(near)
        slope = self.parameters.altimeter.slope * seconds(age)  # a metre a second over ground, at most
        return altitude, variance + slope**2


@cache
def _rehearse() -> None:
    """Once in a process, so that no first ping is late."""

    def pings(stamp_ns: int) -> list[tuple[str, Record]]:
        return [("sonar/detections", SonarDetections(stamp_ns, "", 0, 1.0, 40.0, -0.1, 0.1, 0.3, ()))]

    rehearse(Deadreck(DeadreckParameters(), rehearsed=False), pings)
