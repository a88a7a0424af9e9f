"""Were the matches right: pairs of the best hypothesis against the true identity of what was tracked.

A tracked feature is carried onto truth by the pose relative to the vehicle when it was last seen: its position
from the vehicle as dead-reckoned, put on the vehicle's true pose.  So neither drift nor the map's displacement
enters.  The true feature within reach is its identity; with none within reach it is clutter.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbn_bringup.evaluation.dives import Dive
from fbn_bringup.evaluation.series import Track
from fbn_bringup.evaluation.truth import Truth
from fbn_common.records import (
    CompositeMeasurement,
    FeatureMap,
    LocalizationStatus,
    MatchHypotheses,
    MatchHypothesis,
    Stage,
    TrackedFeatures,
)
from fbn_common.types import Vec3

ANSWER = (
    500_000_000  # ns after the bank's answer in which its verdict is published: the same step of a replay, or timer
)
REACH = 4.0  # m, horizontally: a fifth of the spacing of the fields, several times a track's own error


def identities(tracked: Sequence[TrackedFeatures], deadreck: Track, true: Track, truth: Truth) -> dict[int, int | None]:
    """The true feature's id of each tracker's key that became a feature; None for clutter."""
    seen: dict[int, tuple[int, Vec3]] = {}  # key -> (last seen, position in odom then)
    for message in tracked:
        for f in message.features:
            if f.stage != Stage.INFANT:
                seen[f.key] = (f.last_seen_ns, f.position)
    found: dict[int, int | None] = {}
    for key, (stamp, position) in seen.items():
        place = _on_truth(position, stamp, deadreck, true)
        found[key] = None if place is None else _nearest(place, truth)
    return found


def _on_truth(position: Vec3, stamp_ns: int, deadreck: Track, true: Track) -> Vec3 | None:
    """A point of odom (3,) in the true map, through the vehicle at a stamp; None outside the tracks."""
    for t in (deadreck, true):
        if not len(t) or not t.stamp_ns[0] <= stamp_ns <= t.stamp_ns[-1]:
            return None
    stamp = np.array([stamp_ns])
    odom, world = deadreck.at(stamp), true.at(stamp)
    from_base = odom.rotation.inv().apply(position - odom.position)
    return np.asarray((world.rotation.apply(from_base) + world.position)[0])


def _nearest(place: Vec3, truth: Truth) -> int | None:
    if not truth.features:
        return None
    distances = [float(np.linalg.norm((f.position - place)[:2])) for f in truth.features]
    best = int(np.argmin(distances))
    return truth.features[best].id if distances[best] <= REACH else None


@dataclass(frozen=True, slots=True)
class Matches:
    """What was matched within one dive, at its end.

    ``declared``: the status that answered the last composite of this dive said matched, on at least one feature
    tracked in it; a match only held over from the dive before does not count.  ``right`` and ``wrong`` count that
    hypothesis's pairs of this dive; without truth both are 0.
    """

    declared: bool
    after_s: float | None  # s from the dive's start to the first declaration in it
    pairs: int
    right: int
    wrong: int
    posterior: float

    @property
    def false(self) -> bool:
        """Declared, and as many pairs wrong as right."""
        return self.declared and self.wrong > 0 and self.wrong >= self.right


def matches(
    dive: Dive,
    statuses: Sequence[LocalizationStatus],
    hypotheses: Sequence[MatchHypotheses],
    composites: Sequence[CompositeMeasurement],
    truth_of_pair: dict[int, int | None],
    truth: Truth | None,
    answered_ns: Mapping[int, int],
    grace_ns: int = 30_000_000_000,
) -> Matches:
    """The matches of one dive; its last composite may be answered up to ``grace_ns`` after its end.

    ``answered_ns``: by a composite's stamp, when its answer was published, which is seconds after that stamp.
    """
    keys = _tracked_in(dive, composites)
    end = dive.end_ns + grace_ns
    during = [h for h in hypotheses if dive.start_ns <= h.stamp_ns <= end and h.hypotheses]
    bests = [(answered_ns.get(h.stamp_ns, h.stamp_ns), h.hypotheses[0]) for h in during]
    first = next((t for t, h in bests if keys & set(h.feature_keys) and _declared(statuses, t)), None)
    if not bests:
        return Matches(False, None, 0, 0, 0, 0.0)
    stamp, best = bests[-1]
    pairs = _pairs(best, keys)
    right, wrong = judge(pairs, truth_of_pair, truth)
    declared = bool(pairs) and _declared(statuses, stamp)
    after = (first - dive.start_ns) / 1e9 if first is not None else None
    return Matches(declared, after, len(pairs), right, wrong, best.posterior)


@dataclass(frozen=True, slots=True)
class Statement:
    """A posterior that the filter stated of its best place after a composite, and whether that place was right."""

    posterior: float
    right: bool


def statements(
    dive: Dive,
    statuses: Sequence[LocalizationStatus],
    hypotheses: Sequence[MatchHypotheses],
    composites: Sequence[CompositeMeasurement],
    truth_of_key: dict[int, int | None],
    truth: Truth | None,
    answered_ns: Mapping[int, int],
) -> tuple[Statement, ...]:
    """One for each answer in a dive whose best account pairs features tracked in it: right if most of those pairs are.

    The posterior is the next status's: of the best place, over all accounts that put the vehicle there.
    """
    keys = _tracked_in(dive, composites)
    stamps = [s.stamp_ns for s in statuses]
    found = []
    for answer in hypotheses:
        best = next((h for h in answer.hypotheses if h.map_ids), None)
        at = bisect_left(stamps, answered_ns.get(answer.stamp_ns, answer.stamp_ns))
        if best is None or not dive.contains(answer.stamp_ns) or at == len(statuses):
            continue
        right, wrong = judge(_pairs(best, keys), truth_of_key, truth)
        if right + wrong:
            found.append(Statement(statuses[at].posterior, right > wrong))
    return tuple(found)


def _tracked_in(dive: Dive, composites: Sequence[CompositeMeasurement]) -> set[int]:
    """Keys of the features tracked in a dive."""
    return {f.key for c in composites if dive.contains(c.start_ns) for f in c.features}


def _pairs(h: MatchHypothesis, keys: set[int]) -> list[tuple[int, int]]:
    """A hypothesis's pairs (map id, key) of features with these keys."""
    return [(m, k) for m, k in zip(h.map_ids, h.feature_keys, strict=True) if k in keys]


def _declared(statuses: Sequence[LocalizationStatus], answered_ns: int) -> bool:
    """Was the filter matched after the update that it answered then?  A change of verdict is told with the answer."""
    known = [s for s in statuses if s.stamp_ns <= answered_ns + ANSWER]
    return known[-1].matched if known else False


def judge(
    pairs: Sequence[tuple[int, int]], truth_of_key: dict[int, int | None], truth: Truth | None
) -> tuple[int, int]:
    """How many pairs (map id, tracker's key) are right and wrong; a key of unknown identity counts for neither."""
    if truth is None:
        return 0, 0
    true_of_map = {map_id: f.id for map_id, f in truth.on_map().items()}
    known = [(true_of_map.get(m), truth_of_key[k]) for m, k in pairs if k in truth_of_key]
    right = sum(a is not None and a == b for a, b in known)
    return right, len(known) - right


def map_errors(feature_map: FeatureMap, truth: Truth) -> dict[int, Vec3]:
    """Estimated less true position (3,) [m] of every map feature with a known identity."""
    true = truth.on_map()
    return {f.id: f.position - true[f.id].position for f in feature_map.features if f.id in true}
