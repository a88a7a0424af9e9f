"""Which beacons agree: the sets of them that one position explains best.

See docs/equations/reference.md, "Beacons that lie".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fbn_common import chi_square
from fbn_common.types import Array, Mat2, Vec2, Vec3

MOST = 6  # beacons compared with one another, 64 sets; those heard less are held against what these agree on
_ITERATIONS = 12
_APART = 25.0  # squared distance of two places, over their covariance, from which on they are two: 5 deviations


@dataclass(frozen=True, slots=True)
class Heard:
    """What was heard of a beacon in a window."""

    name: str
    beacon: Vec3  # m, in map
    places: Array  # (n, 3) m, in map: where each range was measured if the position is what it is taken to be
    ranges: Array  # (n,) m
    variances: Array  # (n,) m^2

    def middle(self) -> int:
        """Index of the range whose misfit is the median: it stands for the beacon, so that outliers do not."""
        misfit = self.ranges - np.linalg.norm(self.places - self.beacon, axis=1)
        return int(np.argsort(misfit, kind="stable")[(len(misfit) - 1) // 2])


@dataclass(frozen=True, slots=True)
class Circles:
    """One range of each of m beacons, as circles about where the beacon is from the position's error (0, 0)."""

    centres: Array  # (m, 2) m
    heights: Array  # (m,) m, of the beacon over the vehicle
    ranges: Array  # (m,) m
    sigmas: Array  # (m,) m

    @staticmethod
    def of(heard: Sequence[Heard]) -> Circles:
        """From each beacon's middle range."""
        at = [h.middle() for h in heard]
        arms = np.array([h.beacon - h.places[i] for h, i in zip(heard, at, strict=True)])
        ranges = np.array([h.ranges[i] for h, i in zip(heard, at, strict=True)])
        variances = np.array([h.variances[i] for h, i in zip(heard, at, strict=True)])
        return Circles(arms[:, :2], arms[:, 2], ranges, np.sqrt(variances))

    def some(self, index: Sequence[int]) -> Circles:
        """Those of some beacons."""
        at = np.array(index)
        return Circles(self.centres[at], self.heights[at], self.ranges[at], self.sigmas[at])

    def misfit(self, offsets: Array) -> tuple[Array, Array]:
        """Ranges less distances (k, m) at offsets (k, 2), and their derivatives (k, m, 2), over the sigmas."""
        arms = offsets[:, None, :] - self.centres
        distances = np.maximum(np.sqrt((arms * arms).sum(axis=2) + self.heights**2), 1e-3)
        slopes = -arms / (distances * self.sigmas)[:, :, None]
        return (self.ranges - distances) / self.sigmas, slopes

    def starts(self) -> Array:
        """Offsets (k, 2) to begin at: none, and where two circles meet or come closest."""
        flat = np.sqrt(np.maximum(self.ranges**2 - self.heights**2, 0.0))
        pairs = combinations(range(len(self.ranges)), 2)
        met = [p for i, j in pairs for p in _meet(self.centres[i], flat[i], self.centres[j], flat[j])]
        return np.array([np.zeros(2), *met])


def _meet(a: Vec2, ra: float, b: Vec2, rb: float) -> Iterator[Vec2]:
    """The two points in which circles meet; one on the line through both centres where they do not."""
    apart = float(np.hypot(*(b - a)))
    if apart < 1e-6:
        return
    along = (b - a) / apart
    x = (ra**2 - rb**2 + apart**2) / (2.0 * apart)
    y = np.sqrt(max(ra**2 - x**2, 0.0))
    across = np.array([-along[1], along[0]])
    yield a + x * along + y * across
    yield a + x * along - y * across


@dataclass(frozen=True, slots=True)
class Fit:
    """The most likely error of the position under a prior and some beacons' ranges."""

    offset: Vec2
    covariance: Mat2
    cost: float  # chi-square, the prior's part included: as many degrees of freedom as there are beacons
    elsewhere: float  # the least cost of another such place, infinite without one


def fit(prior: Mat2, circles: Circles, starts: Array) -> Fit:
    """Gauss-Newton with Levenberg's damping, from all starts (k, 2) at once; the best place and the next best."""
    information, offsets = np.linalg.inv(prior), starts

    def cost(at: Array) -> Array:
        misfit, _ = circles.misfit(at)
        return np.asarray((misfit * misfit).sum(axis=1) + np.einsum("ki,ij,kj->k", at, information, at))

    found, damping = cost(offsets), np.full(len(offsets), 1e-6)
    for _ in range(_ITERATIONS):
        misfit, slopes = circles.misfit(offsets)
        normal = np.einsum("kmi,kmj->kij", slopes, slopes) + information
        pull = -np.einsum("kmi,km->ki", slopes, misfit) - offsets @ information
        damped = normal + (damping * np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(2)
        tried = offsets + np.linalg.solve(damped, pull[:, :, None])[:, :, 0]
        after = cost(tried)
        better = after <= found
        offsets, found = np.where(better[:, None], tried, offsets), np.where(better, after, found)
        damping = np.where(better, damping / 10.0, np.maximum(damping, 1e-4) * 10.0)
    k = int(np.argmin(found))
    _, slopes = circles.misfit(offsets[k : k + 1])
    normal = slopes[0].T @ slopes[0] + information
    apart = np.einsum("ki,ij,kj->k", offsets - offsets[k], normal, offsets - offsets[k])
    return Fit(offsets[k], np.linalg.inv(normal), float(found[k]), float(min(found[apart > _APART], default=np.inf)))


@dataclass(frozen=True, slots=True)
class Consensus:
    """Who is believed.  Beacons in neither set contradict those that are."""

    believed: tuple[str, ...]
    undecided: tuple[str, ...]  # in some of the sets that explain the ranges about as well, not in all
    mirrored: bool  # not even the best set tells which of two places it is: none of it is believed
    fit: Fit  # by those that are believed


def consensus(prior: Mat2, heard: Sequence[Heard], gate: float, margin: float) -> Consensus | None:
    """The beacons that are in every set that explains the ranges best; None where the prior rejects them all.

    ``prior`` (2, 2) [m^2]: the position's covariance.  A set costs the chi-square of its fit, and each beacon left
    out the bound that a good one passes with probability ``gate``: who is left out must have saved more than that.
    Sets compete whose cost is within ``margin`` of the best.  At most 63 sets are tried, whatever is heard.
    """
    ranked = sorted(heard, key=lambda h: (-len(h.ranges), h.name))
    first, rest = ranked[:MOST], ranked[MOST:]
    circles, price = Circles.of(first), chi_square.bound_of_tail(gate, 1)
    fits = _fits(prior, circles, price, margin)
    best = min(fits, key=lambda s: fits[s].cost)
    place = fits[best]
    if place.cost > price * len(first):
        return None
    rivals = [frozenset(s) for s, f in fits.items() if f.cost <= place.cost + margin]
    sure, some = sorted(frozenset.intersection(*rivals)), frozenset.union(*rivals)
    mirrored = place.elsewhere <= place.cost + margin
    if mirrored or not sure:
        return Consensus((), tuple(sorted(first[i].name for i in some)), mirrored, Fit(np.zeros(2), prior, 0.0, np.inf))
    held = fit(prior, circles.some(sure), place.offset[None])
    more = [h.name for h in rest if outlying(h, held, gate)[h.middle()] <= 1.0]
    believed = tuple(sorted([*(first[i].name for i in sure), *more]))
    return Consensus(believed, tuple(sorted(first[i].name for i in some if i not in sure)), False, held)


def _fits(prior: Mat2, circles: Circles, price: float, margin: float) -> dict[tuple[int, ...], Fit]:
    """Each set's fit, the price of those left out in its costs; larger sets first, as far as one can still compete."""
    n = len(circles.ranges)
    fits: dict[tuple[int, ...], Fit] = {}
    for out in range(n):
        if fits and out * price > min(f.cost for f in fits.values()) + margin:
            break
        for s in combinations(range(n), n - out):
            some = circles.some(s)
            f, paid = fit(prior, some, some.starts()), out * price
            fits[s] = replace(f, cost=f.cost + paid, elsewhere=f.elsewhere + paid)
    return fits


def outlying(heard: Heard, held: Fit, gate: float) -> Array:
    """Each range's squared misfit (n,) at a fit, over the gate: beyond 1 is an outlier."""
    arms = heard.places - heard.beacon
    arms[:, :2] += held.offset
    distances = np.maximum(np.linalg.norm(arms, axis=1), 1e-3)
    slopes = arms[:, :2] / distances[:, None]
    variances = heard.variances + np.einsum("ni,ij,nj->n", slopes, held.covariance, slopes)
    return np.asarray((heard.ranges - distances) ** 2 / variances / chi_square.bound_of_tail(gate, 1))
