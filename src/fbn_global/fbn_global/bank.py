"""The bank: the null hypothesis and its rivals, carried through composites and fixes, born, scored and pruned.

The null hypothesis matches nothing; it is always there and every birth starts from its state, which holds all found
features.  A hypothesis dropped too soon is therefore born again when the evidence turns.  One that has lost its place,
by a restart or a long way without features, has children as well: one for each way in which it may go on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fbn_common.types import Array
from fbn_global.association import Associator
from fbn_global.composite_update import Snippet, take_up
from fbn_global.field import Field
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.matching import Pairs
from fbn_global.memory import Memory
from fbn_global.merging import merge_found
from fbn_global.naps import evaluate, positive
from fbn_global.parameters import GlobalParameters
from fbn_global.reference_update import Fixed
from fbn_global.state import Block, Kind, State, remove

_LIKELY = 0.01  # posterior of a hypothesis worth the time to look for children


class Bank:
    """All hypotheses; ``null`` first, then the others, best first."""

    def __init__(self, state: State, parameters: GlobalParameters) -> None:
        self.p = parameters
        self.memory = Memory()
        self.null = Hypothesis(0, -1, state, 0.0, score=Score(posterior=1.0))
        self.rivals: list[Hypothesis] = []
        self._next = 1
        self._associator = Associator(parameters, self.memory)

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
        self.each(lambda h: merge_found(h, snippet.keys, self.memory, self._associator.noise, self.p))
        self._forget()
        if field is not None and len(field.features):
            self.associate(field)
        return nis, dof

    def associate(self, field: Field) -> None:
        """Extend the rivals, give birth to new ones, score all and keep the best."""
        if self.p.method == "JCBB":
            self.rivals = self._jointly_compatible(field)
            return
        associator = self._associator
        reached = [associator.in_reach(h, field) for h in self.rivals]
        adrift = [h for h in reached if self._adrift(h)]
        living = [h if h in adrift else associator.extended(h, field) for h in reached]
        born = [child for parent in (self.null, *adrift) for child in self._births(parent, field, living)]
        self._rank(_distinct([self._scored(h, field) for h in (*living, *born)]))

    def _adrift(self, h: Hypothesis) -> bool:
        """Whether a likely hypothesis has lost its place, by a restart or a long way: it may go on in several ways."""
        return h.score.posterior > _LIKELY and h.sigma_on_map() > self.p.verdict.lost_sigma

    def _births(self, parent: Hypothesis, field: Field, living: list[Hypothesis]) -> list[Hypothesis]:
        """New hypotheses from a parent's state: likely sets of pairs that no living one of its kind explains yet."""
        associator, b, own = self._associator, self.p.bank, parent.account
        known = {h.account - own for h in living if own <= h.account}
        sets = associator.sets(parent, field, known)[: b.hypotheses]
        so_far = parent.score.log_ratio
        best = max([0.0, *(so_far + s.log_ratio for s in sets), *(h.score.log_ratio for h in self.rivals)])
        likely = [s for s in sets if so_far + s.log_ratio > best - b.keep_log_ratio]
        return [associator.in_reach(self._born(parent, s.pairs, field), field) for s in likely]

    def _born(self, parent: Hypothesis, pairs: Pairs, field: Field) -> Hypothesis:
        """A new hypothesis: the parent's state with these pairs (key, row) merged."""
        h = self._associator.paired(parent, pairs, field)
        self._next += 1
        return replace(h, id=self._next - 1, parent=parent.id)

    def _jointly_compatible(self, field: Field) -> list[Hypothesis]:
        """For comparison: the one set of pairs that joint compatibility takes, as if it were sure."""
        pairs = self._associator.jointly_compatible(self.null, field)
        if not pairs:
            return []
        h = self._scored(self._born(self.null, pairs, field), field)
        self.null = replace(self.null, score=Score(posterior=0.0))
        return [replace(h, score=replace(h.score, posterior=1.0))]

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

    def restore(self, hypotheses: tuple[Hypothesis, ...], area: float) -> None:
        """Take these for all there are, the null first, found over so large an area [m^2]; all since is forgotten."""
        self.memory.forget_all()
        self.memory.swept_before += area
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


def _distinct(rivals: list[Hypothesis]) -> list[Hypothesis]:
    """One hypothesis for each account, the likeliest: twice the same would count its posterior twice."""
    best: dict[frozenset[tuple[int, int]], Hypothesis] = {}
    for h in sorted(rivals, key=lambda h: (-h.score.log_ratio, h.id)):
        best.setdefault(h.account, h)
    return list(best.values())
