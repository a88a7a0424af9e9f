"""What echoes beside the features: patches of the bed that stay, fish that swim, bubbles that drift and fade."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.parameters import param
from fbn_common.types import Array
from fbn_sim.motion import Motion
from fbn_sim.randomness import generator
from fbn_sim.world import Features, bed_height

REACH = 45.0  # m, about the track that is filled with clutter


@dataclass(frozen=True, slots=True)
class Clutter:
    """How much there is of it."""

    noise: float = param(0.4, "-", "false alarms a ping and array", "assumed")
    patches: float = param(6e-4, "1/m^2", "patches of the bed that echo", "one in 40 m by 40 m")
    patch_strength: float = param(-9.0, "dB", "their mean strength against the reference target", "seen now and then")
    fish: float = param(1e-4, "1/m^2", "fish at any time", "one in 100 m by 100 m")
    fish_strength: float = param(-8.0, "dB", "their mean strength", "assumed")
    fish_speed: float = param(0.3, "m/s", "their mean speed", "assumed")
    fish_seconds: float = param(90.0, "s", "how long one stays a target", "assumed")
    bubbles: float = param(1e-4, "1/m^2", "clouds of bubbles at any time, within 1.5 m of the surface", "assumed")
    bubble_strength: float = param(-6.0, "dB", "their mean strength", "assumed")
    bubble_seconds: float = param(15.0, "s", "how long one stays a target", "assumed")


class Scatterers(NamedTuple):
    """All that can echo, features first: a row each."""

    features: int  # how many of the rows are features
    places: Array  # (n, 3) m, map, at the begin of its life
    drift: Array  # (n, 3) m/s
    life: Array  # (n, 2) s since the start
    strength: Array  # (n,) dB against the reference target
    aspect_gain: Array  # (n,) dB, amplitude over aspect
    aspect_order: Array  # (n,) lobes a circle
    aspect_phase: Array  # (n,) rad


def draw_scatterers(clutter: Clutter, features: Features, bed: Array, motion: Motion, seed: int) -> Scatterers:
    """Features and clutter about the track."""
    parts = [_features(features, seed)]
    parts.append(_patches(clutter, bed, motion, generator(seed, "clutter", "patches")))
    parts.append(_fish(clutter, bed, motion, generator(seed, "clutter", "fish")))
    parts.append(_bubbles(clutter, motion, generator(seed, "clutter", "bubbles")))
    rows = [np.ascontiguousarray(np.concatenate([p[i] for p in parts])) for i in range(7)]
    return Scatterers(len(features.ids), *rows)


def _area(motion: Motion) -> tuple[Array, Array, float]:
    low = motion.position[:, :2].min(axis=0) - REACH
    high = motion.position[:, :2].max(axis=0) + REACH
    return low, high, float(np.prod(high - low))


def _rows(
    rng: np.random.Generator, places: Array, drift: Array, life: Array, strength: Array, gain: float, order: int
) -> list[Array]:
    n = len(places)
    phase = rng.uniform(-np.pi, np.pi, n)
    return [places, drift, life, strength, np.full(n, gain), np.full(n, float(order)), phase]


def _features(features: Features, seed: int) -> list[Array]:
    n, rng = len(features.ids), generator(seed, "features", "aspect")
    always = np.tile([-1.0, 1e9], (n, 1))
    strength = features.strengths + 1.5 * rng.standard_normal(n)
    return _rows(rng, features.positions, np.zeros((n, 3)), always, strength, 3.0, 4)


def _patches(clutter: Clutter, bed: Array, motion: Motion, rng: np.random.Generator) -> list[Array]:
    low, high, area = _area(motion)
    n = int(rng.poisson(clutter.patches * area))
    xy = rng.uniform(low, high, (n, 2))
    z = np.array([bed_height(bed, x, y) for x, y in xy])
    strength = clutter.patch_strength + 3.0 * rng.standard_normal(n)
    return _rows(rng, np.column_stack([xy, z]), np.zeros((n, 3)), np.tile([-1.0, 1e9], (n, 1)), strength, 6.0, 2)


def _lives(rate: float, seconds: float, duration: float, rng: np.random.Generator) -> Array:
    """Births and deaths (n, 2) [s] such that ``rate`` are alive on average."""
    n = int(rng.poisson(rate * (duration + 4.0 * seconds) / seconds))
    birth = rng.uniform(-4.0 * seconds, duration, n)
    return np.column_stack([birth, birth + rng.exponential(seconds, n)])


def _fish(clutter: Clutter, bed: Array, motion: Motion, rng: np.random.Generator) -> list[Array]:
    low, high, area = _area(motion)
    life = _lives(clutter.fish * area, clutter.fish_seconds, motion.time_s[-1], rng)
    n = len(life)
    xy = rng.uniform(low, high, (n, 2))
    floor = np.array([bed_height(bed, x, y) for x, y in xy])
    z = floor * rng.uniform(0.15, 0.95, n)
    heading, speed = rng.uniform(-np.pi, np.pi, n), clutter.fish_speed * rng.rayleigh(0.8, n)
    drift = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros(n)])
    strength = clutter.fish_strength + 3.0 * rng.standard_normal(n)
    return _rows(rng, np.column_stack([xy, z]), drift, life, strength, 4.0, 2)


def _bubbles(clutter: Clutter, motion: Motion, rng: np.random.Generator) -> list[Array]:
    low, high, area = _area(motion)
    life = _lives(clutter.bubbles * area, clutter.bubble_seconds, motion.time_s[-1], rng)
    n = len(life)
    place = np.column_stack([rng.uniform(low, high, (n, 2)), -rng.uniform(0.1, 1.5, n)])
    drift = np.zeros((n, 3))
    drift[:, :2] = motion.current[:, :2].mean(axis=0)
    drift[:, 2] = 0.01
    strength = clutter.bubble_strength + 3.0 * rng.standard_normal(n)
    return _rows(rng, place, drift, life, strength, 2.0, 1)
