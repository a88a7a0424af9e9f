"""Parameters of the dead-reckoning filter."""

from __future__ import annotations

from dataclasses import dataclass

from fbn_common.motion_ekf.parameters import FilterParameters
from fbn_common.parameters import param


@dataclass(frozen=True, slots=True)
class DeadreckParameters(FilterParameters):
    """Parameters of ``fbn_deadreck``."""

    ping_delay: float = param(
        0.15, "s", "wait after a ping for data that is late, before the dead service answers", "sensor delays"
    )
    drift_time_constant: float = param(
        600.0, "s", "correlation time of the drift", "currents within a field; JOE 2013 II-B"
    )
    growth_horizon: float = param(
        30.0, "s", "over which the increments' white noise grows as the filter's own error", "a feature's time in view"
    )
    altitude_age: float = param(1.0, "s", "an altitude older than this is not passed on", "ten periods")
