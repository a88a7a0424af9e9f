"""Scores a hypothesis against the null: what fits (positive), what was not seen (negative), what was likely (prior).

    log P(H | data) / P(null | data) = sum of log N(innovation) under H less the same under the null      (positive)
        + objects found off the map, fewer of them under H: their density is unknown, Gamma-distributed   (positive)
        + log P(nothing promoted where H says something is)                                               (negative)
        + log existence of the features matched, log odds of the map itself                               (prior)

The first line is the paper's ``- D^2 / 2 - log|S| / 2`` (JOE 2013, eq. 19), accumulated exactly by the bank's own
filters; the second is its free parameter ``lambda`` per match, here ``log((b + A / c) h / (a + s - 1))`` for the s-th
unexplained object in a swept area A: many unexplained objects make a chance match cheap.  Objects lie in fields, on
one bed: by ``c`` they are denser there than over all that was swept, and ``h`` is small, whether on the map or off it.
Else a field would seem to fit the map of any other by chance less often than it does.
"""

from __future__ import annotations

from math import lgamma, log

import numpy as np

from fbn_common.types import Array
from fbn_global.field import Field, Rows
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.memory import Memory
from fbn_global.negative import log_missed, scan_counts
from fbn_global.parameters import ScoringParameters
from fbn_global.state import Block, Kind, State


def surplus_log(count: int, area: float, p: ScoringParameters) -> float:
    """Log density of so many objects off the map in a swept area [m^2], over their unknown density."""
    a, b, held = p.surplus_count, p.surplus_area, area / p.surplus_clustering
    return lgamma(a + count) - lgamma(a) + a * log(b) - (a + count) * log(b + held) - count * log(p.height_span)


def surplus_gains(count: int, pairs: int, area: float, p: ScoringParameters) -> Array:
    """What the first, second ... pair (pairs,) gains by leaving one object fewer off the map, of ``count`` at first."""
    left = np.maximum(count - 1.0 - np.arange(pairs), 0.0)
    held = area / p.surplus_clustering
    return np.asarray(log(p.surplus_area + held) + log(p.height_span) - np.log(p.surplus_count + left))


def evaluate(
    h: Hypothesis, null: Hypothesis, field: Field, memory: Memory, p: ScoringParameters, negative: bool
) -> Score:
    """The parts of a hypothesis's log ratio to the null."""
    prior = float(np.log(field.existence[list(h.rows)]).sum()) + log(p.prior_match / (1.0 - p.prior_match))
    return Score(positive(h, null, memory, p), negative_information(h, field, memory, p) if negative else 0.0, prior)


def positive(h: Hypothesis, null: Hypothesis, memory: Memory, p: ScoringParameters) -> float:
    """What was compared so far, and what stays unexplained, against the same under the null."""
    unexplained = surplus_log(h.surplus(), memory.area, p) - surplus_log(null.surplus(), memory.area, p)
    return h.evidence - null.evidence + unexplained


def negative_information(h: Hypothesis, field: Field, memory: Memory, p: ScoringParameters) -> float:
    """Log chance of all that was not seen under a hypothesis."""
    return float(log_misses(h, field, memory, p).sum())


def existences(h: Hypothesis, field: Field, memory: Memory, p: ScoringParameters) -> dict[int, float]:
    """Chance that each map feature in the state is there, by row, given the remembered sweeps in which it was not seen.

    By Bayes' rule ``p P(missed) / (1 - p + p P(missed))``; 1 once matched.  The null says nothing of the map.
    """
    if h.is_null:
        return {}
    rows, matched = h.state.ids(Kind.MAP), set(h.rows)
    missed_all = np.exp(log_misses(h, field, memory, p))  # 1 - p + p P(missed)
    given = 1.0 - (1.0 - field.existence[list(rows)]) / missed_all
    return {row: 1.0 if row in matched else float(g) for row, g in zip(rows, given, strict=True)}


def log_misses(h: Hypothesis, field: Field, memory: Memory, p: ScoringParameters) -> Array:
    """Log chance (rows,) of what was not seen of each map feature in the state."""
    rows = np.array(h.state.ids(Kind.MAP), dtype=np.int64)
    sequences = [s for s in memory.sequences() if Block(Kind.ORIGIN, s) in h.state]
    if len(rows) == 0 or not sequences:
        return np.zeros(len(rows))
    relative, covariance = relative_places(h.state, rows, sequences)
    counts = scan_counts(relative, covariance, memory.sweeps(tuple(sequences)))
    detected = detections(h, rows, sequences, memory)
    existence = np.where(detected.any(axis=1) | np.isin(rows, h.rows), 1.0, field.existence[rows])
    visible = visibility(h, rows, field, memory, p)
    return log_missed(counts, detected, visible, existence, p.promotion_detections, p.missed_floor)


def relative_places(state: State, rows: Rows, sequences: list[int]) -> tuple[Array, Array]:
    """Place (rows, sequences, 2) of map features relative to the origins of composites, and covariance (.., 2, 2)."""
    m = np.array([state.starts[Block(Kind.MAP, int(r))] for r in rows])[:, None] + np.arange(2)
    o = np.array([state.starts[Block(Kind.ORIGIN, s)] for s in sequences])[:, None] + np.arange(2)
    relative = state.mean[m][:, None, :] - state.mean[o][None, :, :]
    own_m = state.covariance[m[:, :, None], m[:, None, :]][:, None]
    own_o = state.covariance[o[:, :, None], o[:, None, :]][None]
    cross = state.covariance[m[:, None, :, None], o[None, :, None, :]]
    return relative, own_m + own_o - cross - np.swapaxes(cross, -1, -2)


def detections(
    h: Hypothesis, rows: Rows, sequences: list[int], memory: Memory
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Whether (rows, sequences) a feature matched to this one of the map was seen in this composite."""
    index = {int(r): k for k, r in enumerate(rows)}
    out = np.zeros((len(rows), len(sequences)), dtype=np.bool_)
    for key, row in h.pairs:
        seen = memory.seen_in(key, h.aliases)
        if row in index:
            out[index[row]] |= np.array([s in seen for s in sequences])
    return out


def visibility(h: Hypothesis, rows: Rows, field: Field, memory: Memory, p: ScoringParameters) -> Array:
    """Detections per scan (rows,): each feature's own counts, upon those of all matched ones, upon the map's word."""
    weight = p.visibility_weight
    hits, scans = np.zeros(len(rows)), np.zeros(len(rows))
    index = {int(r): k for k, r in enumerate(rows)}
    for key, row in h.pairs:
        if row in index:
            detected, expected = memory.detected(key, h.aliases)
            hits[index[row]] += min(detected, expected)
            scans[index[row]] += expected
    common = (weight + hits.sum()) / (
        weight + (scans * field.visibility[rows]).sum()
    )  # of this day's sonar to the map's word
    prior = np.clip(common * field.visibility[rows], 0.02, 0.98)
    return np.asarray(np.clip((weight * prior + hits) / (weight + scans), 0.02, 0.98))
