"""One hypothesis: an association of found features with the map's, its own state, and the evidence for it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fbn_common.types import Array
from fbn_global.field import Field
from fbn_global.state import XY, Block, Kind, State


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Log score relative to the null hypothesis, by its parts; the posterior is over the bank."""

    positive: float = 0.0
    negative: float = 0.0
    prior: float = 0.0
    posterior: float = 0.0

    @property
    def log_ratio(self) -> float:
        return self.positive + self.negative + self.prior


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """An account of the mission: pairs (key, row of the map) in the order made, and the state they imply.

    ``evidence`` is the log likelihood of all that was compared so far: composites, fixes, keys and pairs;
    ``merged`` counts found features recognised as another found one, ``dropped`` those forgotten, unexplained.
    """

    id: int
    parent: int
    state: State
    evidence: float
    pairs: tuple[tuple[int, int], ...] = ()
    aliases: dict[int, int] = field(default_factory=dict)  # key -> key of the same object found before
    dropped: int = 0  # found features forgotten that no feature of the map explains
    score: Score = Score()

    @property
    def is_null(self) -> bool:
        return not self.pairs

    @property
    def rows(self) -> tuple[int, ...]:
        """Map features matched, each once."""
        return tuple(dict.fromkeys(row for _, row in self.pairs))

    @property
    def account(self) -> frozenset[tuple[int, int]]:
        """All that it says, as (key, row): its pairs, and found features recognised as one of a pair.

        Two hypotheses that say the same came by it in another order; they are one.
        """
        rows = dict(self.pairs)
        seen_again = {(key, rows[older]) for key, older in self.aliases.items() if older in rows}
        return frozenset(self.pairs) | seen_again

    @property
    def matched_keys(self) -> set[int]:
        return {key for key, _ in self.pairs}

    def unexplained(self) -> tuple[int, ...]:
        """Keys of found features in the state that are on no map feature."""
        matched = self.matched_keys
        return tuple(key for key in self.state.ids(Kind.FOUND) if key not in matched)

    def surplus(self) -> int:
        """Objects found that are not on the map."""
        return len(self.unexplained()) + self.dropped

    def with_state(self, state: State, log_likelihood: float = 0.0) -> Hypothesis:
        return replace(self, state=state, evidence=self.evidence + log_likelihood)

    def map_shift(self, field: Field, xy: Array) -> Array:
        """How far (2,) matched features have moved from where the file has them; those near a place count most."""
        rows = np.array(self.rows, dtype=np.int64)
        if len(rows) == 0:
            return np.zeros(2)
        now = np.array([self.state.mean[self.state.span(Block(Kind.MAP, int(r)))][:2] for r in rows])
        weight = 1.0 / (1.0 + np.sqrt(((now - xy) ** 2).sum(axis=1)))
        return np.asarray(weight @ (now - field.position[rows, :2]) / weight.sum())

    def place_on_map(self, field: Field) -> Array:
        """xy (2,) of the vehicle among the features as the map's file has them."""
        xy = self.state.mean[XY]
        return np.asarray(xy - self.map_shift(field, xy))

    def sigma_on_map(self) -> float:
        """Standard deviation [m], worse axis, of the vehicle relative to the nearest matched feature."""
        if not self.pairs:
            return float("inf")
        s, best = self.state, float("inf")
        for row in self.rows:
            at = s.starts[Block(Kind.MAP, row)]
            both = np.ix_([0, 1, at, at + 1], [0, 1, at, at + 1])
            h = np.hstack([np.eye(2), -np.eye(2)])
            best = min(best, float(np.sqrt(np.linalg.eigvalsh(h @ s.covariance[both] @ h.T)[-1])))
        return best
