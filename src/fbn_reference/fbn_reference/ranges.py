"""How ranges to beacons become measurements."""

from __future__ import annotations

from typing import Any

import numpy as np

from fbn_common.motion_ekf.intake import Intake
from fbn_common.motion_ekf.layout import BEACON_ROW, Kind
from fbn_common.motion_ekf.monitor import all_finite, content_of
from fbn_common.records import BeaconRange
from fbn_common.types import Array
from fbn_reference.parameters import LblParameters


def beacon_intakes(lbl: LblParameters) -> dict[str, Intake]:
    """An intake for each beacon, by its name."""
    return {name: _intake(lbl, index, name) for index, name in enumerate(lbl.beacons)}


def _intake(lbl: LblParameters, index: int, name: str) -> Intake:
    beacon = lbl.beacons[name]

    def data(record: Any) -> Array:
        variance = max(record.range_variance, lbl.sigma_min**2) + beacon.sigma**2
        return np.array([beacon.x, beacon.y, beacon.z, record.range, variance, 0.0, 0.0, 0.0])

    return Intake(f"lbl.{name}", lbl, Kind.RANGE, BEACON_ROW + index, data, lambda r: content_of(r.range))


def objection(record: BeaconRange, lbl: LblParameters) -> str:
    """Why this is no range that a beacon can have measured; empty if it may be."""
    if not all_finite(record.range, record.range_variance, record.travel_delay) or record.range_variance < 0.0:
        return "range, variance or delay is not finite, or negative variance"
    if not 0.0 < record.range <= lbl.max_range or not 0.0 <= record.travel_delay <= lbl.max_delay:
        return f"range {record.range:.1f} m or delay {record.travel_delay:.2f} s out of bounds"
    return ""
