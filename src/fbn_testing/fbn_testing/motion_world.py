"""A simulated world that is as uncertain as the front half's parameters say.

The scenarios' instruments and waters are better than a vehicle may count on; there, an estimate that is right about
what it was told looks cautious.  Here what is stated is so, and NEES shows the filters alone.
"""

from __future__ import annotations

import math

from fbn_reference.parameters import ReferenceParameters

STILL = 0.001  # m/s, for a mean of zero: what varies in the simulator's water varies by shares of its mean speed


def as_stated(current: float) -> dict[str, float]:
    """Overrides of a scenario whose water has this mean speed [m/s], by the defaults of the reference filter.

    Compass: deviation by heading with amplitudes drawn evenly from nought to the square root of 3 times their rms, a
    constant part that drifts, a tilted mount.  GPS: its slow part.  Water: its walk, its wandering, a top layer.  The
    rest stays as the simulator has it.
    """
    p = ReferenceParameters()
    once, twice = p.compass.hard_iron, p.compass.soft_iron
    constant = (1.0 - once - twice) * p.compass.deviation**2
    mean = max(current, STILL)
    component = mean / math.sqrt(2.0)  # rms, of east and north each
    return {
        "sea.current_speed_min": mean,
        "sea.current_speed_max": mean,
        "sea.current_walk": math.hypot(p.walk.water, p.walk.water_share * component),
        "sea.current_variation": p.walk.wander * component / mean,
        "sea.current_time_constant": p.walk.wander_time,
        "sea.wind_fraction": p.surface.layer / mean,
        "sensors.gps.slow_sigma": p.gps.correlated,
        "sensors.gps.slow_time_constant": p.gps.time_constant,
        "sensors.compass.hard_iron_min": 0.0,
        "sensors.compass.hard_iron_max": math.sqrt(6.0 * once) * p.compass.deviation,
        "sensors.compass.soft_iron_min": 0.0,
        "sensors.compass.soft_iron_max": math.sqrt(6.0 * twice) * p.compass.deviation,
        "sensors.compass.mount_sigma": p.compass.tilt,
        "sensors.compass.drift_sigma": math.sqrt(max(constant - p.compass.tilt**2, 0.0)),
        "sensors.compass.drift_time_constant": p.compass.time_constant,
    }
