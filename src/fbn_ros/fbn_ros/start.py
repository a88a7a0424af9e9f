"""A node's start: what it needs is imported without what only makes that slow.

The garbage collector would look at every function of numpy, scipy and numba again and again while more are made, and
find nothing: a tenth of the time until the node is ready.  And numba asks for ``coverage``, for the sake of tests,
wherever it is installed; that takes SQLite and 40 modules along.
"""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def main_of(name: str) -> int:
    """Run the node of this name; the exit status."""
    with _quick_imports():
        from fbn_common.graph import GRAPH
        from fbn_ros import node

        importlib.import_module(GRAPH.node(name).estimator.partition(":")[0])
    return node.main_of(name)


@contextmanager
def _quick_imports() -> Iterator[None]:
    """No collection meanwhile, nor ever of what is imported; no ``coverage`` unless it is at work already."""
    gc.disable()
    withheld = sys.modules.setdefault("coverage", None) is None  # type: ignore[arg-type]
    try:
        yield
        gc.freeze()
    finally:
        if withheld:
            del sys.modules["coverage"]
        gc.enable()
