"""Which terms of a sonar's range and bearing a vehicle's motion shows: the numbers N1 to N8.

Each is the change that one term makes from one ping to the next, over the wavelength (range) or over the beam's width
(bearing); a term is observable where its number exceeds the sonar's resolution, in the same measure: a quarter for a
sonar that resolves the phase.  After Rikoski and Leonard, Trajectory Sonar Perception in the Ligurian Sea, section 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi, tanh

from fbn_common.parameters import ParameterError

GRAVITY = 9.80665  # m/s^2
QUARTER = 0.25  # resolution of a sonar that resolves the phase, in wavelengths; beam widths alike


@dataclass(frozen=True, slots=True)
class Wave:
    """A surface wave: amplitude [m] (half its height), period [s], and the depth of the water [m]."""

    amplitude: float
    period: float
    depth: float

    def __post_init__(self) -> None:
        if self.amplitude < 0.0 or min(self.period, self.depth) <= 0.0:
            raise ParameterError(
                "a wave's period [s] and the water's depth [m] must be positive, its amplitude not < 0"
            )

    @property
    def frequency(self) -> float:
        """Angular frequency [rad/s]."""
        return 2.0 * pi / self.period

    @property
    def number(self) -> float:
        """Wave number K [rad/m] of linear waves: ``omega^2 = g K tanh(K h)``, by Newton's method."""
        deep = self.frequency**2 / GRAVITY
        K = deep / max(tanh(deep * self.depth) ** 0.5, 1e-6)  # within a few per cent at any depth
        for _ in range(20):
            t = tanh(K * self.depth)
            step = (GRAVITY * K * t - self.frequency**2) / (GRAVITY * (t + K * self.depth * (1.0 - t * t)))
            K -= step
            if abs(step) < 1e-12 * K:
                break
        return K

    def deep_speed(self, z: float) -> float:
        """Largest speed [m/s] of the water at height z < 0 [m] in water deeper than half a wavelength."""
        return self.amplitude * self.frequency * exp(self.frequency**2 / GRAVITY * z)

    def shallow_speed(self, z: float) -> float:
        """Largest horizontal speed [m/s] of the water at height z < 0 [m] over a bed at ``depth``."""
        K, h = self.number, self.depth
        decay = exp(K * z) * (1.0 + exp(-2.0 * K * (z + h))) / (1.0 + exp(-2.0 * K * h))  # cosh K(z+h) / cosh Kh
        return GRAVITY * self.amplitude * K / self.frequency * decay


@dataclass(frozen=True, slots=True)
class Motion:
    """What the numbers are made of; ``height`` is the vehicle's z, negative under water."""

    speed: float  # m/s
    turn_rate: float  # rad/s
    acceleration: float  # m/s^2
    ping_rate: float  # Hz
    wavelength: float  # m, of the sound
    aperture: float  # m, of an array
    range_min: float  # m, of the nearest target
    height: float  # m
    wave: Wave

    def __post_init__(self) -> None:
        if min(self.ping_rate, self.wavelength, self.aperture, self.range_min) <= 0.0:
            raise ParameterError("ping_rate [Hz], wavelength, aperture and range_min [m] must be positive")
        if min(self.speed, self.turn_rate, self.acceleration) < 0.0 or not -self.wave.depth <= self.height <= 0.0:
            raise ParameterError("speed, turn_rate, acceleration must not be negative; the vehicle is in the water")


def numbers(m: Motion) -> tuple[float, ...]:
    """N1 to N8.

    N1 range by speed; N2 to N4 range's second order by passing, turning, accelerating; N5, N6 bearing by passing and
    turning; N7, N8 range by waves, in deep water and over a bed.
    """
    unit = m.wavelength * m.ping_rate
    second = 2.0 * m.ping_rate * unit
    return (
        m.speed / unit,
        m.speed**2 / (second * m.range_min),
        m.speed * m.turn_rate / second,
        m.acceleration / second,
        m.speed * m.aperture / (m.range_min * unit),
        m.turn_rate * m.aperture / unit,
        m.wave.deep_speed(m.height) / unit,
        m.wave.shallow_speed(m.height) / unit,
    )


def thresholds(range_sigma: float, bearing_sigma: float, wavelength: float, aperture: float) -> tuple[float, ...]:
    """What N1 to N8 must exceed for a detector of these sigmas [m, rad]: its resolution, in their own measure."""
    in_range, in_bearing = range_sigma / wavelength, bearing_sigma * aperture / wavelength
    return (in_range,) * 4 + (in_bearing,) * 2 + (in_range,) * 2
