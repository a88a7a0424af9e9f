"""The reference service: what measurements of position told since the last fix, as one equivalent measurement.

See docs/equations/reference.md, "Reference service".
"""

from __future__ import annotations

import numpy as np

from fbn_common.motion_ekf.adopt import gained_information
from fbn_common.types import Array, Mat2, Vec2

UNKNOWN = 1e8  # m^2: variance in a direction in which nothing was learnt


def _covariance(row: Array) -> Mat2:
    return np.array([[row[2], row[3]], [row[3], row[4]]])


class Gain:
    """Position since the last fix as predictions alone carry it, beside what the filter knows."""

    def __init__(self, mean: Vec2, covariance: Mat2) -> None:
        self.predicted, self.predicted_covariance = mean.copy(), covariance.copy()
        self.mean, self.covariance = mean.copy(), covariance.copy()
        self._left = 1.0  # of the predicted variance, in the direction in which most was learnt

    def add(self, before: Array, after: Array) -> None:
        """A measurement of position took (x, y, Pxx, Pxy, Pyy) from ``before`` to ``after``."""
        grown = _covariance(before) - self.covariance
        values, vectors = np.linalg.eigh(grown)
        self.predicted += before[:2] - self.mean
        self.predicted_covariance += (vectors * np.maximum(values, 0.0)) @ vectors.T
        self.mean, self.covariance = after[:2].copy(), _covariance(after)
        ratio = np.linalg.eigvals(np.linalg.solve(self.predicted_covariance, self.covariance)).real
        self._left = float(ratio.min())

    def worth(self, share: float) -> bool:
        """Whether the variance has decreased in some direction by this share."""
        return self._left < 1.0 - share

    def collect(self) -> tuple[Vec2, Mat2]:
        """The equivalent measurement (xy, covariance); begins anew.

        Its information takes the predicted covariance to the filter's, its mean the predicted mean to the
        filter's: ``P^-1 x = P_pred^-1 x_pred + L z``, solved where L tells anything.
        """
        information = gained_information(self.predicted_covariance, self.covariance)
        values, vectors = np.linalg.eigh(information)
        told = values > 1.0 / UNKNOWN
        variances = np.where(told, 1.0 / np.where(told, values, 1.0), UNKNOWN)
        shift = self.mean - self.predicted
        full = information + np.linalg.inv(self.predicted_covariance)
        pull = vectors.T @ (full @ shift)
        offset = vectors @ np.where(told, pull * variances, 0.0)
        z, covariance = self.predicted + offset, (vectors * variances) @ vectors.T
        self.predicted, self.predicted_covariance = self.mean.copy(), self.covariance.copy()
        self._left = 1.0
        return z, covariance
