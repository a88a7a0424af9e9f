"""Units that column logs use, and what they are in SI."""

from __future__ import annotations

import difflib
import math

from fbn_common.parameters import ParameterError

_INCH_OF_WATER = 249.0889  # Pa

UNITS: dict[str, tuple[str, float]] = {  # name: (dimension, SI units in one of it)
    "-": ("number", 1.0),
    "%": ("number", 0.01),
    "m": ("length", 1.0),
    "cm": ("length", 0.01),
    "mm": ("length", 0.001),
    "km": ("length", 1000.0),
    "ft": ("length", 0.3048),
    "fathom": ("length", 1.8288),
    "nmi": ("length", 1852.0),
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180.0),
    "m/s": ("speed", 1.0),
    "km/h": ("speed", 1.0 / 3.6),
    "kn": ("speed", 1852.0 / 3600.0),
    "ft/s": ("speed", 0.3048),
    "m/s^2": ("acceleration", 1.0),
    "g": ("acceleration", 9.80665),
    "rad/s": ("turn rate", 1.0),
    "deg/s": ("turn rate", math.pi / 180.0),
    "rpm": ("turn rate", math.pi / 30.0),
    "Hz": ("turn rate", 2.0 * math.pi),
    "Pa": ("pressure", 1.0),
    "hPa": ("pressure", 100.0),
    "mbar": ("pressure", 100.0),
    "kPa": ("pressure", 1000.0),
    "dbar": ("pressure", 1e4),
    "bar": ("pressure", 1e5),
    "psi": ("pressure", 6894.757293168),
    "inH2O": ("pressure", _INCH_OF_WATER),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
}


def factor(unit: str, *dimensions: str) -> float:
    """SI units in one of ``unit``, which must be of one of these dimensions; ParameterError says which would be."""
    fitting = [name for name, (kind, _) in UNITS.items() if kind in dimensions]
    if unit not in fitting:
        near = difflib.get_close_matches(unit, fitting, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are: {', '.join(fitting)}"
        raise ParameterError(f"unit {unit!r} is not one of {' or '.join(dimensions)}; {hint}")
    return UNITS[unit][1]
