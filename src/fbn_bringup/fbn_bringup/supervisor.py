"""Starts processes, watches them, restarts those that die, and stops them all; no orphans, no stale shared memory."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from fbn_bringup.shared_memory import clean_shared_memory

OnLine = Callable[[str, str], None]  # process, line

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True, slots=True)
class Restart:
    """When a process that died by itself is started again; ``limit`` times within ``window_s``, then never more."""

    delay_s: float = 1.0
    limit: int = 5
    window_s: float = 60.0


@dataclass(frozen=True, slots=True)
class Command:
    """A process to run."""

    name: str
    argv: tuple[str, ...]


@dataclass(slots=True)
class _Child:
    command: Command
    process: subprocess.Popen[str]
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=20))
    starts: list[float] = field(default_factory=list)
    due: float | None = None  # time of the restart, once dead
    given_up: bool = False


class Supervisor:
    """Runs commands until stopped; use it in a ``with`` statement, from one thread that lives as long as they do.

    Each process has a process group of its own, so that Ctrl-C reaches the supervisor alone, and dies with the
    supervisor even if that is killed.
    """

    def __init__(
        self,
        commands: Sequence[Command],
        environment: Mapping[str, str],
        restart: Restart | None = None,
        on_line: OnLine = lambda name, line: None,
    ) -> None:
        self._commands, self._environment, self._restart, self._on_line = commands, environment, restart, on_line
        self._children: dict[str, _Child] = {}
        self._readers: list[threading.Thread] = []

    def __enter__(self) -> Self:
        clean_shared_memory()
        try:
            for command in self._commands:
                process = self._spawn(command)
                self._children[command.name] = _Child(command, process, starts=[time.monotonic()])
                self._listen(self._children[command.name])
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name."""
        return {name: child.process.pid for name, child in self._children.items()}

    def dead(self) -> dict[str, int]:
        """Exit status, by name, of the processes that are not running now."""
        codes = {name: child.process.poll() for name, child in self._children.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def given_up(self) -> list[str]:
        """Names of the processes that died too often."""
        return [name for name, child in self._children.items() if child.given_up]

    def tail(self, name: str) -> list[str]:
        """The last lines of a process's output."""
        return list(self._children[name].tail)

    def watch(self) -> None:
        """Restart what is due; to be called a few times a second."""
        now = time.monotonic()
        for child in self._children.values():
            code = child.process.poll()
            if code is not None and self._restart is not None and not child.given_up:
                self._revive(child, code, now, self._restart)

    def stop(self, patience_s: float = 5.0) -> None:
        """SIGINT to all, SIGTERM to those still there after a while, then SIGKILL; returns when all have ended."""
        for sent in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [c.process for c in self._children.values() if c.process.poll() is None]
            for process in running:
                _signal_group(process.pid, sent)
                _signal_group(process.pid, signal.SIGCONT)  # a stopped one cannot end
            deadline = time.monotonic() + patience_s
            for process in running:
                try:
                    process.wait(max(0.0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
        for reader in self._readers:
            reader.join(timeout=1.0)
        clean_shared_memory()

    def _revive(self, child: _Child, code: int, now: float, policy: Restart) -> None:
        name = child.command.name
        if child.due is None:
            recent = [t for t in child.starts if now - t < policy.window_s]
            if len(recent) > policy.limit:
                child.given_up = True
                self._on_line(name, f"ERROR ended ({ended(code)}) for the {len(recent)}th time; given up")
                return
            child.due = now + policy.delay_s
            self._on_line(name, f"WARN ended ({ended(code)}); starting again in {policy.delay_s:g} s")
        elif now >= child.due:
            clean_shared_memory()
            child.due, child.process = None, self._spawn(child.command)
            child.starts.append(now)
            self._listen(child)

    def _spawn(self, command: Command) -> subprocess.Popen[str]:
        parent = os.getpid()
        return subprocess.Popen(
            command.argv,
            env=dict(self._environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            preexec_fn=lambda: _die_with(parent),
        )

    def _listen(self, child: _Child) -> None:
        def read(stream: subprocess.Popen[str] = child.process) -> None:
            assert stream.stdout is not None
            for line in stream.stdout:
                child.tail.append(line.rstrip("\n"))
                self._on_line(child.command.name, line.rstrip("\n"))

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        self._readers.append(reader)


def ended(code: int) -> str:
    """An exit status in words."""
    return f"status {code}" if code >= 0 else f"killed by {signal.Signals(-code).name}"


def _die_with(parent: int) -> None:
    """In the child, before its program: end when the parent's thread ends, and take Ctrl-C as usual."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it ended before the line above
        os._exit(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _signal_group(pid: int, sent: signal.Signals) -> None:
    try:
        os.killpg(pid, sent)
    except ProcessLookupError:
        return
