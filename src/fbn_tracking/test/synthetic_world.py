"""A small world for the tracker's tests: a vehicle among point targets, dead-reckoned with an unknown current.

Truth, motions and echoes are drawn from one generator; the echoes follow the flat lobe, not the cubic model.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix, rpy_from_matrix, so3_exp
from fbn_common.records import PingMotion, Pose, SonarDetection, SonarDetections
from fbn_common.sonar import polar
from fbn_common.types import Array, nanoseconds
from fbn_tracking.parameters import TrackingParameters, blazed_array_pair


@dataclass(frozen=True)
class World:
    """What is out there and how well it is measured."""

    targets: Array
    speed: float = 0.8
    period: float = 1.0
    depth: float = 2.0
    floor: float = 5.0
    drift: tuple[float, float, float] = (0.05, -0.03, 0.0)
    drift_sigma: float = 0.1
    step_sigma: float = 0.02  # m per sqrt(s)
    turn_sigma: float = 0.003  # rad per sqrt(s)
    earth_sigma: tuple[float, float, float, float] = (0.05, 0.01, 0.01, 0.03)
    range_sigma: float = 0.05
    bearing_sigma: float = 0.0175
    clutter: float = 0.0
    detection_probability: float = 0.67
    pitch: float = 0.03  # rad, amplitude
    yaw_rate: float = 0.0
    time_constant: float = 600.0
    deviation: float = 0.0  # of earth_sigma's yaw, said to stay; drawn anew all the same
    noise: float = 1.0  # scales what is drawn, not the sigmas stated


@dataclass
class Run:
    """Records in the order of their stamps, and the truth at each ping."""

    motions: list[PingMotion] = field(default_factory=list)
    scans: list[SonarDetections] = field(default_factory=list)
    poses: list[tuple[Array, Array]] = field(default_factory=list)  # R, p, true


def simulate(world: World, pings: int, seed: int) -> Run:
    """A run of ``pings`` pings."""
    rng, run = np.random.default_rng(seed), Run()
    start, arrays = 1_000_000_000, blazed_array_pair()
    earth_sigma = np.array(world.earth_sigma)
    R, p = matrix_from_rpy(np.zeros(3)), np.array([0.0, 0.0, -world.depth])
    odom_R, odom_p = R.copy(), p.copy()
    for k in range(pings):
        stamp, t = start + nanoseconds(k * world.period), k * world.period
        increment, R_increment = np.zeros(3), np.eye(3)
        if k:
            rpy = np.array([0.02 * np.sin(0.9 * t), world.pitch * np.sin(0.5 * t), world.yaw_rate * t])
            R_new = matrix_from_rpy(rpy)
            p_new = p + world.speed * world.period * R[:, 0]
            p_new[2] = -world.depth + 0.1 * np.sin(0.3 * t)
            bias = (R.T @ np.array([*world.drift[:2], 0.0]) + np.array([world.drift[2], 0, 0])) * world.period
            root = np.sqrt(world.period)
            increment = R.T @ (p_new - p) - bias + world.noise * rng.normal(size=3) * world.step_sigma * root
            R_increment = R.T @ R_new @ so3_exp(world.noise * rng.normal(size=3) * world.turn_sigma * root)
            R, p = R_new, p_new
            odom_p, odom_R = odom_p + odom_R @ increment, odom_R @ R_increment
        run.poses.append((R, p))
        run.motions.append(_motion(world, run, stamp, increment, R_increment, odom_R, odom_p, earth_sigma, rng))
        for name, array in arrays.items():
            run.scans.append(_scan(world, name, array, stamp, k, R, p, rng))
    return run


def _motion(world, run, stamp, increment, R_increment, odom_R, odom_p, earth_sigma, rng):  # type: ignore[no-untyped-def]
    R, p = run.poses[-1]
    earth = np.array([p[2], *rpy_from_matrix(np.ascontiguousarray(R))]) + world.noise * rng.normal(size=4) * earth_sigma
    previous = run.motions[-1].stamp_ns if run.motions else stamp
    root = np.sqrt(world.period)
    sigmas = np.array([world.step_sigma] * 3 + [world.turn_sigma] * 3) * root
    return PingMotion(
        stamp_ns=stamp,
        frame_id="odom",
        previous_ns=previous,
        increment=Pose(increment, quaternion_from_matrix(np.ascontiguousarray(R_increment))),
        pose=Pose(odom_p.copy(), quaternion_from_matrix(np.ascontiguousarray(odom_R))),
        altitude=world.floor + p[2] + 0.05 * rng.normal(),
        altitude_variance=0.05**2,
        drift_time_constant=world.time_constant,
        increment_covariance=np.diag(sigmas**2),
        earth=earth,
        earth_information=np.diag(1.0 / earth_sigma**2),
        earth_covariance=np.diag(earth_sigma**2),
        velocity=np.array([world.speed, 0, 0, 0, 0, 0]),
        heading_deviation=world.deviation,
        drift_covariance=np.eye(3) * world.drift_sigma**2 * np.array([1, 1, 1e-4]),
    )


def _scan(world, name, array, stamp, k, R, p, rng):  # type: ignore[no-untyped-def]
    echoes = []
    R_a, p_a = R @ array.rotation_base_array, p + R @ array.position_base
    for target in world.targets:
        r, phi, theta = polar(R_a.T @ (target - p_a))
        inside = array.range_min < r < array.range_max and array.bearing_min < phi < array.bearing_max
        if inside and abs(theta) < 0.5 * array.lobe_width and rng.random() < world.detection_probability:
            r += world.noise * rng.normal() * world.range_sigma
            phi += world.noise * rng.normal() * world.bearing_sigma
            echoes.append(SonarDetection(r, phi, world.range_sigma, world.bearing_sigma, 0.8))
    for _ in range(rng.poisson(world.clutter)):
        r = rng.uniform(array.range_min, array.range_max)
        phi = rng.uniform(array.bearing_min, array.bearing_max)
        echoes.append(SonarDetection(r, phi, world.range_sigma, world.bearing_sigma, 0.5))
    limits = (array.range_min, array.range_max, array.bearing_min, array.bearing_max)
    return SonarDetections(stamp, name, k, *limits, array.lobe_width, tuple(echoes))


def play(tracker, run: Run, delay_pings: int = 0):  # type: ignore[no-untyped-def]
    """Feed a run ping by ping; gives all outputs."""
    outputs = []
    for motion in run.motions:
        for scan in (s for s in run.scans if s.stamp_ns == motion.stamp_ns):
            tracker.put("sonar/detections", scan)
        tracker.put("deadreck/ping_motion", motion)
        outputs += tracker.advance(motion.stamp_ns)
    return outputs


def corridor(n: int = 12, spacing: float = 12.0, seed: int = 5, z: float = -4.0) -> Array:
    """Targets on both sides of the way along x."""
    rng = np.random.default_rng(seed)
    y = rng.uniform(1.0, 6.0, n) * np.where(np.arange(n) % 2, 1, -1)
    return np.column_stack((10.0 + spacing * np.arange(n), y, np.full(n, z)))


__all__ = ["Run", "TrackingParameters", "World", "corridor", "play", "simulate"]
