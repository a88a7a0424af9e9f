"""Between geodetic coordinates (WGS 84: degrees, metres) and the ENU axes about a datum, by pymap3d."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymap3d

from fbn_common.parameters import ParameterError, param
from fbn_common.types import Array, Vec3


@dataclass(frozen=True, slots=True)
class GeodeticPoint:
    """A point on the globe; as a datum it is the origin of ``map``."""

    latitude: float = param(0.0, "deg", "north positive", "WGS 84")
    longitude: float = param(0.0, "deg", "east positive", "WGS 84")
    height: float = param(0.0, "m", "over the ellipsoid", "the water's surface")

    def __post_init__(self) -> None:
        if not (abs(self.latitude) <= 90.0 and abs(self.longitude) <= 360.0 and abs(self.height) < 1e5):
            raise ParameterError(f"not a point on the globe: {self}")


def enu_from_geodetic(latitude: float, longitude: float, height: float, datum: GeodeticPoint) -> Vec3:
    """East, north, up (3,) [m] of a point [deg, deg, m] about the datum."""
    enu = pymap3d.geodetic2enu(latitude, longitude, height, datum.latitude, datum.longitude, datum.height)
    return np.array([float(c) for c in enu])


def geodetic_from_enu(enu: Vec3, datum: GeodeticPoint) -> GeodeticPoint:
    """The point on the globe of east, north, up (3,) [m] about the datum."""
    return GeodeticPoint(*(float(c) for c in geodetic_array_from_enu(enu[None, :], datum)[0]))


def geodetic_array_from_enu(enu: Array, datum: GeodeticPoint) -> Array:
    """Latitude, longitude, height (n, 3) [deg, deg, m] of east, north, up (n, 3) [m] about the datum."""
    point = (datum.latitude, datum.longitude, datum.height)
    return np.stack(pymap3d.enu2geodetic(enu[:, 0], enu[:, 1], enu[:, 2], *point), axis=1)
