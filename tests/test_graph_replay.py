"""The whole graph as processes over DDS gives what one process gives; and what stops a replay is said."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

from fbn_bringup.offline import replay_offline
from fbn_bringup.replay import replay_nodes
from fbn_bringup.rundir import Progress, ReplayError, ReplayOptions, read_run
from fbn_common import records as r
from fbn_ros.bag import BagError, BagReader, BagWriter
from fbn_testing.compare import first_difference, read_log
from fbn_testing.fakes import FAKE_GRAPH
from fbn_testing.logs import sensor_log, sensor_record

FAKES = ReplayOptions(graph=FAKE_GRAPH)


def test_five_processes_in_lock_step_give_the_answer_of_one_process(
    river: Path, river_run: Path, river_options: ReplayOptions, tmp_path: Path
) -> None:
    """To the last bit of every decoded value, input or output, in the same order, at the same log times."""
    summary = replay_nodes(river, tmp_path / "run", river_options)
    assert first_difference(read_log(river_run / "bag"), read_log(tmp_path / "run" / "bag")) == ""
    offline = read_run(river_run)
    assert {n: s.published for n, s in summary.nodes.items()} == {n: s.published for n, s in offline.nodes.items()}
    assert summary.mode == "lock step" and read_run(tmp_path / "run") == summary
    assert all(s.level in ("OK", "WARN") and s.cpu_s > 0 for s in summary.nodes.values())


def test_truth_and_what_else_was_logged_goes_into_the_runs_bag(river: Path, river_run: Path) -> None:
    with BagReader(river) as source, BagReader(river_run / "bag") as run:
        assert all(run.topics[topic] == source.topics[topic] for topic in source.topics)


def test_the_tail_of_a_log_run_again_gives_the_same(
    river_run: Path, river_options: ReplayOptions, tmp_path: Path
) -> None:
    """Outputs of the nodes that are left out come from the log, at the same steps."""
    tail = dataclasses.replace(river_options, only=("fbn_tracking", "fbn_global"))
    replay_offline(river_run / "bag", tmp_path / "offline", tail)
    replay_nodes(river_run / "bag", tmp_path / "dds", tail)
    for again in ("offline", "dds"):
        assert first_difference(_known(river_run), _known(tmp_path / again)) == ""


def _known(run: Path) -> list[tuple[int, str, object]]:
    """Without log times: those of the outputs are spaced by their number in a step."""
    entries = sorted(read_log(run / "bag"), key=lambda e: e.topic)
    return [(0, e.topic, e.record) for e in entries]


def test_the_nodes_can_be_paced_by_time(sensor_bag: Path, tmp_path: Path) -> None:
    """At twice real time everything is played, not before its time; the nodes are heard however late it gets."""
    said: list[Progress] = []
    summary = replay_nodes(sensor_bag, tmp_path / "run", FAKES, said.append, rate=2.0)
    assert summary.wall_s / (summary.log_s / 2.0) > 0.9
    with BagReader(tmp_path / "run" / "bag") as run:
        assert run.topics["imu/data"].count == 120
        assert run.topics["predict/motion"].count > 300  # of 1200: a loaded machine misses some
        assert run.topics["global/pose"].count > 5
    assert said[-1].fraction > 0.8


def test_a_node_that_dies_ends_the_replay_with_its_last_words(
    sensor_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    strike = _after_a_second("fbn_tracking", signal.SIGKILL, monkeypatch)
    with pytest.raises(ReplayError, match=r"fbn_tracking ended \(killed by SIGKILL\)"):
        replay_nodes(sensor_bag, tmp_path / "run", FAKES, strike)
    with BagReader(tmp_path / "run" / "bag") as run:  # what was done by then is kept
        assert run.topics["predict/motion"].count > 50


def test_a_node_that_stands_still_is_named_with_what_is_missing(
    sensor_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    strike = _after_a_second("fbn_reference", signal.SIGSTOP, monkeypatch)
    monkeypatch.setattr("fbn_bringup.lockstep_player.STEP_LIMIT_S", 2.0)
    with pytest.raises(ReplayError, match=r"fbn_reference: reference/fix: expected \?, got \d+") as caught:
        replay_nodes(sensor_bag, tmp_path / "run", FAKES, strike)
    assert "was not finished within 2 s" in str(caught.value)


def _after_a_second(node: str, blow: signal.Signals, monkeypatch: pytest.MonkeyPatch) -> Callable[[Progress], None]:
    """Strikes a node once, in the first step that ends beyond a second of the log, however fast that is played."""
    monkeypatch.setattr("fbn_bringup.rundir.Meter.PERIOD_S", 0.0)
    struck: list[int] = []

    def strike(progress: Progress) -> None:
        if progress.log_s > 1.0 and not struck:
            struck.extend(p.pid for p in psutil.Process().children() if f"__node:={node}" in " ".join(p.cmdline()))
            for pid in struck:
                os.kill(pid, blow)

    return strike


def test_malformed_messages_in_a_log_are_answered_alike_in_both_replays(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        for k, (log_time_ns, topic, record) in enumerate(sensor_log(4.0)):
            if topic == "pressure" and k % 3 == 0:
                writer.write(log_time_ns, topic, dataclasses.replace(record, fluid_pressure=float("nan")))  # type: ignore[call-arg]
            elif topic == "imu/data" and k % 4 == 0:
                writer.write_raw(log_time_ns, topic, record.ros_type, b"\x00\x01\x00\x00 torn")
            else:
                writer.write(log_time_ns, topic, record)
    offline = replay_offline(tmp_path / "bag", tmp_path / "offline", FAKES)
    dds = replay_nodes(tmp_path / "bag", tmp_path / "dds", FAKES)
    refused = offline.nodes["fbn_deadreck"].refused
    assert min(refused["pressure"], refused["imu/data"]) > 3
    assert {n: s.refused for n, s in offline.nodes.items()} == {n: s.refused for n, s in dds.nodes.items()}
    with BagReader(tmp_path / "dds" / "bag") as reader:
        answers = [record for _, _, record in reader.records(["deadreck/innovations"])]
    assert all(isinstance(a, r.Innovation) and a.verdict is r.Verdict.REFUSED and a.reason for a in answers)
    assert len(answers) == sum(refused.values())


def test_a_log_without_what_a_node_needs_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(1, "gps/fix", sensor_record("gps/fix", 1, 0, np.random.default_rng(1)))
    with pytest.raises(BagError, match="fbn_predict needs actuators; the bag has /gps/fix"):
        replay_offline(tmp_path / "bag", tmp_path / "run", FAKES)
    assert not (tmp_path / "run").exists()


def test_a_run_is_never_overwritten(river_run: Path, river: Path, river_options: ReplayOptions) -> None:
    with pytest.raises(BagError, match="holds a run already"):
        replay_offline(river, river_run, river_options)
