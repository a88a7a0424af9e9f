"""Made-up fixes and ranges, to be played before the first real ones."""

from __future__ import annotations

import numpy as np

from fbn_common.records import BeaconRange, NavSatFix, Record
from fbn_reference.parameters import Beacon, LblParameters, ReferenceParameters

_BEACONS = {"east": Beacon(x=100.0), "north": Beacon(y=100.0), "south": Beacon(x=50.0, y=-80.0)}
PARAMETERS = ReferenceParameters(lbl=LblParameters(beacons=_BEACONS))


def position_records(stamp_ns: int) -> list[tuple[str, Record]]:
    """A range to each beacon and a fix, all of the datum; readings do not repeat, so that none is frozen."""
    trifle = stamp_ns * 1e-15
    ranges: list[tuple[str, Record]] = [
        ("lbl/range", BeaconRange(stamp_ns, "", name, float(np.hypot(b.x, b.y)) + trifle, 0.1, 0.0))
        for name, b in _BEACONS.items()
    ]
    return [*ranges, ("gps/fix", NavSatFix(stamp_ns, "", 0, trifle, 0.0, 0.0, 4.0 * np.eye(3), 2))]
