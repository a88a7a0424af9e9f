"""Pressure sensor and altimeter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from fbn_common.parameters import group, param
from fbn_common.records import FluidPressure, Range
from fbn_common.types import Array
from fbn_sim.motion import Motion
from fbn_sim.randomness import gauss_markov, generator
from fbn_sim.sea import GRAVITY
from fbn_sim.sensors.sample import Entry, Flight, Timing, rotations, sample

PRESSURE_TOPIC, ALTITUDE_TOPIC = "pressure", "altitude"
ATMOSPHERE = 101_325.0  # Pa


@dataclass(frozen=True, slots=True)
class Pressure:
    """Absolute pressure of the water at the vehicle."""

    timing: Timing = group(partial(Timing, 5.0))
    position: tuple[float, float, float] = param((0.0, 0.0, 0.0), "m", "place on the vehicle", "assumed")
    noise: float = param(80.0, "Pa", "white noise", "8 mm of water")
    drift_sigma: float = param(80.0, "Pa", "standard deviation of the slow drift", "temperature, assumed")
    drift_time_constant: float = param(400.0, "s", "its correlation time", "assumed")
    atmosphere_sigma: float = param(150.0, "Pa", "of the air pressure about 101,325 Pa, left after zeroing", "assumed")
    step: float = param(10.0, "Pa", "quantisation", "1 mm of water")
    stated_sigma: float = param(180.0, "Pa", "standard deviation published: of the total error", "2 cm of water")


@dataclass(frozen=True, slots=True)
class Altimeter:
    """A narrow echo sounder that looks down along ``altimeter_link`` x."""

    timing: Timing = group(partial(Timing, 5.0))
    noise: float = param(0.02, "m", "white noise", "data sheet class")
    scale_sigma: float = param(0.005, "-", "of the scale: speed of sound", "assumed")
    beam: float = param(0.17, "rad", "full width of the beam", "10 deg")
    no_bottom: float = param(0.03, "-", "chance of no echo: 0.0 is reported", "assumed")
    outlier: float = param(0.01, "-", "chance of an echo from something nearer", "fish, bubbles, assumed")
    min_range: float = param(0.3, "m", "nearest range", "data sheet class")
    max_range: float = param(30.0, "m", "farthest range", "data sheet class")


def pressure_records(sensor: Pressure, density: float, flight: Flight) -> list[Entry]:
    """The pressure sensor's records: ``atmosphere + density g depth`` with its errors, in steps."""
    rng = generator(flight.seed, "pressure")
    taken = sample(flight, sensor.timing, rng)
    n = len(taken.time_s)
    arm = rotations(taken.motion.orientation) @ np.array(sensor.position)
    depth = np.maximum(-(taken.motion.position[:, 2] + arm[:, 2]), 0.0)
    air = ATMOSPHERE + sensor.atmosphere_sigma * rng.standard_normal()
    step_s = 1.0 / max(sensor.timing.rate, 1e-9)
    drift = gauss_markov(rng, (n,), step_s, sensor.drift_sigma, sensor.drift_time_constant) if n else np.empty(0)
    pascal = air + density * GRAVITY * depth + drift + sensor.noise * rng.standard_normal(n)
    pascal = np.round(pascal / sensor.step) * sensor.step
    return [
        Entry(log, PRESSURE_TOPIC, FluidPressure(stamp, "base_link", float(p), sensor.stated_sigma**2))
        for stamp, log, kept, p in zip(taken.stamp_ns, taken.log_time_ns, taken.kept, pascal, strict=True)
        if kept
    ]


def altitude_records(sensor: Altimeter, flight: Flight) -> list[Entry]:
    """The altimeter's records; no echo is 0.0."""
    rng = generator(flight.seed, "altimeter")
    taken = sample(flight, sensor.timing, rng)
    measured = _slant_ranges(sensor, taken.motion, rng)
    form = (sensor.beam, sensor.min_range, sensor.max_range)
    return [
        Entry(log, ALTITUDE_TOPIC, Range(stamp, "altimeter_link", 0, *form, float(r)))
        for stamp, log, kept, r in zip(taken.stamp_ns, taken.log_time_ns, taken.kept, measured, strict=True)
        if kept
    ]


def _slant_ranges(sensor: Altimeter, motion: Motion, rng: np.random.Generator) -> Array:
    """Range (n,) [m] to the bed: the nearest point inside the beam answers first."""
    n = len(motion.time_s)
    tilt = np.arccos(np.clip(rotations(motion.orientation)[:, 2, 2], -1.0, 1.0))
    slant = motion.altitude / np.cos(np.maximum(tilt - sensor.beam / 2.0, 0.0))
    scale = 1.0 + sensor.scale_sigma * rng.standard_normal()
    r = slant * scale + sensor.noise * rng.standard_normal(n)
    nearer = rng.random(n) < sensor.outlier
    r = np.where(nearer, r * rng.uniform(0.2, 0.9, n), r)
    silent = (rng.random(n) < sensor.no_bottom) | (r < sensor.min_range) | (r > sensor.max_range)
    return np.where(silent, 0.0, np.round(r, 3))
