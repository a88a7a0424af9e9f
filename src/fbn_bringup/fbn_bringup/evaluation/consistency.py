"""Is an estimator as good as it says: NEES against truth, NIS against itself, with chi-square bands.

``ratio`` is the mean of the normalised square over its degrees of freedom: 1 when the covariance is right, more
when the filter is over-confident.  ``inside`` is the share of samples under their own 95 % bound: 0.95 when right.
The band of the mean holds for independent samples, which innovations of a consistent filter are; errors of one
run are correlated over minutes, so for NEES the band needs many runs (``fbn campaign``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.series import Innovations, Stamps
from fbn_common import chi_square
from fbn_common.records import Verdict
from fbn_common.types import Array


@dataclass(frozen=True, slots=True)
class Consistency:
    """Statistics of a normalised square."""

    name: str
    samples: int
    dof: float  # mean degrees of freedom of a sample
    ratio: float  # mean / dof
    low: float  # 95 % band of the ratio for independent samples
    high: float
    inside: float  # share under the 95 % bound

    @property
    def consistent(self) -> bool:
        """Is the ratio inside its band?"""
        return self.low <= self.ratio <= self.high


def consistency(name: str, squares: Array, dof: int | Array | Stamps) -> Consistency | None:
    """Statistics of normalised squares (n,) with their degrees of freedom; None without finite samples."""
    degrees = np.broadcast_to(np.asarray(dof, dtype=float), squares.shape)
    good = np.isfinite(squares) & (degrees > 0)
    squares, degrees = squares[good], degrees[good]
    if not len(squares):
        return None
    total = float(degrees.sum())
    low, high = chi_square.band(total)
    inside = float(np.mean(squares <= chi_square.bound(0.95, degrees)))
    return Consistency(name, len(squares), total / len(squares), float(squares.sum()) / total, low, high, inside)


def nees(errors: Array, covariances: Array) -> Array:
    """``e^T P^-1 e`` (n,) of errors (n, d) and covariances (n, d, d); NaN where P is not positive definite."""
    squares = np.full(len(errors), np.nan)
    for i, (e, p) in enumerate(zip(errors, covariances, strict=True)):
        try:
            factor = np.linalg.cholesky(p)
        except np.linalg.LinAlgError:
            continue
        whitened = np.linalg.solve(factor, e)
        squares[i] = whitened @ whitened
    return squares


@dataclass(frozen=True, slots=True)
class SensorReport:
    """One sensor in one estimator: verdicts, reasons of refusal, and NIS of what was not malformed."""

    node: str
    sensor: str
    verdicts: dict[str, int]
    reasons: dict[str, int]
    nis: Consistency | None  # of the used ones

    @property
    def total(self) -> int:
        """All measurements answered."""
        return sum(self.verdicts.values())


def sensor_report(table: Innovations) -> SensorReport:
    """Verdicts, reasons and NIS of one sensor."""
    verdicts = {v.name: int(table.has(v).sum()) for v in Verdict}
    pairs = zip(table.reason, table.verdict, strict=True)
    reasons = Counter(reason or "-" for reason, verdict in pairs if verdict != Verdict.USED)
    used = table.has(Verdict.USED)
    name = f"{table.node}/{table.sensor}"
    return SensorReport(
        table.node, table.sensor, verdicts, dict(reasons.most_common()),
        consistency(name, table.nis[used], table.dof[used]),
    )  # fmt: skip


def worst_first(reports: Iterable[Consistency | None]) -> list[Consistency]:
    """Those that exist, the most over-confident first."""
    return sorted((r for r in reports if r), key=lambda r: -r.ratio)
