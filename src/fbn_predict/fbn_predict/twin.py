"""A vehicle drawn from the filters' own belief: what their consistency is tested against.

Its parameters are drawn from the prior, its accelerations from the process noise, its sensors' errors from the
models the filters assume.  A filter must be consistent here before it is judged by a truth that it does not model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common.geodesy import GeodeticPoint, geodetic_from_enu
from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix, so3_exp
from fbn_common.motion_ekf.layout import GRID_NS
from fbn_common.motion_ekf.parameters import AltimeterParameters, CompassParameters, DepthParameters
from fbn_common.records import FluidPressure, Imu, JointState, NavSatFix, Range, Record, SonarDetections
from fbn_common.types import Array
from fbn_predict.dynamics import model_of
from fbn_predict.parameters import PredictParameters, prior
from fbn_predict.sensitivity import COLUMNS, new_scratch, step

DATUM = GeodeticPoint(42.0, -71.0, 0.0)
START_NS = 1_000_000_000_000
_DT = GRID_NS * 1e-9
_NONE = np.zeros(3)
Arrivals = list[tuple[int, str, Record]]  # time of arrival, topic, record


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """Truth on the grid, and the records of its sensors by stamp."""

    stamp_ns: tuple[int, ...]
    position: Array  # (n, 3) m, map
    rotation: Array  # (n, 3, 3) body to map
    velocity: Array  # (n, 6)
    parameters: Array  # (15,)
    records: tuple[tuple[str, Record], ...]

    def index(self, stamp_ns: int) -> int:
        """Row of a stamp of the grid."""
        return (stamp_ns - self.stamp_ns[0]) // GRID_NS


def sail(
    parameters: PredictParameters,
    seconds: float,
    seed: int,
    depth: float = 5.0,
    turn_s: float = 60.0,
    noisy: bool = True,
) -> Twin:
    """Sail square legs at this depth, GPS within the first and last tenth of the time."""
    rng = np.random.default_rng(seed)
    belief, model, n = prior(parameters.dynamics, parameters.doubt), model_of(parameters.dynamics), round(seconds / _DT)
    p = rng.multivariate_normal(belief.mean, belief.covariance) if noisy else belief.mean.copy()
    p[3:9] = np.maximum(p[3:9], 0.2 * belief.mean[3:9])
    sigma = np.array([*parameters.noise.velocity, *parameters.noise.turn_rate]) * (1.0 if noisy else 0.0)
    position, rotation, velocity = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3)), np.zeros((n + 1, 6))
    position[0], rotation[0] = (0.0, 0.0, -depth), matrix_from_rpy(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)]))
    commands = np.empty((n, 5))
    y, s, scratch = np.empty(12), np.empty((12, COLUMNS)), new_scratch()
    for i in range(n):
        held = i > 0 and i % 10 != 7  # the filters are told at 10 Hz
        commands[i] = (
            commands[i - 1] if held else _command(i * _DT, turn_s, depth, position[i], rotation[i], velocity[i])
        )
        step(velocity[i], rotation[i], p, commands[i], -position[i, 2], _DT, model, y, s, False, scratch)
        position[i + 1] = position[i] + rotation[i] @ y[0:3]
        rotation[i + 1] = rotation[i] @ so3_exp(y[3:6])
        kick = np.sqrt(2.0 * p[3:9] * _DT) * sigma * rng.standard_normal(6)
        velocity[i + 1] = y[6:12] + kick
    stamps = tuple(START_NS + i * GRID_NS for i in range(n + 1))
    truth = Twin(stamps, position, rotation, velocity, p, ())
    records = sorted(_records(truth, commands, depth, rng, noisy), key=lambda r: r[1].stamp_ns)
    return Twin(stamps, position, rotation, velocity, p, tuple(records))


def _command(t: float, turn_s: float, depth: float, position: Array, rotation: Array, velocity: Array) -> Array:
    """Propeller on; a turn in the last 8 s of each leg; tilt holds the depth."""
    turning = 0.35 if t % turn_s > turn_s - 8.0 else 0.0
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))
    wanted = np.clip(0.2 * (position[2] + depth), -0.3, 0.3)  # bow down where too high
    tilt = np.clip(2.0 * (pitch - wanted) + 1.0 * velocity[4], -0.4, 0.4)
    return np.array([125.66 if t > 2.0 else 0.0, turning, tilt, 0.0, 0.0])


def _records(
    twin: Twin, commands: Array, depth: float, rng: np.random.Generator, noisy: bool
) -> list[tuple[str, Record]]:
    compass, pressure, altimeter = CompassParameters(), DepthParameters(), AltimeterParameters()
    scale = 1.0 if noisy else 0.0
    out: list[tuple[str, Record]] = []
    empty, n = np.empty(0), len(commands)
    tilt, bias = scale * rng.normal(0.0, compass.tilt, 2), scale * rng.normal(0.0, pressure.bias)
    deviation = scale * compass.deviation * rng.standard_normal(5)
    gps, white = scale * rng.normal(0.0, 1.8, 2), 0.12
    stated = np.diag([0.0105, 0.0105, 0.035]) ** 2
    sigma = np.sqrt(np.maximum(np.diagonal(stated) * compass.white, compass.sigma_min**2))
    for i in range(n):
        stamp, r, z = twin.stamp_ns[i], twin.rotation[i], twin.position[i, 2]
        if i % 10 == 3:
            noise = scale * sigma * rng.standard_normal(3)
            wave = scale * compass.wave_acceleration / 9.81 * np.exp(min(z, 0.0) / compass.wave_depth)
            upset = wave * np.array([1.0, 1.0, np.tan(compass.dip)]) * rng.standard_normal(3)
            upset[:2] += tilt
            wrong = (
                matrix_from_rpy(np.array([0.0, 0.0, _deviation(r, deviation)])) @ so3_exp(noise) @ r @ so3_exp(upset)
            )
            q = quaternion_from_matrix(np.ascontiguousarray(wrong))
            absent = np.diag([-1.0, 0.0, 0.0])
            out.append(("imu/data", Imu(stamp, "base_link", q, stated, _NONE, absent, _NONE, absent)))
        if i % 10 == 7:
            out.append(("actuators", _actuators(stamp, commands[i], empty)))
        if i % 20 == 11:
            metres = -z + bias + scale * rng.normal(0.0, 0.02)
            pascal = pressure.surface_pressure + pressure.density * pressure.gravity * metres
            variance = (0.02 * pressure.density * pressure.gravity) ** 2
            out.append(("pressure", FluidPressure(stamp, "base_link", float(pascal), variance)))
        if i % 20 == 1:
            reading = (z + depth + 10.0) / r[2, 2] + scale * rng.normal(0.0, altimeter.sigma)
            out.append(("altitude", Range(stamp, "altimeter_link", 0, 0.1, 0.3, 30.0, float(reading))))
        if i % 100 == 55 and (i < n // 10 or i > n - n // 10):
            keep = np.exp(-1.0 / 240.0)
            gps = keep * gps + scale * np.sqrt(1.0 - keep**2) * rng.normal(0.0, 1.8, 2)
            place = twin.position[i].copy()
            place[:2] += gps + scale * rng.normal(0.0, np.sqrt(white), 2) + (r @ np.array([-0.3, 0.0, 0.35]))[:2]
            g = geodetic_from_enu(np.array([place[0], place[1], 0.0]), DATUM)
            covariance = np.diag([3.36, 3.36, 9.0])
            out.append(("gps/fix", NavSatFix(stamp, "gps", 0, g.latitude, g.longitude, 0.0, covariance, 2)))
    return out


def _deviation(rotation: Array, coefficients: Array) -> float:
    """Of the compass at this attitude [rad]: a mount's error, hard iron once and soft iron twice a circle."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    waves = np.array([1.0, np.sin(yaw), np.cos(yaw), np.sin(2.0 * yaw), np.cos(2.0 * yaw)])
    return float(coefficients @ (np.sqrt([0.3, 0.5, 0.5, 0.2, 0.2]) * waves))


def _actuators(stamp: int, command: Array, empty: Array) -> JointState:
    names = ("propeller", "pan", "tilt")
    position, velocity = np.array([0.0, command[1], command[2]]), np.array([command[0], 0.0, 0.0])
    return JointState(stamp, "base_link", names, position, velocity, empty)


def on_time(twin: Twin) -> Arrivals:
    """Every record at its stamp, and a ping each 0.7 s."""
    pings = range(twin.stamp_ns[0] + 3_000_000_000, twin.stamp_ns[-1], 703_000_000)
    records = [*twin.records, *(("sonar/detections", ping(s)) for s in pings)]
    return sorted(((r.stamp_ns, topic, r) for topic, r in records), key=lambda a: a[0])


def ping(stamp_ns: int) -> SonarDetections:
    """A ping that heard nothing."""
    return SonarDetections(stamp_ns, "sonar_left", 0, 4.0, 40.0, 1.2, 1.9, 0.35, ())
