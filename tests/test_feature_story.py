"""Which feature's story is told, and that it is told as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fbn_testing.feature_runs import hear
from fbn_testing.feature_story import PASSAGE, Moment, draw_story, off_lobe, stories


def story(depth: float, sinking: float = 0.0, error: float = 0.0, skipped: int = 0) -> list[Moment]:
    """Twelve echoes at the height of the array, of a feature so far below it, a feature from the seventh on."""
    truth, point = np.array([10.0, 2.0, -2.0 - depth]), np.array([10.0 + error, 2.0, -2.0])
    echoes = np.tile([10.0, 2.0, -2.0], (12 + skipped, 1))
    return [Moment(n >= 7, point, None, echoes[: n + skipped], truth, -2.0 - sinking * n / 12.0) for n in range(1, 13)]


def test_the_feature_farthest_from_the_middle_of_the_lobe_is_taken() -> None:
    told = [story(1.0), story(3.0), story(2.0)]
    assert off_lobe(told)[0] is told[1][0]


def test_no_story_of_a_dive_of_clutter_or_without_its_beginning_is_taken() -> None:
    told = [story(9.0, sinking=2.0), story(8.0, error=5.0), story(7.0, skipped=1), story(6.0)[:-1], story(1.0)]
    assert off_lobe(told)[0] is told[-1][0]


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    draw_story(story(2.0), tmp_path / "story.png")
    assert (tmp_path / "story.png").stat().st_size > 10_000


@pytest.mark.campaign
def test_on_a_mission_the_first_belief_is_the_middle_of_the_lobe() -> None:
    told = off_lobe(stories(hear("depth_of_features", 1000, PASSAGE)))
    assert [len(moment.echoes) for moment in told] == list(range(1, 13))
    assert np.hypot(*(told[0].point - told[0].echoes[0])[[0, 2]]) < 0.5  # the slack of the drift, over no time at all
    assert not told[5].graduated and told[-1].graduated  # seven echoes at least
