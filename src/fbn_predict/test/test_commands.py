"""The actuators' commands over the steps of the grid: means and ages against their definition, by the nanosecond."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fbn_predict.commands import ACTUATORS, Commands

STEP, COUNT = 10, 12  # ns: small enough to average nanosecond by nanosecond
stamps = st.lists(st.integers(-30, 150), max_size=12, unique=True)


def commanded(at: list[int]) -> Commands:
    commands = Commands()
    for stamp in at:
        commands.put(1000 + stamp, np.arange(len(ACTUATORS)) + float(stamp))
    return commands


def in_force(at: list[int], t: int) -> int | None:
    return max((s for s in at if s <= t), default=None)


@given(stamps)
def test_a_steps_command_is_the_mean_over_its_nanoseconds(at: list[int]) -> None:
    found = commanded(at).means(1000, STEP, COUNT)
    for k in range(COUNT):
        held = [in_force(at, t) for t in range(k * STEP, (k + 1) * STEP)]
        each = [np.zeros(len(ACTUATORS)) if s is None else np.arange(len(ACTUATORS)) + float(s) for s in held]
        np.testing.assert_allclose(found[k], np.mean(each, axis=0), rtol=1e-13, atol=1e-12)  # sums of ten


@given(stamps)
def test_a_command_is_as_old_as_the_last_one_before_the_step(at: list[int]) -> None:
    ages = commanded(at).ages(1000, STEP, COUNT)
    for k in range(COUNT):
        last = in_force(at, k * STEP)
        assert ages[k] > 1 << 59 if last is None else ages[k] == k * STEP - last
