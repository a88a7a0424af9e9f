"""The world: rows of features over an undulating bed, and the prior map with its errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.geodesy import GeodeticPoint
from fbn_common.kernels import kernel
from fbn_common.parameters import ParameterError, group, param
from fbn_common.types import Array, Vec3
from fbn_sim.randomness import generator

UNDULATIONS = 5


@dataclass(frozen=True, slots=True)
class Row:
    """Like features in a row; one alone is a row of one."""

    start: tuple[float, float] = param((0.0, 0.0), "m", "first feature, map", "scenario")
    step: tuple[float, float] = param((20.0, 0.0), "m", "from one feature to the next", "scenario")
    count: int = param(1, "-", "features", "scenario")
    height: float = param(1.0, "m", "over the bed", "scenario")
    strength: float = param(0.0, "dB", "echo strength against the reference target", "scenario")


@dataclass(frozen=True, slots=True)
class World:
    """Where the scenario lies, its bed and its features."""

    datum: GeodeticPoint = group(GeodeticPoint)
    depth: float = param(5.0, "m", "of the water, mean", "scenario")
    undulation: float = param(0.08, "m", "standard deviation of the bed about it", "flat mud, assumed")
    undulation_size: float = param(25.0, "m", "typical wavelength of that", "assumed")
    scatter: float = param(0.7, "m", "features' standard deviation about their rows, each axis", "dropped from a boat")
    height_scatter: float = param(0.1, "m", "standard deviation of features' heights", "assumed")
    target: str = param("", "-", "name of the target feature (row's name and number, north_1)", "scenario")
    rows: dict[str, Row] = group(dict)

    def __post_init__(self) -> None:
        if self.depth <= 0.0:
            raise ParameterError("world.depth must be positive [m]")
        if self.target and self.target not in self.names():
            raise ParameterError(f"world.target: no feature {self.target!r}; there are {', '.join(self.names())}")

    def names(self) -> tuple[str, ...]:
        """Names of all features, in the order of their ids (1, 2, ...)."""
        return tuple(f"{name}_{i + 1}" for name, row in self.rows.items() for i in range(row.count))


@dataclass(frozen=True, slots=True)
class MapErrors:
    """How the prior map differs from the world."""

    sigma: float = param(5.0, "m", "absolute error, each axis", "side-scan survey by another vehicle, IROS 2007")
    correlation_length: float = param(1000.0, "m", "L of the errors' covariance sigma^2 / (1 + d / L)", "1 m over 20 m")
    sigma_up: float = param(0.5, "m", "error of heights, independent", "assumed")
    missing: int = param(0, "-", "features (never the target) that the map lacks", "scenario")
    surplus: int = param(0, "-", "features on the map that are not there", "scenario")
    shift: tuple[float, float] = param((0.0, 0.0), "m", "a blunder on top of the drawn error", "scenario")
    shift_alone: bool = param(False, "-", "the drawn error's mean is taken off: the shift is all there is", "scenario")
    visibility: float = param(0.67, "-", "detections per scan, as the map states it", "two of three, JOE 2013 III-B")


class Features(NamedTuple):
    """Features as they are: ids (n,), names, positions (n, 3) [m, map], echo strengths (n,) [dB]."""

    ids: tuple[int, ...]
    names: tuple[str, ...]
    positions: Array
    strengths: Array


class MappedFeature(NamedTuple):
    """A feature as the prior map states it."""

    id: int
    name: str
    position: Vec3
    sigma: float
    visibility: float
    target: bool


def draw_bed(world: World, seed: int) -> Array:
    """A realisation of the bed for :func:`bed_height`: rows of amplitude [m], kx, ky [rad/m], phase; first the mean."""
    rng = generator(seed, "bed")
    waves = np.empty((UNDULATIONS + 1, 4))
    waves[0] = -world.depth, 0.0, 0.0, 0.0
    numbers = 2.0 * np.pi / (world.undulation_size * rng.uniform(0.5, 2.0, UNDULATIONS))
    angles = rng.uniform(-np.pi, np.pi, UNDULATIONS)
    waves[1:, 0] = world.undulation * np.sqrt(2.0 / UNDULATIONS)
    waves[1:, 1], waves[1:, 2] = numbers * np.cos(angles), numbers * np.sin(angles)
    waves[1:, 3] = rng.uniform(0.0, 2.0 * np.pi, UNDULATIONS)
    return waves


@kernel
def bed_height(bed: Array, x: float, y: float) -> float:
    """z of the bed [m, map, negative] at a place."""
    z = 0.0
    for i in range(bed.shape[0]):
        z += bed[i, 0] * np.cos(bed[i, 1] * x + bed[i, 2] * y + bed[i, 3])
    return z


def draw_features(world: World, bed: Array, seed: int) -> Features:
    """The features where they came to lie."""
    rng = generator(seed, "features")
    places, strengths = [], []
    for row in world.rows.values():
        for i in range(row.count):
            x, y = np.array(row.start) + i * np.array(row.step) + world.scatter * rng.standard_normal(2)
            z = bed_height(bed, x, y) + max(row.height + world.height_scatter * rng.standard_normal(), 0.0)
            places.append([x, y, z])
            strengths.append(row.strength)
    ids = tuple(range(1, len(places) + 1))
    return Features(ids, world.names(), np.array(places).reshape(-1, 3), np.array(strengths))


def draw_prior_map(world: World, errors: MapErrors, features: Features, seed: int) -> tuple[MappedFeature, ...]:
    """The prior map: correlated errors that leave neighbours well placed to one another, gaps and inventions."""
    rng = generator(seed, "prior map")
    kept = _without(world, errors, features, rng)
    names = [features.names[i] for i in kept] + [f"surplus_{i + 1}" for i in range(errors.surplus)]
    ids = [features.ids[i] for i in kept] + [len(features.ids) + 1 + i for i in range(errors.surplus)]
    stated = np.concatenate([features.positions[kept], _invented(errors.surplus, features, rng)])
    stated = stated + correlated_errors(stated, errors, rng)
    return tuple(
        MappedFeature(i, name, position, errors.sigma, errors.visibility, name == world.target)
        for i, name, position in zip(ids, names, stated, strict=True)
    )


def _invented(count: int, features: Features, rng: np.random.Generator) -> Array:
    """Positions (count, 3) [m] in and about the field that hold nothing."""
    if not count:
        return np.empty((0, 3))
    low, high = features.positions.min(axis=0), features.positions.max(axis=0)
    margin = np.array([10.0, 10.0, 0.0])
    return rng.uniform(low - margin, high + margin, (count, 3))


def _without(world: World, errors: MapErrors, features: Features, rng: np.random.Generator) -> list[int]:
    candidates = [i for i, name in enumerate(features.names) if name != world.target]
    if errors.missing > len(candidates):
        raise ParameterError(f"prior_map.missing is {errors.missing}, but only {len(candidates)} can be left out")
    lost = set(rng.choice(candidates, errors.missing, replace=False).tolist()) if errors.missing else set()
    return [i for i in range(len(features.ids)) if i not in lost]


def correlated_errors(positions: Array, errors: MapErrors, rng: np.random.Generator) -> Array:
    """Errors (n, 3) [m] of positions (n, 3): per axis of the plane, covariance ``sigma^2 / (1 + d_ij / L)``."""
    distance = np.linalg.norm(positions[:, None, :2] - positions[None, :, :2], axis=2)
    covariance = errors.sigma**2 / (1.0 + distance / errors.correlation_length)
    root = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(positions)))
    plane = root @ rng.standard_normal((len(positions), 2))
    if errors.shift_alone and len(positions):
        plane -= plane.mean(axis=0)
    plane += np.array(errors.shift)
    return np.column_stack([plane, errors.sigma_up * rng.standard_normal(len(positions))])
