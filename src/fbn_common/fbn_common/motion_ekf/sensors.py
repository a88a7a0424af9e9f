"""From sensor records to the timeline's measurements; malformed ones are refused with a reason."""

from __future__ import annotations

from functools import lru_cache
from math import isfinite, isnan, sqrt

import numpy as np

from fbn_common.lie import matrix_from_quaternion
from fbn_common.motion_ekf.monitor import all_finite
from fbn_common.motion_ekf.parameters import AltimeterParameters, CompassParameters, DepthParameters
from fbn_common.records import FluidPressure, Imu, Range
from fbn_common.types import Array, Mat3


class Unusable(Exception):
    """A measurement that cannot be used; the text says why."""


def usable_covariance(covariance: Array, sigma_unknown: float, sigma_min: float) -> Array:
    """The stated covariance, or the default where none is stated, with variances of at least the floor.

    Raises Unusable where it is not a covariance.
    """
    if not all_finite(covariance):
        raise Unusable("covariance is not finite")
    if not np.any(covariance):
        return np.eye(len(covariance)) * sigma_unknown**2
    diagonal = np.diagonal(covariance)
    if np.count_nonzero(covariance) == np.count_nonzero(diagonal) and diagonal.min() >= 0.0:
        return np.diag(np.maximum(diagonal, sigma_min**2))
    c = 0.5 * (covariance + covariance.T)
    values, vectors = np.linalg.eigh(c)
    if values[0] < -1e-9 * max(abs(values[-1]), 1e-12):
        raise Unusable("covariance is not positive semidefinite")
    if values[0] >= sigma_min**2:
        return np.ascontiguousarray(c)
    return np.ascontiguousarray((vectors * np.maximum(values, sigma_min**2)) @ vectors.T)


def compass_rotation(imu: Imu) -> Mat3:
    """R_world_base (3, 3) of a compass's record; raises Unusable."""
    if imu.orientation_covariance[0, 0] == -1.0:
        raise Unusable("orientation absent (covariance -1)")
    norm = sqrt(imu.orientation @ imu.orientation)
    if not isfinite(norm):
        raise Unusable("orientation is not finite")
    if abs(norm - 1.0) > 0.01:
        raise Unusable(f"quaternion's norm is {norm:.4g}, not 1")
    return np.asarray(matrix_from_quaternion(imu.orientation))


def compass_data(imu: Imu, parameters: CompassParameters) -> Array:
    """Data (18,) of a compass measurement: rotation 9, covariance of its white part 9 (fixed axes)."""
    rotation, p = compass_rotation(imu), parameters
    white = _white_part(imu.orientation_covariance.tobytes(), p.white, p.sigma_unknown, p.sigma_min)
    return np.concatenate((rotation.ravel(), white))


@lru_cache(maxsize=64)
def _white_part(covariance: bytes, share: float, sigma_unknown: float, sigma_min: float) -> Array:
    """White part (9,) of a stated covariance; most compasses state the same every time.  Raises Unusable."""
    stated = usable_covariance(np.frombuffer(covariance).reshape(3, 3), sigma_unknown, 1e-6)
    return usable_covariance(stated * share, 1.0, sigma_min).ravel()


def depth_data(pressure: FluidPressure, parameters: DepthParameters) -> Array:
    """Data (2,) of a depth measurement: z of the sensor, variance."""
    if not all_finite(pressure.fluid_pressure, pressure.variance) or pressure.variance < 0.0:
        raise Unusable("pressure or its variance is not finite, or negative")
    per_metre = parameters.density * parameters.gravity
    depth = (pressure.fluid_pressure - parameters.surface_pressure) / per_metre
    if not -2.0 <= depth <= parameters.max_depth:
        raise Unusable(f"depth of {depth:.1f} m is outside -2 to {parameters.max_depth} m")
    sigma = sqrt(pressure.variance * parameters.white) / per_metre if pressure.variance > 0.0 else parameters.sigma
    return np.array([-depth, max(sigma, parameters.sigma_min) ** 2])


def altitude_data(altitude: Range, parameters: AltimeterParameters) -> Array | None:
    """Data (5,) of an altitude; None where there is no bottom in range."""
    if not all_finite(altitude.min_range, altitude.max_range) or isnan(altitude.range):
        raise Unusable("range or its limits are not a number")
    if altitude.range == 0.0 or not altitude.min_range <= altitude.range <= altitude.max_range:
        return None
    p = parameters
    return np.array([altitude.range, p.sigma**2, p.slope, p.baseline, np.cos(p.max_tilt)])
