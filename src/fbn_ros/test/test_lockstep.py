"""A node in lock step takes exactly the messages of a step, in whatever order and however early they come."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

from fbn_common.records import NodeProgress
from fbn_ros.cdr import Cdr
from fbn_ros.lockstep import Missing, StepGate
from fbn_ros.progress import PLAYER, from_bytes, progress, to_bytes
from fbn_testing.compare import difference
from fbn_testing.examples import example

PUBLISHERS = {"up": "upstream", "back": "downstream"}


def told(node: str, step: int, **counts: int) -> NodeProgress:
    return progress(node, step, 100 * step, counts, counts)


def gate() -> StepGate:
    return StepGate(("log", "up"), ("back",), PUBLISHERS)


def taken(g: StepGate) -> list[Any]:
    steps = []
    while (due := g.due()) is not None:
        steps.append((due.step, due.stamp_ns, dict(due.messages)))
    return steps


def test_a_step_waits_for_every_message_promised() -> None:
    g = gate()
    g.promise(told(PLAYER, 1, log=2))
    g.add("log", "a")
    g.promise(told("upstream", 1, up=1))
    assert taken(g) == []
    assert list(g.missing()) == [Missing("log", PLAYER, 2, 1), Missing("up", "upstream", 1, 0)]
    g.add("up", "u")
    g.add("log", "b")
    assert taken(g) == [(1, 100, {"log": ["a", "b"], "up": ["u"], "back": []})]


def test_what_was_not_told_yet_is_missing_too() -> None:
    g = gate()
    g.promise(told(PLAYER, 1, log=0))
    assert list(g.missing()) == [Missing("up", "upstream", None, 0)]


def test_messages_of_later_steps_wait() -> None:
    g = gate()
    for message in "abc":
        g.add("log", message)
    g.promise(told(PLAYER, 1, log=1))
    g.promise(told(PLAYER, 2, log=3))
    g.promise(told("upstream", 1, up=0))
    assert taken(g) == [(1, 100, {"log": ["a"], "up": [], "back": []})]


def test_what_closes_a_loop_is_taken_one_step_later() -> None:
    g = gate()
    for step in (1, 2):
        g.promise(told(PLAYER, step, log=0))
        g.promise(told("upstream", step, up=0))
    g.add("back", "of step 1")
    assert [step for step, _, _ in taken(g)] == [1]
    g.promise(told("downstream", 1, back=1))
    assert taken(g) == [(2, 200, {"log": [], "up": [], "back": ["of step 1"]})]


def test_the_player_speaks_for_topics_of_nodes_that_do_not_run() -> None:
    g = gate()
    g.promise(told(PLAYER, 1, log=0, up=1, back=1))
    g.add("up", "logged")
    g.add("back", "logged")
    assert taken(g) == [(1, 100, {"log": [], "up": ["logged"], "back": []})]


def test_the_order_of_arrival_changes_nothing() -> None:
    events: list[tuple[str, Any]] = []
    for step in range(1, 30):
        counts = {"log": 3 * step, "up": step, "back": 2 * step}
        events += [("log", f"log{3 * (step - 1) + i}") for i in range(3)] + [("up", f"up{step}")]
        events += [("back", f"back{2 * step + i}") for i in range(2)]
        events += [("promise", told(PLAYER, step, log=counts["log"])), ("promise", told("upstream", step, up=step))]
        events += [("promise", told("downstream", step, back=counts["back"]))]

    def run(seed: int) -> list[Any]:
        """Each topic keeps its order, as over DDS; between topics anything may happen."""
        rng, g, steps = random.Random(seed), gate(), list[Any]()
        queues = {kind: [e for e in events if e[0] == kind] for kind in ("log", "up", "back")}
        for node in (PLAYER, "upstream", "downstream"):
            queues[node] = [e for e in events if e[0] == "promise" and e[1].node == node]
        while any(queues.values()):
            kind, what = queues[rng.choice([k for k, q in queues.items() if q])].pop(0)
            if kind == "promise":
                g.promise(what)
            else:
                g.add(kind, what)
            steps += taken(g)
        return steps

    assert len(run(0)) == 29
    assert all(run(seed) == run(0) for seed in range(1, 20))


def test_progress_is_written_and_read_as_any_message() -> None:
    cdr, rng = Cdr(), np.random.default_rng(2)
    for items in range(8):
        record = example(NodeProgress, rng, items)
        assert to_bytes(record) == cdr.encode(record)
        assert difference(from_bytes(cdr.encode(record)), record) == ""


@pytest.mark.parametrize("data", [b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + 40 * b"\xff"])
def test_bytes_that_are_no_progress_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError):
        from_bytes(data)
