"""The supervisor starts, watches, restarts and stops; nothing outlives it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from fbn_bringup.environment import node_environment
from fbn_bringup.shared_memory import clean_shared_memory
from fbn_bringup.supervisor import Command, Restart, Supervisor

UP = "import signal, subprocess, sys, time; {}; print('up', flush=True); time.sleep(60)"
SLEEPER = UP.format("signal.signal(signal.SIGINT, lambda *_: exit(0))")
STUBBORN = UP.format("[signal.signal(s, signal.SIG_IGN) for s in (2, 15)]")
PARENT = UP.format("subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])")


def python(name: str, code: str) -> Command:
    return Command(name, (sys.executable, "-c", code))


def wait_until(predicate: Callable[[], bool], limit_s: float = 15.0) -> None:
    deadline = time.monotonic() + limit_s
    while not predicate():
        assert time.monotonic() < deadline, "not so in time"
        time.sleep(0.02)


def test_output_is_passed_on_line_by_line_with_the_name() -> None:
    lines: list[tuple[str, str]] = []
    with Supervisor([python("a", SLEEPER)], os.environ, on_line=lambda *line: lines.append(line)):
        wait_until(lambda: ("a", "up") in lines)


@pytest.mark.parametrize("code", [SLEEPER, STUBBORN, PARENT], ids=["polite", "stubborn", "with a child of its own"])
def test_nothing_runs_once_it_has_stopped(code: str) -> None:
    lines: list[tuple[str, str]] = []
    with Supervisor([python("a", code)], os.environ, on_line=lambda *line: lines.append(line)) as nodes:
        wait_until(lambda: bool(lines))
        family = [psutil.Process(nodes.pids["a"]), *psutil.Process(nodes.pids["a"]).children(recursive=True)]
        nodes.stop(patience_s=0.3)
    wait_until(lambda: not any(p.is_running() and p.status() != psutil.STATUS_ZOMBIE for p in family))


def test_one_that_dies_is_started_again() -> None:
    lines: list[tuple[str, str]] = []
    policy = Restart(delay_s=0.1)
    with Supervisor([python("a", SLEEPER)], os.environ, policy, lambda *line: lines.append(line)) as nodes:
        first = nodes.pids["a"]
        wait_until(lambda: ("a", "up") in lines)
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: nodes.watch() is None and nodes.pids["a"] != first and lines.count(("a", "up")) == 2)
    assert ("a", "WARN ended (killed by SIGKILL); starting again in 0.1 s") in lines


def test_one_that_dies_again_and_again_is_given_up() -> None:
    lines: list[tuple[str, str]] = []
    policy = Restart(delay_s=0.01, limit=2)
    with Supervisor([python("a", "exit(3)")], os.environ, policy, lambda *line: lines.append(line)) as nodes:
        wait_until(lambda: nodes.watch() is None and nodes.given_up() == ["a"])
    assert ("a", "ERROR ended (status 3) for the 3th time; given up") in lines


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_nodes_end_with_fbn_run_however_that_ends(sent: signal.Signals, domain: int, tmp_path: Path) -> None:
    """Also when it is killed; and after SIGINT and SIGTERM the status is 0."""
    script = textwrap.dedent("""
        import sys
        from fbn_bringup.live import run_live
        from fbn_testing.fakes import FAKE_GRAPH
        sys.exit(run_live(graph=FAKE_GRAPH, only=("predict", "global"), namespace="ranger"))
    """)
    environment = node_environment(domain_id=domain)
    before = _shared_memory()
    process = subprocess.Popen([sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE, text=True)
    ready = 0
    assert process.stdout is not None
    for line in process.stdout:
        ready += "ready: takes" in line
        if ready == 2:
            break
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) == 2
    process.send_signal(sent)
    code = process.wait(timeout=20)
    wait_until(lambda: not any(c.is_running() and c.status() != psutil.STATUS_ZOMBIE for c in children))
    assert code == (-signal.SIGKILL if sent is signal.SIGKILL else 0)
    wait_until(lambda: _shared_memory() <= before)


def _shared_memory() -> set[str]:
    """Segments of Fast DDS that belong to a process, not the ports, which are the domain's."""
    return {f.name for f in Path("/dev/shm").glob("fastrtps_*") if "port" not in f.name}


def test_shared_memory_of_the_killed_is_removed_and_of_the_living_kept(tmp_path: Path) -> None:
    import fcntl

    def segment(name: str) -> Path:
        for file in (tmp_path / f"fastrtps_{name}", tmp_path / f"fastrtps_{name}_el"):
            file.touch()
            os.utime(file, (time.time() - 60, time.time() - 60))
        return tmp_path / f"fastrtps_{name}"

    dead, living = segment("0123456789abcdef"), segment("fedcba9876543210")
    young = tmp_path / "fastrtps_aaaaaaaaaaaaaaaa_el"
    young.touch()
    with living.with_name(f"{living.name}_el").open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert clean_shared_memory(tmp_path) == 1
    assert (dead.exists(), living.exists(), young.exists()) == (False, True, True)


def test_discovery_stays_on_this_host_unless_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    assert node_environment()["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert node_environment(network=True)["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT")
    assert node_environment()["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
