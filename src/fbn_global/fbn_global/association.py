"""Which pairs a hypothesis may make, and what becomes of it when it makes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fbn_global.field import Field, Rows, instantiate
from fbn_global.hypotheses import Hypothesis
from fbn_global.jcbb import jcbb
from fbn_global.matching import Grown, Pairs, Problem
from fbn_global.memory import Memory
from fbn_global.naps import surplus_gains
from fbn_global.parameters import GlobalParameters
from fbn_global.state import XY, Block, Kind, equate


class Associator:
    """Pairs of found features (by key) and features of the map (by row), given what is remembered."""

    def __init__(self, parameters: GlobalParameters, memory: Memory) -> None:
        self.p, self.memory = parameters, memory
        m = parameters.matching
        self.noise = np.diag([m.object_sigma**2, m.object_sigma**2, m.object_up_sigma**2])

    def sets(self, h: Hypothesis, field: Field, known: set[frozenset[tuple[int, int]]]) -> list[Grown]:
        """Sets of pairs (key, row), likeliest first: one grown from every anchor that no other set explains yet."""
        keys, rows = h.unexplained(), self.candidates(h, field)
        if not keys or len(rows) == 0:
            return []
        problem = self.problem(h, keys, rows, field)
        found: dict[frozenset[tuple[int, int]], Grown] = {}
        explained = {pair for pairs in known for pair in pairs}
        m = self.p.matching
        for anchor in problem.anchors(m.tight_sigma, m.anchors):
            if (keys[anchor[0]], int(rows[anchor[1]])) in explained:
                continue
            grown = problem.grow(anchor)
            pairs = tuple((keys[i], int(rows[j])) for i, j in grown.pairs)
            explained.update(pairs)
            if frozenset(pairs) not in known:
                found.setdefault(frozenset(pairs), Grown(pairs, grown.log_ratio))
        return sorted(found.values(), key=lambda g: (-g.log_ratio, g.pairs))

    def extended(self, h: Hypothesis, field: Field) -> Hypothesis:
        """A hypothesis with the pairs that now suggest themselves under it."""
        keys, rows = h.unexplained(), np.array(h.state.ids(Kind.MAP), dtype=np.int64)
        if not keys:
            return h
        grown = self.problem(h, keys, rows, field).grow()
        return self.paired(h, tuple((keys[i], int(rows[j])) for i, j in grown.pairs), field)

    def paired(self, h: Hypothesis, pairs: Pairs, field: Field) -> Hypothesis:
        """The hypothesis with these pairs (key, row) merged."""
        if not pairs:
            return h
        state = instantiate(h.state, field, np.array(sorted({row for _, row in pairs}), dtype=np.int64))
        evidence = h.evidence
        for key, row in pairs:
            merged = equate(state, Block(Kind.FOUND, key), Block(Kind.MAP, row), self.noise)
            state, evidence = merged.state, evidence + merged.log_likelihood
        return replace(h, state=state, evidence=evidence, pairs=(*h.pairs, *pairs))

    def jointly_compatible(self, null: Hypothesis, field: Field) -> Pairs:
        """The one set of pairs (key, row) that joint compatibility takes."""
        keys, rows = null.unexplained(), self.candidates(null, field)
        if not keys or len(rows) == 0:
            return ()
        problem = self.problem(null, keys, rows, field)
        allowed = problem.distances() < problem.gate
        joint = jcbb(problem.x, problem.p, len(keys), allowed, self.noise, 3, self.p.matching.jcbb_nodes)
        return tuple((keys[i], int(rows[j])) for i, j in enumerate(joint.assigned) if j >= 0)

    def problem(self, h: Hypothesis, keys: tuple[int, ...], rows: Rows, field: Field) -> Problem:
        """Unexplained found features against features of the map under a hypothesis."""
        state = instantiate(h.state, field, rows)
        x, p = state.marginal(*(Block(Kind.FOUND, k) for k in keys), *(Block(Kind.MAP, int(r)) for r in rows))
        allowed = self._allowed(h, keys, rows)
        gains = surplus_gains(h.surplus(), len(keys), self.memory.area, self.p.scoring)
        bonus = np.where(np.isin(rows, h.rows), 0.0, np.log(field.existence[rows]))
        gate = self.p.matching.gate_sigma**2
        together = self.memory.together(keys, h.aliases)
        return Problem(x, np.ascontiguousarray(p), len(keys), allowed, together, bonus, gains, self.noise, gate)

    def _allowed(self, h: Hypothesis, keys: tuple[int, ...], rows: Rows) -> npt.NDArray[np.bool_]:
        """Whether (keys, rows) a pair contradicts no other: no two objects seen at one time are one."""
        allowed = np.ones((len(keys), len(rows)), dtype=np.bool_)
        index = {int(r): k for k, r in enumerate(rows)}
        seen = [self.memory.seen_in(k, h.aliases) for k in keys]
        for key, row in h.pairs:
            if row in index:
                other = self.memory.seen_in(key, h.aliases)
                allowed[:, index[row]] &= np.array([not (s & other) for s in seen])
        return allowed

    def candidates(self, h: Hypothesis, field: Field) -> Rows:
        """Map features that may be one of the found ones, by their own uncertainty and the map's."""
        rows: set[int] = set()
        for key in h.unexplained():
            mean, covariance = h.state.marginal(Block(Kind.FOUND, key))
            spread = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1] + float(field.sigma.max()) ** 2)
            rows.update(field.around(mean[None, :2], self.p.matching.gate_sigma * spread).tolist())
        return np.array(sorted(rows), dtype=np.int64)

    def in_reach(self, h: Hypothesis, field: Field) -> Hypothesis:
        """The hypothesis with all map features in its state that its remembered sweeps may have covered."""
        shift = h.map_shift(field, h.state.mean[XY])
        rows: set[int] = set()
        for sequence in self.memory.sequences():
            if Block(Kind.ORIGIN, sequence) in h.state:
                area = self.memory.area_of(sequence)
                low = h.state.mean[h.state.span(Block(Kind.ORIGIN, sequence))] + area.origin - shift
                high = low + area.cell_size * np.array([area.width, area.height])
                rows.update(field.inside(low - self.p.bank.reach, high + self.p.bank.reach).tolist())
        return replace(h, state=instantiate(h.state, field, np.array(sorted(rows), dtype=np.int64)))
