"""What a node's first messages make it load: ``python -m fbn_testing.first_messages played.pickle``, in a new process.

Whatever is compiled, loaded from the kernels' cache or imported after a node's start makes one of its advances late.
"""

from __future__ import annotations

import gc
import json
import pickle
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher

from fbn_common.graph import GRAPH
from fbn_common.records import Record
from fbn_ros.host import Host

STEP_NS = 200_000_000


@dataclass(frozen=True)
class Played:
    """A node, its parameters, and what came in: time of arrival [ns], topic, record, in order of time."""

    node: str
    parameters: Any
    entries: Sequence[tuple[int, str, Record]]


@dataclass(frozen=True)
class Loaded:
    """What was new after the node's start, and the topics it published on."""

    kernels: list[str]
    modules: list[str]
    published: list[str]


def in_new_process(played: Played, scratch: Path) -> Loaded:
    """Start the node in a process of its own, and play to it."""
    scratch.write_bytes(pickle.dumps(played))
    command = [sys.executable, "-m", "fbn_testing.first_messages", str(scratch)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise RuntimeError(ran.stderr)
    return Loaded(**json.loads(ran.stdout.splitlines()[-1]))


def play(played: Played) -> Loaded:
    """Start the node's estimator here, and play to it in steps."""
    host = Host.build(GRAPH.node(played.node), played.parameters)
    kernels = [o for o in gc.get_objects() if isinstance(o, Dispatcher)]
    known, modules = {id(k): len(k.overloads) for k in kernels}, set(sys.modules)
    now = played.entries[0][0]
    for stamp_ns, topic, record in played.entries:
        while stamp_ns > now:
            host.advance(now)
            now += STEP_NS
        host.put(topic, record)
    host.advance(now)
    host.health()
    late = [k.py_func.__qualname__ for k in kernels if len(k.overloads) > known[id(k)]]
    return Loaded(late, sorted(set(sys.modules) - modules), sorted(host.published))


def main() -> int:
    """Print what was new, as JSON."""
    played = pickle.loads(Path(sys.argv[1]).read_bytes())
    print(json.dumps(vars(play(played))))
    return 0


if __name__ == "__main__":
    sys.modules["fbn_testing.first_messages"] = sys.modules["__main__"]  # the pickle's name for it
    sys.exit(main())
