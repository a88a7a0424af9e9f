"""The nodes' lines on a terminal."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence


class Console:
    """Prints the processes' lines with their names in front, coloured on a terminal."""

    COLOURS = (36, 32, 33, 35, 34, 96, 92, 93)

    def __init__(self, names: Sequence[str]) -> None:
        self._width = max((len(n) for n in names), default=0)
        self._codes = {name: self.COLOURS[i % len(self.COLOURS)] for i, name in enumerate(names)}
        self._colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
        self._lock = threading.Lock()

    def __call__(self, name: str, line: str) -> None:
        label = f"{name:<{self._width}} |"
        if self._colour:
            label = f"\x1b[{self._codes.get(name, 37)}m{label}\x1b[0m"
        with self._lock:
            print(f"{label} {line}", flush=True)
