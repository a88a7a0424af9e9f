"""The water's motion: a layered, slowly varying current with eddies, and waves that die with depth.

The profile over depth is a turbulent one with a wind-driven layer on top, and nothing that an estimator models:
``c(z, t) = c_tide(t) (altitude / depth)^(1/7) + c_wind(t) exp(z / wind_depth)`` plus a divergence-free pattern
of eddies in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.parameters import ParameterError, param
from fbn_common.types import Array, Vec3
from fbn_sim.kernels import times
from fbn_sim.randomness import gauss_markov, generator

GRAVITY = 9.80665  # m/s^2
TABLE_STEP_S = 1.0  # s, between entries of the current's table
WAVES = 8  # components of the wave spectrum
EDDIES = 3


@dataclass(frozen=True, slots=True)
class Sea:
    """How the water moves."""

    current_speed_min: float = param(0.0, "m/s", "mean speed of the deep current, drawn from here ...", "scenario")
    current_speed_max: float = param(0.0, "m/s", "... to here", "scenario")
    current_direction: float | None = param(None, "rad", "towards which it flows, east = 0; none = drawn", "scenario")
    current_variation: float = param(0.15, "-", "slow variation, as a part of the mean speed", "tidal basin, assumed")
    current_time_constant: float = param(900.0, "s", "correlation time of that variation", "tidal basin, assumed")
    current_walk: float = param(0.0, "m/s", "standard deviation per root hour of a random walk besides", "off")
    eddy_fraction: float = param(0.15, "-", "eddies' speed, as a part of the mean speed", "assumed")
    eddy_size: float = param(60.0, "m", "their typical wavelength", "assumed")
    wind_fraction: float = param(0.5, "-", "wind-driven surface current, as a part of the mean speed", "assumed")
    wind_depth: float = param(0.7, "m", "depth over which it falls to 1/e", "assumed")
    wave_height: float = param(0.08, "m", "significant wave height", "sheltered water")
    wave_period: float = param(2.0, "s", "peak period", "sheltered water")
    density: float = param(998.0, "kg/m^3", "of the water", "fresh water, 20 degC")

    def __post_init__(self) -> None:
        if not 0.0 <= self.current_speed_min <= self.current_speed_max:
            raise ParameterError("current_speed_min and current_speed_max must satisfy 0 <= min <= max [m/s]")
        if min(self.current_time_constant, self.eddy_size, self.wind_depth, self.wave_period, self.density) <= 0.0:
            raise ParameterError("time constants, sizes, periods and the density must be positive")


class SeaTable(NamedTuple):
    """One realisation of the sea, as the kernels take it."""

    tide: Array  # (n, 2) m/s, every TABLE_STEP_S
    wind: Array  # (n, 2)
    wind_depth: float
    depth: float  # m, of the bed
    eddies: Array  # (e, 4): amplitude [m/s], wave numbers kx, ky [rad/m], phase
    waves: Array  # (w, 5): amplitude [m], rad/s, rad/m, direction, phase


def draw_sea(sea: Sea, depth: float, duration_s: float, seed: int) -> SeaTable:
    """A realisation of the sea over water of this depth [m] for a mission of this length."""
    rng = generator(seed, "sea")
    n = int(duration_s / TABLE_STEP_S) + 2
    speed = rng.uniform(sea.current_speed_min, sea.current_speed_max)
    drawn = rng.uniform(-np.pi, np.pi)
    direction = drawn if sea.current_direction is None else sea.current_direction
    mean = speed * np.array([np.cos(direction), np.sin(direction)])
    varying = gauss_markov(rng, (n, 2), TABLE_STEP_S, sea.current_variation * speed, sea.current_time_constant)
    steps = sea.current_walk * np.sqrt(TABLE_STEP_S / 3600.0)
    walked = np.cumsum(steps * generator(seed, "sea", "walk").standard_normal((n, 2)), axis=0)
    gusts = gauss_markov(rng, (n, 2), TABLE_STEP_S, sea.wind_fraction * speed, sea.current_time_constant / 3.0)
    tide = mean + varying + walked
    return SeaTable(tide, gusts, sea.wind_depth, depth, _eddies(sea, speed, rng), _waves(sea, depth, rng))


def _eddies(sea: Sea, speed: float, rng: np.random.Generator) -> Array:
    numbers = 2.0 * np.pi / (sea.eddy_size * rng.uniform(0.6, 1.8, EDDIES))
    angles = rng.uniform(-np.pi, np.pi, EDDIES)
    amplitude = np.full(EDDIES, sea.eddy_fraction * speed * np.sqrt(2.0 / EDDIES))
    phase = rng.uniform(0.0, 2.0 * np.pi, EDDIES)
    return np.stack([amplitude, numbers * np.cos(angles), numbers * np.sin(angles), phase], axis=1)


def _waves(sea: Sea, depth: float, rng: np.random.Generator) -> Array:
    """Components of a Bretschneider spectrum, equally spaced in frequency about the peak."""
    peak = 2.0 * np.pi / sea.wave_period
    edges = peak * np.linspace(0.7, 2.0, WAVES + 1)
    omega = 0.5 * (edges[1:] + edges[:-1])
    spectrum = 0.3125 * sea.wave_height**2 * peak**4 / omega**5 * np.exp(-1.25 * (peak / omega) ** 4)
    amplitude = np.sqrt(2.0 * spectrum * np.diff(edges))
    direction = rng.uniform(-np.pi, np.pi) + rng.normal(0.0, 0.4, WAVES)
    phase = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    return np.stack([amplitude, omega, wave_number(omega, depth), direction, phase], axis=1)


def wave_number(omega: Array, depth: float) -> Array:
    """Wave number [rad/m] of the dispersion relation ``omega^2 = g k tanh(k h)``, by Newton's iteration."""
    k = omega**2 / GRAVITY / np.sqrt(np.tanh(omega**2 * depth / GRAVITY))
    for _ in range(20):
        tanh = np.tanh(k * depth)
        slope = GRAVITY * (tanh + k * depth * (1.0 - tanh**2))
        k = k - (GRAVITY * k * tanh - omega**2) / slope
    return np.asarray(k)


@kernel
def current(sea: SeaTable, t: float, position: Vec3) -> Vec3:
    """Velocity of the water [m/s, map] without waves, at a time [s] since the start and a place [m, map]."""
    i = min(int(t / TABLE_STEP_S), sea.tide.shape[0] - 2)
    f = t / TABLE_STEP_S - i
    z = min(position[2], 0.0)
    profile = max(1.0 + z / sea.depth, 0.02) ** (1.0 / 7.0)
    top = np.exp(z / sea.wind_depth)
    out = np.zeros(3)
    for c in range(2):
        tide = (1.0 - f) * sea.tide[i, c] + f * sea.tide[i + 1, c]
        wind = (1.0 - f) * sea.wind[i, c] + f * sea.wind[i + 1, c]
        out[c] = tide * profile + wind * top
    for e in range(sea.eddies.shape[0]):
        a, kx, ky, phase = sea.eddies[e]
        s = a * np.cos(kx * position[0] + ky * position[1] + phase) * profile / np.sqrt(kx * kx + ky * ky)
        out[0] += -ky * s
        out[1] += kx * s
    return out


@kernel
def elevation(sea: SeaTable, t: float, position: Vec3) -> float:
    """Height of the water's surface [m] over its mean."""
    height = 0.0
    for w in range(sea.waves.shape[0]):
        amplitude, omega, k, direction, phase = sea.waves[w]
        along = position[0] * np.cos(direction) + position[1] * np.sin(direction)
        height += amplitude * np.cos(k * along - omega * t + phase)
    return height


@kernel
def orbital(sea: SeaTable, t: float, position: Vec3) -> tuple[Vec3, Vec3]:
    """Velocity [m/s] and acceleration [m/s^2] of the water by waves (linear theory, finite depth; map axes).

    The acceleration is that of a particle: without its convective part a floating body would be drawn down.
    """
    velocity, acceleration, gradient = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    z = min(position[2], 0.0)
    for w in range(sea.waves.shape[0]):
        amplitude, omega, k, direction, phase = sea.waves[w]
        angle = k * (position[0] * np.cos(direction) + position[1] * np.sin(direction)) - omega * t + phase
        bed = np.exp(-2.0 * k * (z + sea.depth))  # cosh and sinh, kept from overflowing in deep water
        scale = amplitude * omega * np.exp(k * z) / (1.0 - np.exp(-2.0 * k * sea.depth))
        along, up = scale * (1.0 + bed), scale * (1.0 - bed)
        c, s = np.cos(angle), np.sin(angle)
        heading = np.array([np.cos(direction), np.sin(direction)])
        velocity[2] += up * s
        acceleration[2] -= omega * up * c
        gradient[2, 2] += k * along * s
        for i in range(2):
            velocity[i] += along * c * heading[i]
            acceleration[i] += omega * along * s * heading[i]
            gradient[i, 2] += k * up * c * heading[i]
            gradient[2, i] += k * up * c * heading[i]
            for j in range(2):
                gradient[i, j] -= k * along * s * heading[i] * heading[j]
    return velocity, acceleration + times(gradient, velocity)
