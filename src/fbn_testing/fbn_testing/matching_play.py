"""One drawn run through the global filter, judged by the true identities of what was found."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from fbn_common.records import Localization, LocalizationStatus, MatchHypotheses
from fbn_global.estimator import Global
from fbn_global.parameters import GlobalParameters
from fbn_testing.composite_world import Run


@dataclass
class Outcome:
    """One run: the verdict at its end, whether ever declared wrong, and every posterior with its truth."""

    verdict: Localization = Localization.UNMATCHED
    right: bool = False
    wrong_ever: bool = False
    matched_ever: bool = False
    favours_truth: bool = False  # the place likeliest at the end is the right one, declared or not
    calibration: list[tuple[float, bool]] = field(default_factory=list)  # of each place named, after each composite
    seconds: list[float] = field(default_factory=list)  # thread time of each composite


def play(run: Run, parameters: GlobalParameters) -> Outcome:
    """Feed a run to the filter and judge each verdict by the true identities."""
    estimator, outcome = Global(parameters, run.prior), Outcome()
    ids = [f.id for f in run.prior.features]
    hypotheses: MatchHypotheses | None = None
    for topic, record in run.entries:
        estimator.put(topic, record)
        began = time.thread_time()
        outputs = estimator.advance(record.stamp_ns)
        if topic == "tracking/composite":
            outcome.seconds.append(time.thread_time() - began)
            named = [[(ids[row], key) for key, row in mode.best.pairs] for mode in estimator.modes]
            judged = [mostly_true(pairs, run) for pairs in named]
            outcome.calibration += zip((mode.posterior for mode in estimator.modes), judged, strict=True)
            outcome.favours_truth = judged[:1] == [True]
        for output in outputs:
            if isinstance(output.record, MatchHypotheses):
                hypotheses = output.record
            if isinstance(output.record, LocalizationStatus) and hypotheses is not None:
                _judge(outcome, output.record, hypotheses, run)
    return outcome


def mostly_true(pairs: list[tuple[int, int]], run: Run) -> bool:
    """Whether most of these pairs (map id, key) are true."""
    true = sum(run.key_feature.get(key) == map_id for map_id, key in pairs)
    return true > len(pairs) / 2


def is_right(hypotheses: MatchHypotheses, index: int, run: Run) -> bool:
    """Whether most pairs of a hypothesis are true."""
    h = hypotheses.hypotheses[index]
    return mostly_true(list(zip(h.map_ids, h.feature_keys, strict=True)), run)


def _judge(outcome: Outcome, s: LocalizationStatus, hypotheses: MatchHypotheses, run: Run) -> None:
    outcome.verdict, outcome.right = s.state, False
    if s.matched:
        best = next(k for k, h in enumerate(hypotheses.hypotheses) if h.map_ids)
        outcome.right = is_right(hypotheses, best, run)
        outcome.matched_ever = True
        outcome.wrong_ever |= not outcome.right
