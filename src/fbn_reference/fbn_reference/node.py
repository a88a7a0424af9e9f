"""The ``fbn_reference`` node; everything about it is declared in ``fbn_common.graph``."""

from __future__ import annotations

import sys

from fbn_ros.start import main_of


def main() -> int:
    """Run the node until it is told to stop; the exit status."""
    return main_of("fbn_reference")


if __name__ == "__main__":
    sys.exit(main())
