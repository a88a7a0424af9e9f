"""The two elevations at which a track may lie, and which of them is believed.

From level flight a target above the lobe's middle looks like one below.  Both are carried until the energy, the
sea floor and the surface, or the looks that should have seen it decide (JOE 2013, IV-B and Fig. 9).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from fbn_common.types import NS, Array, Mat2, Mat3, Mat4, Vec3
from fbn_tracking.gating import missed_costs
from fbn_tracking.geometry import observe, theta_from_u
from fbn_tracking.infants import settled, symmetric_inverse
from fbn_tracking.parameters import FeatureParameters
from fbn_tracking.track import Detection, Look, Mode, Ping, Track, array_pose

_START = 0.6  # of the half lobe: where the search for either elevation begins
SAME = 0.02  # rad: closer optima are one
_MEMORY_SLACK = 0.05**2 * np.eye(3)  # m^2: a target's own size


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the poses say while a track is examined; poses by ping index, slack covariance of the drift."""

    poses: Mapping[int, Mat4]
    pings: Mapping[int, Ping]
    slack: Mat2
    feature: FeatureParameters
    drift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # with which the poses were found [m/s]
    arrays: dict[tuple[int, str], tuple[Mat3, Vec3]] = field(default_factory=dict)  # filled as they are asked for

    def array(self, look: Look) -> tuple[Mat3, Vec3]:
        """Rotation and position of a look's array in the world."""
        known = self.arrays.get((look.index, look.array))
        if known is None:
            known = self.arrays[look.index, look.array] = array_pose(self.poses[look.index], look.mount)
        return known

    def stack(self, looks: Iterable[Look]) -> tuple[Array, Array]:
        """Rotations (n, 3, 3) and positions (n, 3) of looks."""
        pairs = [self.array(look) for look in looks]
        return np.array([R for R, _ in pairs]), np.array([p for _, p in pairs])


def find_modes(track: Track, around: Surroundings) -> list[Mode]:
    """The elevations still possible, likeliest first; never empty for a track with a detection or a memory."""
    if not track.detections:
        return [remembered(track, around)]
    modes = sorted(evaluate(track, starting_points(track, around), around), key=lambda mode: mode.cost)
    best, rest = modes[0], modes[1:]
    rivals = [m for m in rest if abs(m.x[2] - best.x[2]) > SAME]
    return [best, *(m for m in rivals if m.cost - best.cost < around.feature.mode_gap)]


def starting_points(track: Track, around: Surroundings) -> list[Vec3]:
    """Where to start the search: the memory's place, the middle for one detection, else above and below."""
    first = track.detections[0]
    if track.memory is not None:
        R, p = around.array(first.look)
        return [observe(R, p, track.memory.point)[0]]
    if len(track.detections) == 1:
        return [np.array([first.z[0], first.z[1], 0.0])]
    half = _START * half_lobe(first)
    return [np.array([first.z[0], first.z[1], theta]) for theta in (half, -half)]


def half_lobe(detection: Detection) -> float:
    """Half the lobe's width [rad], from the elevation's shape: u = 1 at its edge."""
    return theta_from_u(1.0, detection.z[4], detection.z[5])


def evaluate(track: Track, starts: list[Vec3], around: Surroundings) -> list[Mode]:
    """The optimum near each start with its covariance and cost."""
    detections = track.detections
    R, p = around.stack(d.look for d in detections)
    t = np.array([(d.stamp_ns - detections[0].stamp_ns) / NS for d in detections])
    raw, z = np.array([d.z for d in detections]), widened(detections, around)
    memory, information = np.zeros(3), np.zeros((3, 3))
    if track.memory is not None:
        memory, information = track.memory.point, symmetric_inverse(track.memory.covariance + _MEMORY_SLACK)
    free = symmetric_inverse(around.slack)
    found = [settled(q, R, p, t, z, raw, free, memory, information) for q in starts]
    missed = misses_costs(track.misses, np.array([point for _, point, *_ in found]), around)
    modes = []
    for (x, point, covariance, given_poses, energy, static), unseen in zip(found, missed, strict=True):
        prior = float(unseen + place_costs(point[None], covariance[2, 2], track, around)[0])
        modes.append(Mode(x, point, covariance, given_poses, energy, static, 0.5 * energy + prior))
    return modes


def widened(detections: list[Detection], around: Surroundings) -> Array:
    """The detections (n, 6) with sigmas widened by what the poses may have wandered since the first."""
    z = np.array([d.z for d in detections])
    start = around.pings[detections[0].index].travelled
    grown = np.abs(np.array([around.pings[d.index].travelled - start for d in detections]))
    heading = np.minimum(grown[:, 1], heading_bound(around.pings[detections[-1].index]))
    z[:, 2] = np.sqrt(z[:, 2] ** 2 + grown[:, 0])
    z[:, 3] = np.sqrt(z[:, 3] ** 2 + heading + grown[:, 0] / z[:, 0] ** 2)
    return z


def heading_bound(ping: Ping) -> float:
    """The most that two headings [rad^2] differ in error: twice the filter's own yaw variance."""
    return 2.0 * float(ping.motion.earth_covariance[3, 3])


def misses_costs(misses: list[Look], points: Array, around: Surroundings) -> Array:
    """Minus log probability (m,) that these looks did not see a target at each of ``points`` (m, 3)."""
    looks = [look for look in misses if look.index in around.poses]
    if not looks:
        return np.zeros(len(points))
    R, p = around.stack(looks)
    chance = np.array([look.detection_probability for look in looks])
    return np.asarray(missed_costs(points, R, p, np.array([look.limits for look in looks]), chance))


def place_costs(points: Array, variance: float, track: Track, around: Surroundings) -> Array:
    """Minus log prior (m,) of heights: nothing lies under the floor or over the surface; most stands on the floor."""
    index, par, z = track.detections[0].index, around.feature, points[:, 2]
    pose, ping = around.poses[index], around.pings[index]
    cost = 0.5 * np.maximum(0.0, z) ** 2 / (par.surface_margin**2 + variance)
    if ping.sees_floor:
        height = z - pose[2, 3] + ping.motion.altitude
        cost += 0.5 * np.minimum(0.0, height) ** 2 / (par.floor_margin**2 + ping.motion.altitude_variance + variance)
        return np.asarray(cost + np.log1p((np.maximum(0.0, height) / par.height_scale) ** 2))
    _, at = around.array(track.detections[0].look)
    return np.asarray(cost + np.log(par.below_odds) * (z > at[2]))


def remembered(track: Track, around: Surroundings) -> Mode:
    """The place a feature is remembered at, before this window has seen it."""
    assert track.memory is not None
    covariance = np.zeros((5, 5))
    covariance[:3, :3], covariance[3:, 3:] = track.memory.covariance + _MEMORY_SLACK, around.slack
    return Mode(np.zeros(5), track.memory.point, covariance, covariance[:3, :3], 0.0, 0.0, 0.0)
