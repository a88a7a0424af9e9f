"""The three-axis compass: deviation by hard and soft iron, slow drift, tilt upset by accelerations, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from fbn_common.parameters import group, param
from fbn_common.records import Imu
from fbn_common.types import Array
from fbn_sim.motion import Motion
from fbn_sim.randomness import gauss_markov, generator
from fbn_sim.sea import GRAVITY
from fbn_sim.sensors.sample import Entry, Flight, Samples, Timing, angles, quaternions, rotations, sample

TOPIC = "imu/data"


@dataclass(frozen=True, slots=True)
class Compass:
    """A strapped-down magnetometer with accelerometers for the vertical."""

    timing: Timing = group(Timing)
    hard_iron_min: float = param(0.0105, "rad", "deviation once a circle, amplitude, drawn from here ...", "0.6 deg")
    hard_iron_max: float = param(0.0349, "rad", "... to here", "2 deg")
    soft_iron_min: float = param(0.0052, "rad", "the same twice a circle", "0.3 deg")
    soft_iron_max: float = param(0.0175, "rad", "... to here", "1 deg")
    mount_sigma: float = param(0.0087, "rad", "standard deviation of the mount's error, each axis", "0.5 deg")
    drift_sigma: float = param(0.007, "rad", "standard deviation of the slow drift of yaw", "0.4 deg")
    drift_time_constant: float = param(600.0, "s", "its correlation time", "warming up")
    yaw_noise: float = param(0.0087, "rad", "white noise of yaw", "0.5 deg")
    tilt_noise: float = param(0.0044, "rad", "white noise of roll and pitch", "0.25 deg")
    tilt_time_constant: float = param(0.5, "s", "of the low-pass behind the accelerometers", "assumed")
    magnetic_dip: float = param(1.18, "rad", "of the earth's field: tilt errors leak into yaw", "68 deg, Boston")
    stated_yaw_sigma: float = param(0.026, "rad", "standard deviation published for yaw: of the total error", "1.5 deg")
    stated_tilt_sigma: float = param(0.0105, "rad", "the same for roll and pitch", "0.6 deg")


def draw_deviation(compass: Compass, seed: int) -> Array:
    """Deviation coefficients (5,) for :func:`fbn_sim.autopilot.deviation`."""
    rng = generator(seed, "compass", "deviation")
    hard = rng.uniform(compass.hard_iron_min, compass.hard_iron_max)
    soft = rng.uniform(compass.soft_iron_min, compass.soft_iron_max)
    phase = rng.uniform(-np.pi, np.pi, 2)
    return np.array([hard, phase[0], soft, phase[1], compass.mount_sigma * rng.standard_normal()])


def draw_drift(compass: Compass, seconds: int, seed: int) -> Array:
    """Drift of yaw [rad] at each whole second."""
    rng = generator(seed, "compass", "drift")
    return gauss_markov(rng, (seconds,), 1.0, compass.drift_sigma, compass.drift_time_constant)


def compass_records(compass: Compass, deviation: Array, drift: Array, flight: Flight) -> list[Entry]:
    """The compass's records; rates and accelerations are absent (first covariance element -1)."""
    rng = generator(flight.seed, "compass")
    taken = sample(flight, compass.timing, rng)
    rpy = measured_angles(compass, flight.motion, taken, deviation, drift, rng)
    orientation = quaternions(rpy)
    covariance = np.diag([compass.stated_tilt_sigma**2] * 2 + [compass.stated_yaw_sigma**2])
    absent, none = np.diag([-1.0, 0.0, 0.0]), np.zeros(3)
    return [
        Entry(log, TOPIC, Imu(stamp, "base_link", q, covariance, none, absent, none, absent))
        for stamp, log, kept, q in zip(taken.stamp_ns, taken.log_time_ns, taken.kept, orientation, strict=True)
        if kept
    ]


def measured_angles(
    compass: Compass, motion: Motion, taken: Samples, deviation: Array, drift: Array, rng: np.random.Generator
) -> Array:
    """Roll, pitch, yaw (n, 3) [rad] as the compass gives them."""
    n = len(taken.time_s)
    rpy = angles(rotations(taken.motion.orientation))
    mount = compass.mount_sigma * rng.standard_normal(2)
    upset = _upset_by_acceleration(compass, motion, taken)
    yaw = rpy[:, 2]
    c = deviation
    out = rpy.copy()
    out[:, :2] += mount + upset + compass.tilt_noise * rng.standard_normal((n, 2))
    out[:, 2] += c[0] * np.sin(yaw + c[1]) + c[2] * np.sin(2.0 * yaw + c[3]) + c[4]
    out[:, 2] += np.interp(taken.time_s, np.arange(len(drift)), drift) + compass.yaw_noise * rng.standard_normal(n)
    # a vertical turned about north brings part of the dipping field to the east, which is taken for a turn
    out[:, 2] -= np.tan(compass.magnetic_dip) * (upset[:, 0] * np.sin(yaw) + upset[:, 1] * np.cos(yaw))
    return out


def _upset_by_acceleration(compass: Compass, motion: Motion, taken: Samples) -> Array:
    """Errors of roll and pitch (n, 2) [rad]: the accelerometers take the vehicle's acceleration for gravity."""
    v, w = motion.velocity[:, :3], motion.velocity[:, 3:]
    dt = float(motion.time_s[1] - motion.time_s[0])
    acceleration = np.gradient(v, dt, axis=0) + np.cross(w, v)
    upset = np.stack([acceleration[:, 1], -acceleration[:, 0]], axis=1) / GRAVITY
    decay = np.exp(-dt / compass.tilt_time_constant)
    smooth = np.asarray(lfilter([1.0 - decay], [1.0, -decay], upset, axis=0))
    index = np.clip(np.round(taken.time_s / dt).astype(np.int64), 0, len(smooth) - 1)
    return np.asarray(smooth[index])
