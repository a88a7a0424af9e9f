"""Many odometry messages decoded at once: a run has a hundred thousand, and one by one they take most of its reading.

After stamp and frame names, ``nav_msgs/Odometry`` in CDR is 85 doubles: pose 7, its covariance 36, twist 6, its
covariance 36.  They are the message's last 680 bytes, wherever the names end.
"""

from __future__ import annotations

import numpy as np

from fbn_bringup.evaluation.series import Track

TAIL = 85 * 8  # bytes


class OdometryTable:
    """The odometry of one topic, collected as bytes."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._tails: list[bytes] = []

    def add(self, stamp_ns: int, data: bytes) -> None:
        """Take a message's bytes."""
        if len(data) >= TAIL:
            self._stamps.append(stamp_ns)
            self._tails.append(bytes(data[-TAIL:]))

    def track(self) -> Track:
        """The track, by stamp; rows that are not finite or have no orientation are left out."""
        values = np.frombuffer(b"".join(self._tails), dtype="<f8").reshape(-1, TAIL // 8).astype(float)
        stamps, first = np.unique(np.array(self._stamps, dtype=np.int64)[::-1], return_index=True)
        values = values[::-1][first]  # of equal stamps the last message stays
        pose, covariance = values[:, :7], values[:, 7:43].reshape(-1, 6, 6)
        good = np.isfinite(values[:, :43]).all(axis=1) & (np.linalg.norm(pose[:, 3:], axis=1) > 0.5)
        return Track(stamps, pose[:, :3], pose[:, 3:], covariance).where(good)
