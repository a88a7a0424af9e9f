"""The mission: legs to go along, and the autopilot's settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common.parameters import ParameterError, group, param
from fbn_common.types import Array


@dataclass(frozen=True, slots=True)
class Leg:
    """A straight line from the end of the leg before to ``to``, or a hold (``to`` left out)."""

    to: tuple[float, float] | None = param(None, "m", "end of the line, map; none = hold the heading", "scenario")
    depth: float = param(0.0, "m", "to go at; 0 = on the surface", "scenario")
    speed: float = param(0.8, "m/s", "through the water, by the autopilot's own table", "Ranger, IROS 2007")
    seconds: float = param(0.0, "s", "how long to hold; for a line a limit, 0 = none", "scenario")

    def __post_init__(self) -> None:
        if self.to is None and self.seconds <= 0.0:
            raise ParameterError("a leg needs 'to' (where) or 'seconds' (how long to hold)")
        if self.depth < 0.0 or self.speed < 0.0 or self.seconds < 0.0:
            raise ParameterError("depth, speed and seconds must not be negative")


@dataclass(frozen=True, slots=True)
class Autopilot:
    """Gains of the vehicle's own controllers; it navigates by compass, propeller rate and GPS, never by truth."""

    heading_gain: float = param(1.0, "-", "steering angle over heading error", "tuned in simulation")
    heading_damping: float = param(1.2, "s", "steering angle over turn rate", "tuned in simulation")
    depth_gain: float = param(0.35, "rad/m", "pitch wanted over depth error", "tuned in simulation")
    depth_integral: float = param(0.012, "rad/(m s)", "the same over its integral", "tuned in simulation")
    pitch_gain: float = param(4.0, "-", "elevator angle over pitch error", "tuned in simulation")
    pitch_damping: float = param(2.0, "s", "elevator angle over pitch rate", "tuned in simulation")
    pitch_limit: float = param(0.26, "rad", "steepest pitch wanted", "15 deg")
    lookahead: float = param(12.0, "m", "distance ahead on the line to steer for", "assumed")
    reached: float = param(2.0, "m", "distance to go at which a line is done", "assumed")
    gps_gain: float = param(0.3, "-", "part of the difference to a GPS fix that is taken over", "assumed")


@dataclass(frozen=True, slots=True)
class Mission:
    """Where to start, and the legs in their order; map coordinates."""

    start: tuple[float, float] = param((0.0, 0.0), "m", "first position, map", "scenario")
    heading: float = param(0.0, "rad", "first heading, east = 0, north = pi/2", "scenario")
    limit: float = param(3600.0, "s", "the mission ends here at the latest", "scenario")
    autopilot: Autopilot = group(Autopilot)
    legs: dict[str, Leg] = group(dict)

    def __post_init__(self) -> None:
        if not self.legs:
            raise ParameterError("mission.legs: a mission needs at least one leg")

    def table(self, speed_per_rate: float) -> Array:
        """The legs (n, 6) as the kernel takes them: is a line, x, y [m], depth [m], propeller rate [rad/s], seconds."""
        rows = []
        for leg in self.legs.values():
            to = (0.0, 0.0) if leg.to is None else leg.to
            rows.append([float(leg.to is not None), *to, leg.depth, leg.speed / speed_per_rate, leg.seconds])
        return np.array(rows)
