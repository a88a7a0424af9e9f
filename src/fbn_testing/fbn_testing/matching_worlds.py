"""Drawn worlds in which matching is studied: the river's field, ambiguous rows, maps that err, maps of elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fbn_common.types import Array
from fbn_testing.composite_world import Run, Settings, World, charles_river

SPACING = 20.0  # m, of the rows
COLUMNS, ROWS = 8, 3
SCATTER = 0.3  # m, of a feature about its place in the grid


def grid(columns: int, rows: int, scatter: float, seed: int) -> Array:
    """Like features (n, 3) 20 m apart, row by row."""
    rng = np.random.default_rng(seed + 20_000)
    xy = np.array([(SPACING * i, SPACING * j) for j in range(rows) for i in range(columns)])
    return np.column_stack([xy + scatter * rng.standard_normal(xy.shape), np.full(len(xy), -4.0)])


def rows_world(seed: int, offset: float, observed: int) -> Settings:
    """Into a grid along its rows, until about so many columns were passed; the map lies off along the rows."""
    return replace(drawn_rows_world(seed, observed), map_error=0.5, map_shift=(-offset, 0.0))


def drawn_rows_world(seed: int, observed: int) -> Settings:
    """The same with the map's error drawn as the map states it."""
    length = SPACING * (observed - 1)
    return Settings(
        grid(COLUMNS, ROWS, SCATTER, seed), ((-60.0, 10.0), (length - 30.0, 10.0)), seed=seed,
        fix_sigma=1.0, drift_sigma=0.03,
    )  # fmt: skip


def river_world(seed: int, **changes: object) -> Settings:
    """Lanes over twelve features in rows of 5, 2 and 5."""
    legs = ((-40.0, 5.0), (80.0, 5.0), (80.0, 35.0), (0.0, 35.0), (0.0, 20.0), (80.0, 20.0))
    return replace(Settings(charles_river(seed), legs, seed=seed), **changes)  # type: ignore[arg-type]


def elsewhere(seed: int) -> Run:
    """A run in one field with the map of another, as dense."""
    run = World(river_world(seed)).make()
    rng = np.random.default_rng(seed + 30_000)
    other = np.column_stack([rng.uniform(-10, 90, 12), rng.uniform(-10, 50, 12), np.full(12, -4.0)])
    run.prior = World(river_world(seed, features=other)).run.prior
    run.key_feature = dict.fromkeys(run.key_feature, -1)
    return run


def drawn(seed: int) -> Run:
    """A world of any kind, its map's error drawn as the map states it: rows, the river's field, or another place."""
    kind = seed % 4
    if kind < 2:
        return World(drawn_rows_world(seed, (3, 5)[kind])).make()
    return elsewhere(seed) if kind == 2 else World(river_world(seed, missing=0.2, surplus=0.2)).make()


def lattice_world(seed: int, count: int) -> Settings:
    """A run through the middle of like rows of so many features, the map known to three rows only."""
    columns = round(count**0.5 * 1.15)
    features = grid(columns, -(-count // columns), SCATTER, seed)[:count]
    middle = features.mean(axis=0)
    legs = [(-50.0, -10.0), (60.0, -10.0)]
    drawn_legs = tuple((float(middle[0]) + x, float(middle[1]) + y) for x, y in legs)
    return Settings(features, drawn_legs, seed=seed, map_sigma=30.0, map_error=3.0)
