"""Single pairs of found features well correlated to one another: the same object, seen again under a new key."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fbn_common.types import Mat3
from fbn_global.hypotheses import Hypothesis
from fbn_global.jcbb import chi_square_99
from fbn_global.memory import Memory
from fbn_global.naps import surplus_gains
from fbn_global.parameters import GlobalParameters
from fbn_global.state import Block, Kind, equate, likelihood, remove


def merge_found(h: Hypothesis, keys: tuple[int, ...], memory: Memory, noise: Mat3, p: GlobalParameters) -> Hypothesis:
    """The hypothesis with each new feature merged into an older one that it can hardly fail to be.

    They must never have been seen together, be well known relative to each other, fit within 99 %, be more likely
    one than two, and there must be only one such older feature.
    """
    for key in keys:
        if Block(Kind.FOUND, key) not in h.state or key in h.matched_keys:
            continue
        older = [k for k in h.state.ids(Kind.FOUND) if k != key and _same(h, key, k, memory, noise, p)]
        if len(older) == 1:
            h = _merged(h, key, older[0], noise)
    return h


def _same(h: Hypothesis, key: int, other: int, memory: Memory, noise: Mat3, p: GlobalParameters) -> bool:
    seen, before = memory.seen_in(key, h.aliases), memory.seen_in(other, h.aliases)
    if seen & before or min(seen, default=-1) < max(before, default=0):
        return False
    one, two = Block(Kind.FOUND, key), Block(Kind.FOUND, other)
    jacobian = np.hstack([np.eye(3), -np.eye(3)])
    columns = h.state.columns(one, two)
    spread = jacobian @ h.state.covariance[np.ix_(columns, columns)] @ jacobian.T
    if np.sqrt(max(spread[0, 0], spread[1, 1])) > p.matching.single_sigma:
        return False
    difference = h.state.mean[h.state.span(two)] - h.state.mean[h.state.span(one)]
    log_likelihood, nis = likelihood(h.state, columns, jacobian, difference, noise)
    gain = surplus_gains(h.surplus(), 1, memory.area, p.scoring)[0]
    return nis < chi_square_99(3) and bool(log_likelihood + gain > 0.0)


def _merged(h: Hypothesis, key: int, older: int, noise: Mat3) -> Hypothesis:
    merged = equate(h.state, Block(Kind.FOUND, key), Block(Kind.FOUND, older), noise)
    aliases = {k: older if v == key else v for k, v in h.aliases.items()} | {key: older}
    state = remove(merged.state, {Block(Kind.FOUND, key)})
    return replace(h, state=state, evidence=h.evidence + merged.log_likelihood, aliases=aliases)
