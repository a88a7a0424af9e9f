"""One look for all pictures: a colour and a name per estimate, colour-blind safe (Okabe and Ito)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

INK: Final = "#1f2933"
MUTED: Final = "#7b8794"
GRID: Final = "#e4e7eb"
DIVE: Final = "#eef4fa"  # behind the times under water
FONT: Final = "Inter, 'Segoe UI', 'Helvetica Neue', Helvetica, Arial, sans-serif"


@dataclass(frozen=True, slots=True)
class Look:
    """How one thing is drawn everywhere."""

    name: str
    colour: str
    width: float = 1.8
    dash: str = "solid"


TRUTH: Final = Look("truth", "#1f2933", 1.4)
DEADRECK: Final = Look("dead-reckoned", "#e69f00", 1.6)
REFERENCE: Final = Look("reference (GPS, no map)", "#0072b2", 1.6)
GLOBAL: Final = Look("global (on the map)", "#009e73", 2.0)
PRIOR: Final = Look("prior map", "#7b8794")
ESTIMATED: Final = Look("estimated map", "#009e73")
TRUE_FEATURE: Final = Look("true features", "#1f2933")
TARGET: Final = Look("target", "#d55e00")
GPS: Final = Look("GPS fixes", "#56b4e9")
TRACKED: Final = Look("tracked features", "#cc79a7")
PLACE: Final = Look("the place, as stated", "#1f2933", 2.0)

LOOKS: Final = {
    "truth/odometry": TRUTH,
    "deadreck/odometry": DEADRECK,
    "reference/odometry": REFERENCE,
    "global/odometry": GLOBAL,
    "on the map": GLOBAL,
}
VERDICTS: Final = {"USED": "#0072b2", "GATED": "#e69f00", "REFUSED": "#d55e00", "LATE": "#cc79a7"}
CYCLE: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#7b8794", "#b5a400")


def faded(colour: str, opacity: float) -> str:
    """A colour ``#rrggbb`` as rgba with this opacity."""
    r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{opacity:g})"
