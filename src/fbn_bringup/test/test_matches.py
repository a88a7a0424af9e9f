"""Matches judged by the true identity of what was tracked."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fbn_bringup.evaluation.evaluate import evaluate
from fbn_bringup.evaluation.matches import identities, judge
from fbn_bringup.evaluation.run import collect
from fbn_common.records import TrackedFeatures
from fbn_common.types import NS


def test_every_dive_of_a_right_run_is_matched_and_right(story, tell, truth_of):
    s = story()
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    assert (result.matched, result.false_matches) == (3, 0)
    assert all(d.matches.right == d.matches.pairs == 4 and d.matches.wrong == 0 for d in result.dives)
    assert result.dives[1].matches.after_s == pytest.approx(50.0, abs=0.41)


def test_a_match_shifted_along_the_row_is_false(story, tell, truth_of):
    s = story(wrong_pairs=4)
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    assert (result.matched, result.false_matches) == (0, 3)


def test_one_wrong_pair_among_four_is_counted_but_does_not_make_the_match_false(story, tell, truth_of):
    s = story(wrong_pairs=1)
    result = evaluate(collect(tell(s), truth=truth_of(s)))
    assert result.matched == 3 and [d.matches.wrong for d in result.dives] == [1, 1, 1]


def test_a_match_declared_by_a_dives_last_composite_counts_though_its_answer_comes_seconds_after_it(
    story, tell, truth_of
):
    late = ("global/hypotheses", "global/status")  # of the first dive one answer, logged 4 s after what it answers
    items, answers = [], [item for item in tell(story()) if item[1] in late]
    first_dive_end = answers[0][2].stamp_ns + 60 * NS
    last = max(item[2].stamp_ns for item in answers if item[2].stamp_ns < first_dive_end)
    for log_ns, topic, record in tell(story()):
        if topic in late and record.stamp_ns < first_dive_end:
            if record.stamp_ns < last:
                continue
            log_ns += 4 * NS
            record = replace(record, stamp_ns=log_ns) if topic == "global/status" else record
        items.append((log_ns, topic, record))
    result = evaluate(collect(sorted(items, key=lambda item: item[0]), truth=truth_of(story())))
    assert result.dives[0].matches.declared and result.matched == 3
    after_composite = (last - (result.dives[0].start_s * NS + items[0][0])) / NS
    assert result.dives[0].matches.after_s == pytest.approx(after_composite + 4.0, abs=0.41)  # two samples of truth


@pytest.mark.parametrize(("wrong", "right"), [(0, True), (1, True), (4, False)])
def test_each_posterior_stated_of_a_place_is_judged_by_the_pairs_of_its_dive(
    story, tell, truth_of, wrong: int, right: bool
):
    s = story(wrong_pairs=wrong)
    dives = evaluate(collect(tell(s), truth=truth_of(s))).dives
    assert all({(x.posterior, x.right) for x in d.stated} == {(0.98, right)} for d in dives)
    answers = sum(topic == "global/hypotheses" for _, topic, _ in tell(s))
    assert sum(len(d.stated) for d in dives) == answers > 3


def test_identity_does_not_depend_on_dead_reckonings_drift(story, tell, truth_of):
    s = story(drift=(0.2, -0.3))  # 200 m by the end
    run = collect(tell(s), truth=truth_of(s))
    found = identities(
        run.of("tracking/features", TrackedFeatures), run.tracks["deadreck/odometry"], run.true_track, run.truth
    )
    assert found == {key: key for key in range(12)}


def test_clutter_is_no_features_and_its_pairs_are_wrong(story, truth_of):
    truth = truth_of(story())
    assert judge([(100, 5), (101, 1)], {5: None, 1: 1}, truth) == (1, 1)


def test_a_key_never_located_counts_for_neither(story, truth_of):
    assert judge([(100, 5)], {}, truth_of(story())) == (0, 0)
