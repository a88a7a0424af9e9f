"""Chi-square bounds from ``scipy.special``: the same numbers as ``scipy.stats``, which takes a second to import."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from fbn_common.types import Array


def bound(probability: float | Array, dof: float | Array | npt.NDArray[np.int64]) -> Array:
    """The value that a chi-square variable of ``dof`` degrees of freedom stays under with this probability."""
    return np.asarray(chdtri(dof, 1.0 - np.asarray(probability)))


def bound_of_tail(probability: float, dof: float) -> float:
    """The value that a chi-square variable exceeds with this, perhaps very small, probability."""
    return float(chdtri(dof, probability))


def band(dof: float) -> tuple[float, float]:
    """The 95 % band of a normalised square over its degrees of freedom: how far from 1 chance takes it."""
    return float(chdtri(dof, 0.975)) / dof, float(chdtri(dof, 0.025)) / dof
