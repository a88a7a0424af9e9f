"""Whether a track's echoes move as the vehicle's motion alone would move them: a check that needs no position.

Range to a static thing changes by ``-c . V``, with c the direction that was measured, whatever its place and curvature;
its azimuth by ``-e . V / r`` for a thing small against its range (e: across c, horizontal).  So two balances,

    y_k = r_k + sum (c_j + c_j+1)/2 . d_j          w_k = psi_k + sum (e_j/r_j + e_j+1/r_j+1)/2 . d_j

with d_j the way from echo j to the next, stay what they were; of a moving thing they grow with its velocity.  That is
estimated with its covariance, which holds what the drift of dead reckoning may be, and judged by chi-square.
After Rikoski and Leonard, Trajectory Sonar Perception in the Ligurian Sea, equations 9 to 11: the second order is the
direction's measured change here.  See docs/equations/tracking.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common import chi_square
from fbn_common.kernels import kernel
from fbn_common.observability import QUARTER, effects
from fbn_common.types import NS, Array, Mat2, Vec2
from fbn_tracking.geometry import theta_from_u
from fbn_tracking.infants import symmetric_inverse
from fbn_tracking.modes import Surroundings, heading_bound
from fbn_tracking.track import Track

MOST = 16  # latest echoes looked at: bounded time
_LEAST = 4  # echoes, below which a straight line says nothing
_FLAT = 1e-4  # s^2/m^2: 100 m/s, so that a velocity nobody saw stays finite


@dataclass(frozen=True, slots=True, eq=False)
class MotionCheck:
    """The velocity over ground that a track seems to have, and how unlikely that is of a thing at rest."""

    velocity: Vec2  # m/s, world x, y
    covariance: Mat2  # of that velocity if the thing is at rest: echoes, way and drift
    statistic: float  # chi-square with ``dof`` if it is at rest
    dof: int  # 2, or 1 where bearings showed no motion and ranges alone speak

    def moving(self, probability: float) -> bool:
        """Whether a thing at rest would have so large a statistic in less than 1 - ``probability`` of all cases."""
        return self.statistic > float(chi_square.bound(probability, self.dof))


def check_motion(t: Array, R: Array, p: Array, z: Array, walk: Array, drift: Mat2) -> MotionCheck | None:
    """Judge a track by its latest echoes; None for fewer than four, or where all came at once.

    ``t`` (n) [s]; ``R`` (n, 3, 3), ``p`` (n, 3): arrays in the world; ``z`` (n, 6): r, phi, their sigmas, elevation
    shape a, c; ``walk`` (n, 2): variance of position [m^2] and heading [rad^2] that dead reckoning has gathered;
    ``drift``: covariance of its velocity in world x, y.
    """
    t, R, p, z, walk = t[-MOST:], R[-MOST:], p[-MOST:], z[-MOST:], walk[-MOST:]
    if len(t) < _LEAST or t[-1] - t[0] <= 0.0:
        return None
    second_order, bearings = needed(t, R, p, z)
    velocity, covariance = apparent_velocity(t - t[0], R, p, z, walk - walk[0], second_order, bearings)
    total = covariance + drift
    if bearings:
        return MotionCheck(velocity, total, float(velocity @ np.linalg.solve(total, velocity)), 2)
    line = np.linalg.eigh(covariance)[1][:, 0]  # the direction of which ranges speak: all else is unknown
    return MotionCheck(velocity, total, float(line @ velocity) ** 2 / float(line @ total @ line), 1)


def of_track(track: Track, around: Surroundings) -> MotionCheck | None:
    """The check of an infant's echoes, poses as they now are."""
    detections = track.detections[-MOST:]
    R, p = around.stack(d.look for d in detections)
    t = np.array([(d.stamp_ns - detections[0].stamp_ns) / NS for d in detections])
    walk = np.array([around.pings[d.index].travelled for d in detections])
    walk = np.abs(walk - walk[0])
    walk[:, 1] = np.minimum(walk[:, 1], heading_bound(around.pings[detections[-1].index]))
    return check_motion(t, R, p, np.array([d.z for d in detections]), walk, around.slack)


def needed(t: Array, R: Array, p: Array, z: Array) -> tuple[bool, bool]:
    """Whether ranges show their second order (N2 to N4) and bearings the motion (N5, N6) over this track's time.

    A term counts from a quarter of a sigma on: left out, it shifts what is tested by less.
    """
    duration = float(t[-1] - t[0])
    way, middle = p[-1] - p[0], len(t) // 2
    speed = float(np.sqrt(way @ way)) / duration
    bend = p[-1] - 2.0 * p[middle] + p[0]
    acceleration = 4.0 * float(np.sqrt(bend @ bend)) / duration**2
    turned = float(np.arccos(min(1.0, max(-1.0, 0.5 * (np.sum(R[0] * R[-1]) - 1.0)))))
    by = effects(speed, turned / duration, acceleration, float(z[:, 0].min()), duration)
    return max(by[1:4]) > QUARTER * float(z[:, 2].min()), max(by[4:]) > QUARTER * float(z[:, 3].min())


@kernel
def balances(t: Array, R: Array, p: Array, z: Array, second_order: bool) -> tuple[Array, Array, Array, Array]:
    """The balances (2 n), their slopes by a velocity of the thing (2 n, 2), by theta and by theta^2 / 2.

    Rows: n ranges [m], then n azimuths [rad].  ``theta``: the angle around the axis, unknown within the lobe.
    """
    n = t.shape[0]
    b, by_velocity, by_theta, by_square = np.zeros(2 * n), np.zeros((2 * n, 2)), np.zeros(2 * n), np.zeros(2 * n)
    c, e, tilt = np.empty((n, 3)), np.zeros((n, 3)), np.empty((n, 3))
    for k in range(n):
        sp, cp = np.sin(z[k, 1]), np.cos(z[k, 1])
        for i in range(3):
            c[k, i], tilt[k, i] = R[k, i, 0] * sp + R[k, i, 2] * cp, R[k, i, 1] * sp
        flat = max(np.sqrt(c[k, 0] ** 2 + c[k, 1] ** 2), 1e-6)
        e[k, 0], e[k, 1] = -c[k, 1] / flat, c[k, 0] / flat
        b[k], b[n + k] = z[k, 0], np.arctan2(c[k, 1], c[k, 0])
        by_theta[n + k] = -(e[k] @ tilt[k]) / flat
        if k:  # azimuths without a jump of a turn
            b[n + k] -= 2.0 * np.pi * np.round((b[n + k] - b[n + k - 1]) / (2.0 * np.pi))
    mean = np.zeros(3)
    for k in range(n):
        mean += c[k] / n
    for k in range(1, n):
        d, dt = p[k] - p[k - 1], t[k] - t[k - 1]
        line = 0.5 * (c[k - 1] + c[k]) if second_order else mean
        across = 0.5 * (e[k - 1] / z[k - 1, 0] + e[k] / z[k, 0])
        lean = 0.5 * (tilt[k - 1] + tilt[k])
        b[k] += b[k - 1] - z[k - 1, 0] + line @ d
        for i in range(2):
            by_velocity[k, i] = by_velocity[k - 1, i] + line[i] * dt
            by_velocity[n + k, i] = by_velocity[n + k - 1, i] + across[i] * dt
        by_theta[k] = by_theta[k - 1] - lean @ d
        by_square[k] = by_square[k - 1] + line @ d
    turn = 0.0
    for k in range(1, n):
        turn += (0.5 * (e[k - 1] / z[k - 1, 0] + e[k] / z[k, 0])) @ (p[k] - p[k - 1])
        b[n + k] += turn
    return b, by_velocity, by_theta, by_square


@kernel
def balance_covariance(z: Array, walk: Array, e_step: Array, by_theta: Array, by_square: Array, half: float) -> Array:
    """Covariance (2 n, 2 n) of the balances of a static thing.

    Echoes' own noise; the way's, which grows with ``walk`` and, along the range, with ``e_step`` (n) [m^2] by the error
    of directions; theta, evenly likely over the lobe of half width ``half`` [rad].
    """
    n = z.shape[0]
    C, gathered, near = np.empty((2 * n, 2 * n)), np.cumsum(e_step), z[:, 0].min()
    of_theta, of_square = (
        half**2 / 3.0,
        half**4 / 45.0,
    )  # theta^2 / 2 of a theta evenly likely: mean w^2/6, variance w^4/45
    for j in range(n):
        for k in range(n):
            i = min(j, k)
            C[j, k] = walk[i, 0] + gathered[i]
            C[n + j, n + k] = walk[i, 1] + walk[i, 0] / near**2
            C[j, n + k] = C[n + k, j] = 0.0
        C[j, j] += z[j, 2] ** 2
        C[n + j, n + j] += z[j, 3] ** 2
    for j in range(2 * n):
        for k in range(2 * n):
            C[j, k] += of_theta * by_theta[j] * by_theta[k] + of_square * by_square[j] * by_square[k]
    return C


@kernel
def apparent_velocity(
    t: Array, R: Array, p: Array, z: Array, walk: Array, second_order: bool, bearings: bool
) -> tuple[Vec2, Mat2]:
    """The velocity (2) [m/s, world x, y] of a thing that would make the balances grow as they do, and its covariance.

    Generalised least squares; the balances' own level is unknown.  Where ``bearings`` are not used, only its part along
    the range is found.
    """
    n = t.shape[0]
    b, by_velocity, by_theta, by_square = balances(t, R, p, z, second_order)
    half = theta_from_u(1.0, z[0, 4], z[0, 5])
    e_step = np.zeros(n)
    for k in range(1, n):
        d = p[k] - p[k - 1]
        along = 0.0
        for i in range(3):
            along += d[i] * (R[k, i, 0] * np.sin(z[k, 1]) + R[k, i, 2] * np.cos(z[k, 1]))
        e_step[k] = (d @ d - along**2) * z[k, 3] ** 2
    C = balance_covariance(z, walk, e_step, by_theta, by_square, half)
    b = b - by_square * half**2 / 6.0
    rows = 2 * n if bearings else n
    A = np.zeros((rows, 5))
    A[:n, 0] = 1.0
    A[n:, 1] = 1.0
    A[:, 2:4] = by_velocity[:rows]
    A[:, 4] = b[:rows]
    whiten(C[:rows, :rows].copy(), A)
    M = A[:, :4].copy().T @ A[:, :4].copy()
    for i in range(4):
        M[i, i] += _FLAT
    P = symmetric_inverse(M)
    x = P @ (A[:, :4].copy().T @ A[:, 4].copy())
    return x[2:].copy(), P[2:, 2:].copy()


@kernel
def whiten(C: Array, A: Array) -> None:
    """``L^-1 A`` in place, with the Cholesky root L of a positive definite C (n, n), which is overwritten."""
    for i in range(C.shape[0]):
        for j in range(i + 1):
            s = C[i, j]
            for k in range(j):
                s -= C[i, k] * C[j, k]
            C[i, j] = np.sqrt(s) if i == j else s / C[j, j]
        for m in range(A.shape[1]):
            for k in range(i):
                A[i, m] -= C[i, k] * A[k, m]
            A[i, m] /= C[i, i]
