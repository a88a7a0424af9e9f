"""The bank: the null hypothesis and its rivals, carried through composites and fixes, born, scored and pruned.

The null hypothesis matches nothing; it is always there and every birth starts from its state, which holds all found
features.  A hypothesis dropped too soon is therefore born again when the evidence turns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fbn_common.types import Array
from fbn_global.composite_update import Snippet, take_up
from fbn_global.field import Field, Rows, instantiate
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.jcbb import jcbb
from fbn_global.matching import Pairs, Problem
from fbn_global.memory import Memory
from fbn_global.merging import merge_found
from fbn_global.naps import evaluate, positive, surplus_gains
from fbn_global.parameters import GlobalParameters
from fbn_global.reference_update import Fixed
from fbn_global.state import XY, Block, Kind, State, equate, remove


class Bank:
    """All hypotheses; ``null`` first, then the others, best first."""

    def __init__(self, state: State, parameters: GlobalParameters) -> None:
        self.p = parameters
        self.memory = Memory()
        self.null = Hypothesis(0, -1, state, 0.0, score=Score(posterior=1.0))
        self.rivals: list[Hypothesis] = []
        self._next = 1
        m = parameters.matching
        self._noise = np.diag([m.object_sigma**2, m.object_sigma**2, m.object_up_sigma**2])

    @property
    def all(self) -> list[Hypothesis]:
        return [self.null, *self.rivals]

    @property
    def best(self) -> Hypothesis:
        return max(self.all, key=lambda h: h.score.posterior)

    def each(self, step: Callable[[Hypothesis], Hypothesis]) -> None:
        """Replace every hypothesis by what becomes of it."""
        self.null, *self.rivals = [step(h) for h in self.all]

    def take_fix(self, fix: Callable[[State], Fixed]) -> dict[int, Fixed]:
        """Apply a fix to every hypothesis, and give what it did to each.

        It is evidence between them only when the null hypothesis could use it: fixes share their errors.
        """
        hypotheses = self.all
        done = [fix(h.state) for h in hypotheses]
        counts = done[0].used
        moved = [
            h.with_state(f.state, f.log_likelihood if counts else 0.0) for h, f in zip(self.all, done, strict=True)
        ]
        self.null, *self.rivals = moved
        if self.p.method != "JCBB":
            self._rank([replace(h, score=self._with_evidence(h)) for h in self.rivals])
        return {h.id: f for h, f in zip(hypotheses, done, strict=True)}

    def take_composite(self, snippet: Snippet, field: Field | None) -> tuple[float, int]:
        """Carry every hypothesis to the composite's P2, associate, and score; gives the null's NIS and its dof."""
        sigma = self.p.matching.key_sigma
        taken = [take_up(h.state, snippet, h.aliases, sigma) for h in self.all]
        nis, dof = taken[0].nis, taken[0].dof
        self.memory.add(snippet.composite, self._origin(taken[0].state, snippet))
        self.null, *self.rivals = [
            h.with_state(t.state, t.log_likelihood) for h, t in zip(self.all, taken, strict=True)
        ]
        self.each(lambda h: merge_found(h, snippet.keys, self.memory, self._noise, self.p))
        self._forget()
        if field is not None and len(field.features):
            self.associate(field)
        return nis, dof

    def associate(self, field: Field) -> None:
        """Extend the rivals, give birth to new ones, score all and keep the best."""
        if self.p.method == "JCBB":
            self.rivals = self._jointly_compatible(field)
            return
        extended = [self._extend(self._in_reach(h, field), field) for h in self.rivals]
        born = self._births(field, {h.account for h in extended})
        scored = [self._scored(h, field) for h in (*extended, *born)]
        self._rank(self._distinct(scored))

    def _scored(self, h: Hypothesis, field: Field) -> Hypothesis:
        negative = self.p.method == "NAPS"
        return replace(h, score=evaluate(h, self.null, field, self.memory, self.p.scoring, negative))

    def _with_evidence(self, h: Hypothesis) -> Score:
        """The score with the evidence as it stands now, all else as last evaluated."""
        return replace(h.score, positive=positive(h, self.null, self.memory, self.p.scoring))

    def _rank(self, rivals: list[Hypothesis]) -> None:
        """Keep the best; posteriors over the bank, the null at log ratio 0."""
        b = self.p.bank
        order = sorted(rivals, key=lambda h: (-h.score.log_ratio, h.id))[: b.hypotheses]
        ratios = np.array([0.0, *(h.score.log_ratio for h in order)])
        kept = [h for h in order if h.score.log_ratio > ratios.max() - b.keep_log_ratio]
        ratios = ratios[: len(kept) + 1]
        weights = np.exp(ratios - ratios.max())
        posterior = weights / weights.sum()
        self.null = replace(self.null, score=Score(posterior=float(posterior[0])))
        self.rivals = [
            replace(h, score=replace(h.score, posterior=float(w))) for h, w in zip(kept, posterior[1:], strict=True)
        ]

    def _distinct(self, rivals: list[Hypothesis]) -> list[Hypothesis]:
        """One hypothesis for each account, the likeliest: twice the same would count its posterior twice."""
        best: dict[frozenset[tuple[int, int]], Hypothesis] = {}
        for h in sorted(rivals, key=lambda h: (-h.score.log_ratio, h.id)):
            best.setdefault(h.account, h)
        return list(best.values())

    # --- association ---------------------------------------------------------------------------------------

    def _births(self, field: Field, known: set[frozenset[tuple[int, int]]]) -> list[Hypothesis]:
        """New hypotheses from the null's state: a set grown from every anchor that no other set explains yet."""
        keys, rows = self.null.unexplained(), self._candidates(self.null, field)
        if not keys or len(rows) == 0:
            return []
        problem = self._problem(self.null, keys, rows, field)
        named: dict[frozenset[tuple[int, int]], tuple[float, Pairs]] = {}
        explained = {pair for pairs in known for pair in pairs}
        m = self.p.matching
        for anchor in problem.anchors(m.tight_sigma, m.anchors):
            if (keys[anchor[0]], int(rows[anchor[1]])) in explained:
                continue
            grown = problem.grow(anchor)
            pairs = tuple((keys[i], int(rows[j])) for i, j in grown.pairs)
            explained.update(pairs)
            if frozenset(pairs) not in known:
                named.setdefault(frozenset(pairs), (grown.log_ratio, pairs))
        likely = sorted(named.values(), key=lambda item: (-item[0], item[1]))[: self.p.bank.hypotheses]
        best = max([0.0, *(ratio for ratio, _ in likely), *(h.score.log_ratio for h in self.rivals)])
        likely = [item for item in likely if item[0] > best - self.p.bank.keep_log_ratio]
        return [self._in_reach(self._with_pairs(self.null, pairs, field), field) for _, pairs in likely]

    def _extend(self, h: Hypothesis, field: Field) -> Hypothesis:
        """A hypothesis with the pairs that now suggest themselves under it."""
        keys, rows = h.unexplained(), np.array(h.state.ids(Kind.MAP), dtype=np.int64)
        if not keys:
            return h
        problem = self._problem(h, keys, rows, field)
        grown = problem.grow()
        return self._with_pairs(h, tuple((keys[i], int(rows[j])) for i, j in grown.pairs), field)

    def _with_pairs(self, h: Hypothesis, pairs: Pairs, field: Field) -> Hypothesis:
        """The hypothesis with these pairs merged; from the null hypothesis, it is a new one."""
        if not pairs:
            return h
        state = instantiate(h.state, field, np.array(sorted({row for _, row in pairs}), dtype=np.int64))
        evidence = h.evidence
        for key, row in pairs:
            merged = equate(state, Block(Kind.FOUND, key), Block(Kind.MAP, row), self._noise)
            state, evidence = merged.state, evidence + merged.log_likelihood
        identity, parent = (self._new_id(), h.id) if h.is_null else (h.id, h.parent)
        return replace(h, id=identity, parent=parent, state=state, evidence=evidence, pairs=(*h.pairs, *pairs))

    def _new_id(self) -> int:
        self._next += 1
        return self._next - 1

    def _problem(self, h: Hypothesis, keys: tuple[int, ...], rows: Rows, field: Field) -> Problem:
        """Unexplained found features against features of the map under a hypothesis."""
        state = instantiate(h.state, field, rows)
        x, p = state.marginal(*(Block(Kind.FOUND, k) for k in keys), *(Block(Kind.MAP, int(r)) for r in rows))
        allowed = self._allowed(h, keys, rows)
        gains = surplus_gains(h.surplus(), len(keys), self.memory.area, self.p.scoring)
        matched = np.isin(rows, h.rows)
        bonus = np.where(matched, 0.0, np.log(field.existence[rows]))
        gate = self.p.matching.gate_sigma**2
        together = self.memory.together(keys, h.aliases)
        return Problem(x, np.ascontiguousarray(p), len(keys), allowed, together, bonus, gains, self._noise, gate)

    def _allowed(
        self, h: Hypothesis, keys: tuple[int, ...], rows: Rows
    ) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """Whether (keys, rows) a pair contradicts no other: no two objects seen at one time are one."""
        allowed = np.ones((len(keys), len(rows)), dtype=np.bool_)
        index = {int(r): k for k, r in enumerate(rows)}
        seen = [self.memory.seen_in(k, h.aliases) for k in keys]
        for key, row in h.pairs:
            if row in index:
                other = self.memory.seen_in(key, h.aliases)
                allowed[:, index[row]] &= np.array([not (s & other) for s in seen])
        return allowed

    def _candidates(self, h: Hypothesis, field: Field) -> Rows:
        """Map features that may be one of the found ones under the null, by their own uncertainty and the map's."""
        rows: set[int] = set()
        for key in h.unexplained():
            mean, covariance = h.state.marginal(Block(Kind.FOUND, key))
            spread = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1] + float(field.sigma.max()) ** 2)
            rows.update(field.around(mean[None, :2], self.p.matching.gate_sigma * spread).tolist())
        return np.array(sorted(rows), dtype=np.int64)

    def _in_reach(self, h: Hypothesis, field: Field) -> Hypothesis:
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

    def _jointly_compatible(self, field: Field) -> list[Hypothesis]:
        """For comparison: the one set of pairs that joint compatibility takes, as if it were sure."""
        keys, rows = self.null.unexplained(), self._candidates(self.null, field)
        if not keys or len(rows) == 0:
            return []
        problem = self._problem(self.null, keys, rows, field)
        allowed = problem.distances() < problem.gate
        joint = jcbb(problem.x, problem.p, len(keys), allowed, self._noise, 3, self.p.matching.jcbb_nodes)
        pairs = tuple((keys[i], int(rows[j])) for i, j in enumerate(joint.assigned) if j >= 0)
        if not pairs:
            return []
        h = self._scored(self._with_pairs(self.null, pairs, field), field)
        self.null = replace(self.null, score=Score(posterior=0.0))
        return [replace(h, score=replace(h.score, posterior=1.0))]

    # --- forgetting ----------------------------------------------------------------------------------------

    def _forget(self) -> None:
        """Drop the oldest origins, and the found features unseen for longest, beyond what may be kept."""
        origins = set(self.null.state.ids(Kind.ORIGIN)[: -self.p.bank.origins])
        self.memory.forget(origins)
        self.each(lambda h: self._forgotten(h, {Block(Kind.ORIGIN, s) for s in origins}))

    def _forgotten(self, h: Hypothesis, gone: set[Block]) -> Hypothesis:
        found = h.state.ids(Kind.FOUND)
        last = {k: max(self.memory.seen_in(k, h.aliases), default=-1) for k in found}
        keys = set(sorted(found, key=lambda k: (last[k], k))[: max(len(found) - self.p.bank.features, 0)])
        lost = len(keys & set(h.unexplained()))
        state = remove(h.state, gone | {Block(Kind.FOUND, k) for k in keys})
        return replace(h, state=state, dropped=h.dropped + lost)

    def saved(self) -> tuple[Hypothesis, ...]:
        """All hypotheses, as they would be without the tracker's keys."""
        return tuple(_without_keys(h) for h in self.all)

    def restore(self, hypotheses: tuple[Hypothesis, ...]) -> None:
        """Take these for all there are, the null first."""
        self.null = hypotheses[0]
        self._next = 1 + max(h.id for h in hypotheses)
        self._rank(list(hypotheses[1:]))

    def forget_keys(self) -> None:
        """The tracker started anew and will use its keys and sequences again: what hung on the old ones goes."""
        self.memory.forget_all()
        self.each(_without_keys)

    def _origin(self, state: State, snippet: Snippet) -> Array:
        return state.mean[state.span(Block(Kind.ORIGIN, snippet.composite.sequence))]


def _without_keys(h: Hypothesis) -> Hypothesis:
    """A hypothesis without found features and origins; what its pairs taught the map's features stays."""
    gone = {block for block in h.state.starts if block.kind is not Kind.MAP}
    pairs = tuple((-1 - n, row) for n, (_, row) in enumerate(h.pairs))
    return replace(h, state=remove(h.state, gone), pairs=pairs, aliases={}, dropped=h.surplus())
