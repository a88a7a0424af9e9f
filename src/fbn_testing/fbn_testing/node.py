"""A fake's node as a process: ``python -m fbn_testing.node --ros-args -r __node:=fbn_predict``."""

from __future__ import annotations

import sys

from fbn_ros.node import main_of
from fbn_testing.fakes import FAKE_GRAPH


def main() -> int:
    """Run the fake that the remapped node name asks for; the exit status."""
    name = next(a.removeprefix("__node:=") for a in sys.argv if a.startswith("__node:="))
    return main_of(name, FAKE_GRAPH)


if __name__ == "__main__":
    sys.exit(main())
