"""Whether the front half keeps its pace live: ``python -m fbn_testing.live_pace --minutes 10``.

A simulated mission is published in real time; predict, dead reckoning and reference run as they do on a vehicle, each
in a process of its own, on the system's clock.  Told of each node: how soon it was ready, its share of a core, its
timer's missed cycles and worst lateness; and of predict, whether there is a motion for every 10 ms.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rich.console import Console
from rich.table import Table

from fbn_common.graph import GRAPH
from fbn_common.motion_ekf.layout import GRID_NS
from fbn_common.records import PredictedMotion
from fbn_ros.cdr import Cdr
from fbn_ros.messages import RclpySerialiser
from fbn_ros.qos import profile
from fbn_ros.spin import make_executor, spin
from fbn_testing.harness import private_domain

NODES = ("fbn_predict", "fbn_deadreck", "fbn_reference")
SETTLING_S = 3.0  # of reports left out: discovery, and the filters' start
MOTION = GRAPH.topics["predict/motion"]


@dataclass
class Pace:
    """What one node said of its own pace, report by report (one a second)."""

    ready_s: float = float("nan")  # from the process's start to the line that says it is ready
    cpu: list[float] = field(default_factory=list)  # % of a core
    late_ms: list[float] = field(default_factory=list)  # worst of each second
    advance_ms: list[float] = field(default_factory=list)  # longest of each second
    missed: list[int] = field(default_factory=list)  # cycles, in all

    def take(self, values: dict[str, str]) -> None:
        """Keep a report's figures."""
        self.cpu.append(float(values["cpu [%]"]))
        self.late_ms.append(float(values["timer late max [ms]"]))
        self.advance_ms.append(float(values["advance max [ms]"]))
        self.missed.append(int(values["timer cycles missed"]))


class Listener:
    """Hears the nodes' reports, and predict's motions."""

    def __init__(self, node: Any, begin_s: float) -> None:
        self.paces = {name: Pace() for name in NODES}
        self.motions = self.gaps = 0
        self._begin, self._newest_ns = begin_s, -1
        self._cdr = Cdr(RclpySerialiser())
        node.create_subscription(DiagnosticArray, "/diagnostics", self._report, 100)
        message = self._cdr.serialiser.factory.message(MOTION.ros_type)
        node.create_subscription(message, MOTION.name, self._motion, profile(MOTION), raw=True)

    def _report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            pace = self.paces.get(status.hardware_id)
            if pace is not None and time.monotonic() > self._begin + SETTLING_S:
                pace.take({v.key: v.value for v in status.values})

    def _motion(self, data: bytes) -> None:
        stamp = self._cdr.decode(MOTION.name, PredictedMotion, data).stamp_ns
        self.motions += 1
        if self._newest_ns >= 0 and stamp > self._newest_ns + GRID_NS:
            self.gaps += (stamp - self._newest_ns) // GRID_NS - 1
        self._newest_ns = max(self._newest_ns, stamp)


@contextmanager
def process(module: str, *parameters: str) -> Iterator[subprocess.Popen[str]]:
    """A node in a process of its own; it is stopped in the end."""
    command = [sys.executable, "-m", module, "--ros-args", *(a for p in parameters for a in ("-p", p))]
    quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=os.environ | quiet
    ) as running:
        try:
            yield running
        finally:
            running.terminate()


def _await_ready(running: subprocess.Popen[str], begin_s: float, told: str) -> float:
    """Seconds until the node logs this; its later lines are read and dropped, so that it never waits for a reader."""
    assert running.stderr is not None
    for line in running.stderr:
        if told in line:
            threading.Thread(target=running.stderr.read, daemon=True).start()
            return time.monotonic() - begin_s
    raise RuntimeError(f"a node ended before it was ready: status {running.wait()}")


def measure(minutes: float, scenario: str) -> Listener:
    """Run the nodes for so long."""
    with private_domain(), process("fbn_sim.node", f"scenario:={scenario}", "seed:=1000", "delay:=15.0") as simulator:
        _await_ready(simulator, 0.0, "publishing")
        with process("fbn_predict.node") as a, process("fbn_deadreck.node") as b, process("fbn_reference.node") as c:
            begin = time.monotonic()  # they start at once, as on a vehicle
            with ThreadPoolExecutor() as pool:
                ready = list(pool.map(lambda running: _await_ready(running, begin, "ready:"), (a, b, c)))
            rclpy.init()
            try:
                node = rclpy.create_node("live_pace")
                executor = make_executor()
                executor.add_node(node)
                listener = Listener(node, time.monotonic())
                spin(executor, timeout_s=60.0 * minutes)
            finally:
                rclpy.try_shutdown()
    for pace, seconds in zip(listener.paces.values(), ready, strict=True):
        pace.ready_s = seconds
    return listener


def report(heard: Listener) -> Table:
    """The table of nodes."""
    made = Table(title="The front half live", title_justify="left", box=None, pad_edge=False)
    columns = ("node", "ready \\[s]", "CPU \\[% of a core]", "cycles missed", "latest \\[ms]", "longest advance \\[ms]")
    for i, column in enumerate(columns):
        made.add_column(column, justify="right" if i else "left")
    total = 0.0
    for name, p in heard.paces.items():
        cpu = sum(p.cpu) / max(len(p.cpu), 1)
        total += cpu
        missed = p.missed[-1] - p.missed[0] if p.missed else -1
        late, long = max(p.late_ms, default=-1.0), max(p.advance_ms, default=-1.0)
        made.add_row(name, f"{p.ready_s:.1f}", f"{cpu:.1f}", str(missed), f"{late:.1f}", f"{long:.1f}")
    made.add_row("all three", "", f"{total:.1f}", "", "", "")
    made.caption = f"{heard.motions} motions heard, {heard.gaps} steps of 10 ms without one"
    return made


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="how long (10)")
    parser.add_argument("--scenario", default="no_map_transit", help="whose sensors are published (no_map_transit)")
    a = parser.parse_args()
    Console(highlight=False).print(report(measure(a.minutes, a.scenario)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
