"""The prior map as a distribution: one correlated Gaussian over all its features, taken into a state as needed.

``Cov(x_i, x_j) = s_i s_j / (1 + d_ij / L)`` per horizontal axis (a mixture of ``exp(-u d / L)`` over ``u``, hence
positive definite in any dimension), beside each feature's own part; heights share the tide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from fbn_common.geodesy import GeodeticPoint
from fbn_common.prior_map import PriorFeature, PriorMap
from fbn_common.types import Array
from fbn_global.parameters import PriorMapParameters
from fbn_global.state import Block, Kind, State, append, conditional

Rows = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """The features by row: position (m, 3), horizontal and vertical sigma (m,) [m], existence and visibility (m,)."""

    features: tuple[PriorFeature, ...]
    position: Array
    sigma: Array
    up_sigma: Array
    existence: Array
    visibility: Array
    parameters: PriorMapParameters
    tree: cKDTree | None
    datum: GeodeticPoint

    def covariance(self, a: Rows, b: Rows) -> Array:
        """Prior covariance (3 a, 3 b) [m^2] of these rows' positions."""
        p = self.parameters
        same = (a[:, None] == b[None, :]).astype(float)
        distance = cdist(self.position[a, :2], self.position[b, :2])
        horizontal = np.outer(self.sigma[a], self.sigma[b]) / (1.0 + distance / p.length) + p.own_sigma**2 * same
        vertical = p.up_common**2 + self.up_sigma[a][:, None] ** 2 * same
        full = np.zeros((len(a), 3, len(b), 3))
        full[:, 0, :, 0] = full[:, 1, :, 1] = horizontal
        full[:, 2, :, 2] = vertical
        return full.reshape(3 * len(a), 3 * len(b))

    def around(self, points: Array, radius: float) -> Rows:
        """Rows within a horizontal radius [m] of any of the points (n, 2), in order."""
        if self.tree is None or len(points) == 0:
            return np.zeros(0, dtype=np.int64)
        found: set[int] = set()
        for point in points:
            found.update(self.tree.query_ball_point(point, radius))
        return np.array(sorted(found), dtype=np.int64)

    def inside(self, low: Array, high: Array) -> Rows:
        """Rows within an axis-aligned box, corners (2,) [m]."""
        xy = self.position[:, :2]
        return np.flatnonzero(((xy >= low) & (xy <= high)).all(axis=1)).astype(np.int64)


def build_field(prior: PriorMap, datum: GeodeticPoint, parameters: PriorMapParameters) -> Field:
    """The field of a map about a datum; what the file leaves open comes from the parameters."""
    p, features = parameters, prior.features
    position = prior.positions(datum)
    unknown = np.isnan(position[:, 2])
    position[unknown, 2] = p.unknown_up

    def values(given: list[float | None], default: float) -> Array:
        return np.array([default if v is None else v for v in given], dtype=float)

    return Field(
        features,
        position,
        values([f.sigma for f in features], p.sigma),
        np.where(unknown, p.unknown_up_sigma, p.up_sigma),
        np.minimum(values([f.existence for f in features], p.existence), 0.99),  # a map is never quite sure
        np.clip(values([f.visibility for f in features], p.visibility), 0.02, 0.98),
        p,
        cKDTree(position[:, :2]) if len(features) else None,
        datum,
    )


def instantiate(state: State, field: Field, rows: Rows) -> State:
    """The state with these features of the map in it as well, conditioned on what it knows of the others.

    Exact as long as no matched feature of the map has left the state: given those in it, a feature is independent
    of all else.
    """
    new = np.array([r for r in rows.tolist() if Block(Kind.MAP, r) not in state], dtype=np.int64)
    if len(new) == 0:
        return state
    held = np.array(state.ids(Kind.MAP), dtype=np.int64)
    added = tuple(Block(Kind.MAP, r) for r in new.tolist())
    mean, covariance = field.position[new].ravel(), field.covariance(new, new)
    if len(held) == 0:
        return append(state, added, mean, covariance, np.zeros((len(mean), len(state.mean))))
    gain, explained = conditional(field.covariance(held, held), field.covariance(new, held))
    at = state.columns(*(Block(Kind.MAP, r) for r in held.tolist()))
    mean = mean + gain @ (state.mean[at] - field.position[held].ravel())
    cross = gain @ state.covariance[at]
    return append(state, added, mean, covariance - explained + cross[:, at] @ gain.T, cross)
