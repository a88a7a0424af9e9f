"""A filter's odometry as a stream: each multiple of the snapshots' period once, in order."""

from __future__ import annotations

import numpy as np

from fbn_common.estimator import Output
from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.layout import SNAPSHOT_NS, IntArray
from fbn_common.motion_ekf.output import odometry


class OdometryStream:
    """Odometry at each multiple of SNAPSHOT_NS that the head has passed since the last one."""

    def __init__(self, node: str, frame_id: str) -> None:
        self.topic, self.frame_id = f"{node}/odometry", frame_id
        self._newest_ns = -1

    def restart(self) -> None:
        """Go on with the filter's next start."""
        self._newest_ns = -1

    def passed(self, ekf: MotionEkf) -> IntArray:
        """Rows of the snapshots passed since the last call; those that the history has lost are left out."""
        first = self._newest_ns + SNAPSHOT_NS
        if self._newest_ns < 0:
            first = -(-ekf.base.stamp_ns // SNAPSHOT_NS) * SNAPSHOT_NS
        stamps = np.arange(first, ekf.head_ns + 1, SNAPSHOT_NS)
        if len(stamps):
            self._newest_ns = int(stamps[-1])
        rows = stamps // SNAPSHOT_NS % len(ekf.snapshots.stamp)
        return rows[ekf.snapshots.stamp[rows] == stamps]

    def publish(self, ekf: MotionEkf, *, wanted: bool) -> list[Output]:
        """What there is to publish now; where it is not wanted it is passed over."""
        rows = self.passed(ekf)
        if not len(rows) or not wanted:
            return []
        return [Output(self.topic, record) for record in odometry(ekf.snapshots, rows, self.frame_id)]
