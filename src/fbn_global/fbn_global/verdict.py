"""The verdict: matched, ambiguous, unmatched or lost, from the posteriors of the places that hypotheses name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fbn_common.records import Localization
from fbn_common.types import Array
from fbn_global.bank import Bank
from fbn_global.field import Field
from fbn_global.hypotheses import Hypothesis
from fbn_global.parameters import VerdictParameters

Association = frozenset[tuple[int, int]]


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """Hypotheses that put the vehicle at one place on the map; the best of them speaks for all."""

    best: Hypothesis
    place: Array  # (2,) m
    posterior: float


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Where the filter stands, and why; ``declared`` is the association of the match, while there is one."""

    state: Localization = Localization.UNMATCHED
    reason: str = "no reference fix yet"
    posterior: float = 0.0
    declared: Association = frozenset()
    candidate: Association = frozenset()
    streak: int = 0
    since_ns: int | None = None  # when the match was declared last

    @property
    def matched(self) -> bool:
        return self.state is Localization.MATCHED


def modes(bank: Bank, field: Field, radius: float) -> list[Mode]:
    """The places where the rivals put the vehicle, the likeliest first."""
    found: list[Mode] = []
    for h in bank.rivals:
        place = h.place_on_map(field)
        near = [k for k, m in enumerate(found) if np.hypot(*(m.place - place)) < radius]
        if near:
            mode = found[near[0]]
            found[near[0]] = replace(mode, posterior=min(mode.posterior + h.score.posterior, 1.0))  # rounding
        else:
            found.append(Mode(h, place, h.score.posterior))
    return sorted(found, key=lambda m: -m.posterior)


def judge(before: Verdict, found: list[Mode], null_posterior: float, stamp_ns: int, p: VerdictParameters) -> Verdict:
    """The verdict after an update, from the one before it and the modes now."""
    top = found[0] if found else None
    if before.matched:
        return _still(before, top, found, p)
    pairs = top.best.account if top else frozenset()
    ready = top is not None and _well_known(top, p) and _sure(top, null_posterior, p)
    streak = (before.streak + 1 if agree(before.candidate, pairs) else 1) if ready else 0
    posterior = top.posterior if top else 0.0
    if top is not None and streak >= p.hold_updates:
        reason = f"{len(top.best.rows)} features of the map, posterior {posterior:.4f}"
        return Verdict(Localization.MATCHED, reason, posterior, pairs, pairs, streak, stamp_ns)
    state, reason = _unmatched(found, null_posterior, p)
    if before.state is Localization.LOST:
        state, reason = Localization.LOST, f"since lost: {reason}"
    return Verdict(state, reason, posterior, frozenset(), pairs, streak, before.since_ns)


def agree(one: Association, other: Association) -> bool:
    """Whether two associations tell one story: they share pairs, and more than they contradict."""
    keys, shared = dict(one), len(one & other)
    against = sum(1 for key, row in other if keys.get(key, row) != row)
    return shared > 0 and shared > against


def _still(before: Verdict, top: Mode | None, found: list[Mode], p: VerdictParameters) -> Verdict:
    """A match once declared, kept or lost."""
    if top is None:
        return _lost(before, 0.0, "no hypothesis is left but the null")
    pairs = top.best.account
    if not agree(before.declared, pairs):
        elsewhere = f"{len(top.best.rows)} features now fit elsewhere, posterior {top.posterior:.3f}"
        return _lost(before, top.posterior, f"contradicted: {elsewhere}")
    if top.posterior < p.keep_posterior:
        return _lost(before, top.posterior, f"posterior fell to {top.posterior:.3f}; {_listed(found, p)}")
    if top.best.sigma_on_map() > p.lost_sigma:
        return _lost(before, top.posterior, f"known on the map to {top.best.sigma_on_map():.1f} m only")
    reason = f"{len(top.best.rows)} features of the map, posterior {top.posterior:.4f}"
    return replace(before, reason=reason, posterior=top.posterior, declared=pairs)


def _lost(before: Verdict, posterior: float, reason: str) -> Verdict:
    return Verdict(Localization.LOST, reason, posterior, since_ns=before.since_ns)


def _well_known(top: Mode, p: VerdictParameters) -> bool:
    return len(top.best.rows) >= p.min_features and top.best.sigma_on_map() < p.lost_sigma


def _sure(top: Mode, null_posterior: float, p: VerdictParameters) -> bool:
    return top.posterior >= p.match_posterior and null_posterior <= p.null_posterior


def _unmatched(found: list[Mode], null_posterior: float, p: VerdictParameters) -> tuple[Localization, str]:
    likely = [m for m in found if m.posterior >= p.ambiguous_posterior]
    if len(likely) > 1:
        return Localization.AMBIGUOUS, _listed(found, p)
    if not found:
        return Localization.UNMATCHED, "nothing found fits the map"
    return Localization.UNMATCHED, f"nothing matched has posterior {null_posterior:.3f}; {_listed(found, p)}"


def _listed(found: list[Mode], p: VerdictParameters) -> str:
    """The modes that count, for people."""
    likely = [m for m in found if m.posterior >= p.ambiguous_posterior] or found[:1]
    parts = [f"({m.place[0]:.0f}, {m.place[1]:.0f}) {m.posterior:.2f}, {len(m.best.rows)} features" for m in likely]
    return "between " + "; ".join(parts) if len(parts) > 1 else "best at " + parts[0]
