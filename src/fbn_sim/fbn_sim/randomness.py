"""Random numbers: one seed for all, and a generator of its own for each purpose.

Generators are told apart by name, so that switching off one sensor changes no other.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np
from scipy.signal import lfilter

from fbn_common.types import Array


def generator(seed: int, *names: str) -> np.random.Generator:
    """The generator of this seed and purpose; the same on every machine."""
    return np.random.Generator(np.random.PCG64([seed, *(crc32(name.encode()) for name in names)]))


def gauss_markov(rng: np.random.Generator, shape: tuple[int, ...], step_s: float, sigma: float, tau_s: float) -> Array:
    """A stationary first-order Gauss-Markov process along the first axis.

    ``shape`` (n, ...), samples ``step_s`` apart, standard deviation ``sigma``, correlation time ``tau_s``:
    ``E[x(t) x(t + d)] = sigma^2 exp(-d / tau)``.
    """
    decay = np.exp(-step_s / tau_s)
    drive = rng.standard_normal(shape) * np.sqrt(1.0 - decay**2)
    drive[:1] /= np.sqrt(1.0 - decay**2)  # starts in its stationary distribution
    return sigma * np.asarray(lfilter([1.0], [1.0, -decay], drive, axis=0))
