"""Parameters of the tracking filter: the only home of their defaults, units and origins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

from fbn_common.parameters import ParameterError, group, param
from fbn_common.sonar import SonarArray
from fbn_common.sonar_file import SonarHead, with_sonar_file

_QUARTER_LOOK = 0.19635  # rad, 11.25 deg


def blazed_array_pair() -> dict[str, SonarArray]:
    """The two arrays of a 45 deg blazed-array sonar: each sees 22.5 deg, one to the left, one to the right."""
    low, high = pi / 2 - _QUARTER_LOOK, pi / 2 + _QUARTER_LOOK
    return {
        "sonar_left": SonarArray(mount_rpy=(0.0, 0.0, _QUARTER_LOOK), bearing_min=low, bearing_max=high),
        "sonar_right": SonarArray(mount_rpy=(0.0, 0.0, -_QUARTER_LOOK), bearing_min=low, bearing_max=high),
    }


@dataclass(frozen=True, slots=True)
class FeatureParameters:
    """How a feature's elevation, known to the width of the lobe alone, is modelled."""

    elevation: str = param(
        "cubic", "-", "error of the angle around the axis: cubic or linear", "cubic: IROS 2007, eq. 6"
    )
    alpha: float = param(
        2e-3, "rad^2", "slope of the cubic at the middle of the lobe", "1e-3 to 3e-3 converge best in trials"
    )
    weak_theta_sigma: float = param(
        0.35, "rad", "loose bound on theta at the first detection", "two half lobes: damps only"
    )
    floor_margin: float = param(0.7, "m", "how far below the altimeter's floor an object may seem", "slope of the bed")
    surface_margin: float = param(0.3, "m", "how far above the surface an object may seem", "waves")
    below_odds: float = param(
        2.0, "-", "odds that an object lies below the array, where no altimeter tells of the floor", "bottom targets"
    )
    height_scale: float = param(
        1.5, "m", "half of all objects stand no higher over the floor; Cauchy beyond", "bottom targets, some moored"
    )
    mode_gap: float = param(4.6, "-", "log odds at which the unlikelier elevation is dropped", "1 in 100")

    def __post_init__(self) -> None:
        if self.elevation not in ("cubic", "linear"):
            raise ParameterError(f"feature.elevation: expected cubic or linear, got {self.elevation!r}")
        if min(self.alpha, self.weak_theta_sigma, self.below_odds, self.height_scale) <= 0.0:
            raise ParameterError("feature.alpha, weak_theta_sigma, below_odds and height_scale must be positive")


@dataclass(frozen=True, slots=True)
class InfantParameters:
    """When an infant is matched, deleted, graduated."""

    lifetime: float = param(10.0, "s", "an infant unmatched for so long dies", "IROS 2007 V")
    clutter: float = param(5.0, "-", "false detections expected per array and ping", "assumed: five a ping")
    detections: int = param(7, "-", "least detections to graduate", "7 to 10 in practice, JOE 2013 IV-B")
    detections_at_end: int = param(
        5, "-", "the same when it has left the view: more will not come", "half of ten looks are seen at 35 m"
    )
    sigma_horizontal: float = param(
        0.5, "m", "largest horizontal sigma at graduation", "a fraction of the target spacing"
    )
    sigma_vertical: float = param(7.0, "m", "largest vertical sigma at graduation", "half lobe of 10 deg at 40 m")
    score: float = param(10.0, "-", "least log-likelihood ratio of target to clutter", "1 false in 22,000 candidates")
    static_probability: float = param(0.999, "-", "a static target passes the static-world test so often", "chi-square")
    still_probability: float = param(0.99, "-", "a static target passes the motion check so often", "chi-square")
    patience: int = param(
        4, "-", "detections waited for more when both elevations are still likely", "half of detections"
    )
    limit: int = param(300, "-", "most infants kept per window", "bounded time")


@dataclass(frozen=True, slots=True)
class CompositeParameters:
    """When the old part of the window is cut off."""

    pings: int = param(15, "-", "poses wanted in a composite", "half of the 30 of IROS 2007 V: matched sooner")
    wait_pings: int = param(15, "-", "poses waited for more until a feature leaves the view", "about 30 nodes in all")
    window: int = param(90, "-", "most poses in the window", "bounded time")
    max_gap: float = param(30.0, "s", "a longer pause of the sonar starts a new chain", "drift is no constant over it")
    cell_size: float = param(1.0, "m", "cell of the swept area", "a fraction of the map's relative error")


@dataclass(frozen=True, slots=True)
class TrackingParameters:
    """Everything the tracking filter can be told."""

    head: SonarHead = group(SonarHead)
    arrays: dict[str, SonarArray] = group(blazed_array_pair)
    feature: FeatureParameters = group(FeatureParameters)
    infant: InfantParameters = group(InfantParameters)
    composite: CompositeParameters = group(CompositeParameters)
    gate: float = param(0.997, "-", "probability that a true match passes its gate", "chi-square, 3 dof")
    max_detections: int = param(40, "-", "strongest detections kept per array and ping", "bounded time")
    retire: float = param(10.0, "s", "a feature unseen for so long is retired", "as infants")
    ping_wait: float = param(
        3.0, "s", "detections wait so long for their ping's motion", "late merges of 0.5 s, and reserve"
    )
    link_wait: float = param(1.0, "s", "a ping whose predecessor is missing waits so long for it", "as ping_wait")

    @staticmethod
    def prepared(values: Mapping[str, Any]) -> Mapping[str, Any]:
        """With the arrays of the sonar file that ``head.sonar`` names."""
        return with_sonar_file(values)

    def __post_init__(self) -> None:
        if not self.arrays:
            raise ParameterError("arrays: at least one sonar array is needed")
        if not 0.0 < self.gate < 1.0:
            raise ParameterError("gate: a probability between 0 and 1")
        if self.composite.window < 2 * self.composite.pings:
            raise ParameterError("composite.window must be at least twice composite.pings")
