"""The graph as processes over DDS, fed from a log: in lock step, or paced by time.

In lock step the player publishes a step's messages and what it has published so far, and goes on while every node
is at most a few steps behind; so nothing is lost, and the answer is the offline runner's (see ``fbn_ros.lockstep``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
import yaml

from fbn_bringup import rundir
from fbn_bringup.configuration import Parameters, load_parameters, node_files
from fbn_bringup.environment import adopt, node_environment, private_domain, undisturbed
from fbn_bringup.lockstep_player import LockStepPlayer
from fbn_bringup.paced_player import PacedPlayer
from fbn_bringup.player import Player
from fbn_bringup.rundir import DEFAULTS, NodeSummary, OnProgress, ReplayError, ReplayOptions, RunSummary
from fbn_bringup.supervisor import Command, Supervisor, ended
from fbn_common.graph import Graph
from fbn_ros.bag import BagReader, BagWriter
from fbn_ros.station import Report, station

__all__ = ["ReplayError", "replay_nodes"]


def replay_nodes(
    bag: Path,
    run: Path,
    options: ReplayOptions = DEFAULTS,
    on_progress: OnProgress | None = None,
    rate: float | None = None,
    on_line: Callable[[str, str], None] = lambda name, line: None,
) -> RunSummary:
    """Replay a log through the nodes as processes and write the run directory.

    ``rate`` paces it by time (1 = real time) on the DDS domain of the environment; without, it goes in lock step on a
    domain of its own.  ``on_line(node, line)`` gets what the nodes log.

    Raises BagError, ParameterError, KeyError for a node in ``only`` that does not exist, and ReplayError if a node
    ends or does not take a step: the text names node, topic, expected and got.
    """
    graph = options.selected
    parameters = load_parameters(graph, options.parameter_files, options.overrides)
    with ExitStack() as stack:
        reader = stack.enter_context(BagReader(bag, options.namespace))
        inputs = rundir.inputs_of(reader, graph)
        writer = stack.enter_context(BagWriter(rundir.create(run)))
        meter = rundir.Meter(reader, on_progress)
        meter.at(reader.start_ns, "starting the nodes")
        nodes = stack.enter_context(_nodes(graph, parameters, run, lock_step=rate is None, on_line=on_line))
        kind: type[Player] = LockStepPlayer if rate is None else PacedPlayer
        own = stack.enter_context(station("player", lock_step=kind.lock_step))
        player = kind(own, graph, reader, writer, inputs, lambda: _check_alive(nodes))
        player.wait_for_nodes()
        meter.restart()
        player.play(meter, rate or 1.0)
        summaries = {name: _summary(name, pid, graph, player) for name, pid in nodes.pids.items()}
        counts = writer.counts
        mode = "lock step" if rate is None else f"paced at {rate:g}"
        summary = rundir.summarise(reader, options, parameters, mode, meter.wall_s, summaries, counts)
        rundir.write_run(run, summary)
    return summary


def node_command(package: str, name: str, arguments: list[str]) -> Command:
    """How a node is run: as the module of its package, by this interpreter, with these ROS arguments."""
    import sys

    return Command(name, (sys.executable, "-m", f"{package}.node", "--ros-args", "-r", f"__node:={name}", *arguments))


@contextmanager
def _nodes(
    graph: Graph, parameters: Parameters, run: Path, *, lock_step: bool, on_line: Callable[[str, str], None]
) -> Iterator[Supervisor]:
    """The graph's nodes, running; in lock step on a domain of their own."""
    with ExitStack() as stack:
        if lock_step:
            stack.enter_context(undisturbed())
        domain = stack.enter_context(private_domain()) if lock_step else None
        environment = node_environment(domain_id=domain)
        adopt(environment)
        file = run / "parameters.yaml"
        file.write_text(yaml.safe_dump(node_files(parameters), sort_keys=False))
        mode = ["-p", "lock_step:=true"] if lock_step else ["-p", "use_sim_time:=true"]
        commands = [node_command(n.package, n.name, ["--params-file", str(file), *mode]) for n in graph.nodes]
        yield stack.enter_context(Supervisor(commands, environment, on_line=on_line))


def _check_alive(nodes: Supervisor) -> None:
    for name, code in nodes.dead().items():
        tail = "\n  ".join(nodes.tail(name)[-8:])
        raise ReplayError(f"{name} ended ({ended(code)}) during the replay; its last lines:\n  {tail}")


def _summary(name: str, pid: int, graph: Graph, player: Player) -> NodeSummary:
    times = psutil.Process(pid).cpu_times()
    node = graph.node(name)
    _, _, level, message, values, _ = player.health.get(name, Report(0, name, "STALE", "never heard of", {}, b""))
    received = {t: n for t in (*node.inputs, *node.feedback) if (n := int(values.get(f"{t} count", 0)))}
    published = {t: n for t in node.outputs if (n := player.published[t])}
    prefix = "malformed "
    refused = {k.removeprefix(prefix): int(v) for k, v in values.items() if k.startswith(prefix)}
    return NodeSummary(times.user + times.system, received, published, refused, level, message, dict[str, Any](values))
