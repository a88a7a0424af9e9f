"""The graph on the vehicle: every node a process, watched and restarted, until Ctrl-C."""

from __future__ import annotations

import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import yaml

from fbn_bringup.configuration import load_parameters, node_files
from fbn_bringup.console import Console
from fbn_bringup.environment import node_environment
from fbn_bringup.replay import node_command
from fbn_bringup.supervisor import Command, OnLine, Restart, Supervisor
from fbn_common.graph import GRAPH, Graph

WATCH_S = 0.2
RESTART = Restart()


def run_live(
    parameter_files: Sequence[Path] = (),
    namespace: str = "",
    overrides: Mapping[str, Any] | None = None,
    only: tuple[str, ...] = (),
    *,
    network: bool = False,
    use_sim_time: bool = False,
    log_level: str = "info",
    graph: Graph = GRAPH,
    on_line: OnLine | None = None,
    restart: Restart = RESTART,
) -> int:
    """Run the nodes until SIGINT or SIGTERM; 0 after a clean end, 1 if a node died too often.

    DDS stays on this host unless ``network`` (or ``ROS_AUTOMATIC_DISCOVERY_RANGE``) opens it.  Must be called from
    the main thread.  Raises ParameterError before anything is started.
    """
    graph = graph.only(only) if only else graph
    parameters = load_parameters(graph, parameter_files, overrides)
    with tempfile.TemporaryDirectory(prefix="fbn-") as directory:
        file = Path(directory) / "parameters.yaml"
        file.write_text(yaml.safe_dump(node_files(parameters), sort_keys=False))
        commands = [_command(graph, name, file, namespace, use_sim_time, log_level) for name in parameters]
        environment = node_environment(network=network)
        say = on_line or Console([c.name for c in commands])
        with _stop_requests() as stopped, Supervisor(commands, environment, restart, say) as nodes:
            while not stopped() and not nodes.given_up():
                nodes.watch()
                time.sleep(WATCH_S)
            return 1 if nodes.given_up() else 0


def _command(graph: Graph, name: str, parameters: Path, namespace: str, use_sim_time: bool, log_level: str) -> Command:
    arguments = ["--params-file", str(parameters), "--log-level", log_level]
    if use_sim_time:
        arguments += ["-p", "use_sim_time:=true"]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace.strip('/')}"]
    return node_command(graph.node(name).package, name, arguments)


@contextmanager
def _stop_requests() -> Iterator[Callable[[], bool]]:
    """Yields what tells whether SIGINT or SIGTERM has come; a second SIGINT interrupts as usual."""
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 2:
            raise KeyboardInterrupt

    before = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
