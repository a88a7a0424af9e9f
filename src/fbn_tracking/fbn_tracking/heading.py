"""The compass's deviation: an error of yaw that stays, which no number of pings averages away.

Dead reckoning's covariance of yaw holds the deviation's variance.  Its earth measurements are stated as if each ping
learnt anew, and a chain of them alone has the right covariance; but tracked features tie headings to one another, and
then the smoother would average what does not average.  So a window is estimated *given* the deviation, with all else
that is known of the earth frame, and what it hands out is turned about its base by the deviation (Schmidt): nothing
else in a window depends on where north is, but the drift, with which the deviation was learnt under GPS.  See
docs/equations/tracking.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fbn_common.lie import matrix_from_quaternion, rpy_from_matrix, rpy_jacobian, skew
from fbn_common.motion_ekf.adopt import gained_information
from fbn_common.records import PingMotion
from fbn_common.types import Array, Mat3, Mat4, Mat6, Vec3

if TYPE_CHECKING:
    from fbn_tracking.window import Base

_YAW = 3  # within z, roll, pitch, yaw
_LEAST_DRIFT = 1e-8  # m^2/s^2
_MOST = 0.9  # of what is unknown of yaw given all else can be deviation: a covariance stays positive


def deviation_variance(covariance: Mat4, sigma: float) -> float:
    """How much [rad^2] of yaw's variance in the covariance of z, roll, pitch, yaw (4, 4) is deviation.

    ``sigma`` [rad] of it is believed; never more than nearly all of what the other three leave unknown.
    """
    if sigma == 0.0:
        return 0.0
    return min(sigma**2, _MOST / float(np.linalg.inv(covariance)[_YAW, _YAW]))


def given_deviation(covariance: Mat4, variance: float) -> Mat4:
    """Covariance of z, roll, pitch, yaw (4, 4) were the deviation known, which has this variance [rad^2]."""
    out = covariance.copy()
    out[_YAW, _YAW] -= deviation_variance(covariance, variance**0.5)
    return out


def information_given_deviation(before: PingMotion, after: PingMotion, white: Mat6, variance: float) -> Mat4:
    """What a ping's earth measurement tells (4, 4) besides the deviation: ``C_k^-1 - C_{k|k-1}^-1``, where positive.

    ``white``: covariance of the increment (xyz in the first body frame, rotation vector).  The dead service's own
    subtraction, of covariances given the deviation.
    """
    predicted = carried(before, after, given_deviation(before.earth_covariance, variance), white)
    return gained_information(predicted, given_deviation(after.earth_covariance, variance))


def carried(before: PingMotion, after: PingMotion, covariance: Mat4, white: Mat6) -> Mat4:
    """Covariance of z, roll, pitch, yaw (4, 4) carried from one ping to the next by its increment."""
    R_before, R_after = (_rotation(m.pose.orientation) for m in (before, after))
    to_body = np.linalg.inv(rpy_jacobian(rpy_from_matrix(R_before)))
    to_rpy = rpy_jacobian(rpy_from_matrix(R_after))
    F, G = np.eye(4), np.zeros((4, 6))
    F[0, 1:] = -(R_before @ skew(after.increment.position) @ to_body)[2]
    F[1:, 1:] = to_rpy @ _rotation(after.increment.orientation).T @ to_body
    G[0, :3], G[1:, 3:] = R_before[2], to_rpy
    out = F @ covariance @ F.T + G @ white @ G.T
    return np.asarray(0.5 * (out + out.T))


def regression(motion: PingMotion, variance: float) -> Vec3:
    """By how much yaw's lasting error goes with each part of the drift (3,) [rad s/m], ``E(deviation | drift)``.

    ``variance`` [rad^2] of it is believed; the correlation is dead reckoning's.
    """
    if variance == 0.0 or motion.heading_deviation == 0.0:
        return np.zeros(3)
    gain = np.linalg.solve(drift_prior(motion), motion.heading_drift)
    explained = float(gain @ motion.heading_drift) / motion.heading_deviation**2
    return np.asarray(gain * np.sqrt(variance / max(1.0, explained)) / motion.heading_deviation)


def drift_prior(motion: PingMotion) -> Mat3:
    """Covariance (3, 3) [m^2/s^2] of the drift at a window's start: what dead reckoning states, kept invertible."""
    return np.asarray(motion.drift_covariance + _LEAST_DRIFT * np.eye(3))


def turned(mean: Array, covariance: Array, base: Base) -> tuple[Array, Array]:
    """A composite's mean and covariance with its base's deviation unknown: all of it is turned about the base.

    By ``by_drift`` of what the window learnt of the drift, and by what that leaves unknown.  Order of both as in
    ``CompositeMeasurement``; x and y are relative to the base [m].
    """
    turn = np.zeros(len(mean))
    turn[[3, 9]] = 1.0
    for x in (4, *range(10, len(mean) - 3, 3)):
        turn[x], turn[x + 1] = -mean[x + 1], mean[x]
    A = np.eye(len(mean))
    A[:, -3:] += np.outer(turn, base.by_drift)
    learnt = float(base.by_drift @ (mean[-3:] - base.mean[4:]))
    out = A @ covariance @ A.T + _left(base) * np.outer(turn, turn)
    return mean + learnt * turn, 0.5 * (out + out.T)


def turned_prior(base: Base) -> Array:
    """The same of the prior at a base: covariance of z, roll, pitch, yaw, drift (7, 7)."""
    A = np.eye(7)
    A[_YAW, 4:] = base.by_drift
    out = A @ base.covariance @ A.T
    out[_YAW, _YAW] += _left(base)
    return np.asarray(0.5 * (out + out.T))


def _left(base: Base) -> float:
    """Variance of the deviation, the drift being known [rad^2]."""
    return max(0.0, base.deviation - float(base.by_drift @ base.covariance[4:, 4:] @ base.by_drift))


def _rotation(orientation: Array) -> Mat3:
    return np.ascontiguousarray(matrix_from_quaternion(orientation))
