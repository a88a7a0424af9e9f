"""Every number of the global filter, with its unit and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from fbn_common.parameters import ParameterError, group, param

METHODS: Final = ("NAPS", "POS", "JCBB")


@dataclass(frozen=True, slots=True)
class PriorMapParameters:
    """How good the prior map is, where its file does not say."""

    sigma: float = param(5.0, "m", "absolute error of a feature, per horizontal axis", "JOE 2013 II: typically 5 m")
    length: float = param(1000.0, "m", "distance at which two features' errors are half independent", "1 m at 20 m")
    own_sigma: float = param(0.5, "m", "part of a feature's error that no neighbour shares", "reading off a mosaic")
    up_sigma: float = param(1.0, "m", "error of a feature's height", "altimeter of the survey")
    up_common: float = param(1.0, "m", "error of height that all features share", "tide")
    unknown_up: float = param(-10.0, "m", "height of a feature whose height the map omits", "shallow water")
    unknown_up_sigma: float = param(10.0, "m", "its error", "surface to twice that depth")
    visibility: float = param(0.67, "-", "detections per scan", "two of three scans, JOE 2013 III-B")
    existence: float = param(0.85, "-", "chance that a feature of the map is there", "maps miss and add up to 20 %")

    def __post_init__(self) -> None:
        if min(self.sigma, self.length, self.own_sigma, self.up_sigma, self.unknown_up_sigma) <= 0.0:
            raise ParameterError("sigma, length, own_sigma, up_sigma and unknown_up_sigma must be positive")
        if not (0.0 < self.visibility < 1.0 and 0.0 < self.existence < 1.0):
            raise ParameterError("visibility and existence must lie between 0 and 1")


@dataclass(frozen=True, slots=True)
class ScoringParameters:
    """What makes a hypothesis more likely than the null hypothesis."""

    surplus_count: float = param(1.0, "-", "found features off the map: prior count", "gamma prior of their density")
    surplus_area: float = param(1000.0, "m^2", "found features off the map: area of that count", "1 in 32 m x 32 m")
    surplus_clustering: float = param(
        3.0, "-", "features off the map: how much denser in fields than over all the sweep", "reliability study"
    )
    height_span: float = param(
        5.0, "m", "range of heights over which features off the map lie", "on one bed, as others"
    )
    promotion_detections: int = param(7, "-", "detections that make a feature", "7 to 10, IROS 2007 V")
    visibility_weight: float = param(10.0, "-", "scans that the prior visibility counts for", "one pass")
    missed_floor: float = param(
        0.05, "-", "chance to miss a feature for causes not modelled", "occlusion, merged echoes"
    )
    prior_match: float = param(0.5, "-", "chance before any evidence that the map fits", "even odds")

    def __post_init__(self) -> None:
        if min(self.surplus_count, self.surplus_area, self.height_span, self.visibility_weight) <= 0.0:
            raise ParameterError("surplus_count, surplus_area, height_span and visibility_weight must be positive")
        if self.surplus_clustering < 1.0:
            raise ParameterError("surplus_clustering is at least 1")
        if not (0.0 < self.missed_floor < 1.0 and 0.0 < self.prior_match < 1.0 and self.promotion_detections >= 1):
            raise ParameterError("missed_floor and prior_match lie between 0 and 1, promotion_detections is at least 1")


@dataclass(frozen=True, slots=True)
class MatchingParameters:
    """Which pairs may be the same object."""

    gate_sigma: float = param(4.0, "-", "gate of a pair, in standard deviations", "misses 1 in 1000 in 3-D")
    object_sigma: float = param(0.5, "m", "size of an object, horizontal", "less than 1 m across, JOE 2013 II")
    object_up_sigma: float = param(1.0, "m", "the same, vertical", "moored objects; lobe half above, half below")
    key_sigma: float = param(0.05, "m", "how well a key's feature keeps its place between composites", "one object")
    single_sigma: float = param(
        2.0, "m", "two found features this well known to each other may merge alone", "spacing 20 m"
    )
    tight_sigma: float = param(2.0, "m", "pairs of a local patch know their distance this well", "spacing 20 m")
    anchors: int = param(400, "-", "pairs tried as the seed of a hypothesis, most supported first", "0.3 s an update")
    jcbb_nodes: int = param(200_000, "-", "most nodes of the branch and bound", "0.05 s")

    def __post_init__(self) -> None:
        if min(self.gate_sigma, self.object_sigma, self.object_up_sigma, self.key_sigma) <= 0.0:
            raise ParameterError("gate_sigma, object_sigma, object_up_sigma and key_sigma must be positive")


@dataclass(frozen=True, slots=True)
class BankParameters:
    """How many hypotheses live, and what is remembered."""

    hypotheses: int = param(30, "-", "most hypotheses kept, beside the null", "0.3 s an update")
    keep_log_ratio: float = param(12.0, "-", "kept down to this below the best, in log score", "6e-6")
    features: int = param(60, "-", "most found features in a state; the longest unseen go first", "0.3 s an update")
    origins: int = param(40, "-", "composites whose swept area is remembered", "10 min of 15 s composites")
    reach: float = param(15.0, "m", "map features this far around the swept area are in the state", "three map sigmas")


@dataclass(frozen=True, slots=True)
class VerdictParameters:
    """When the vehicle counts as matched."""

    match_posterior: float = param(0.99, "-", "declare a match above", "1 in 100 may be wrong")
    null_posterior: float = param(
        5e-3, "-", "only while nothing-matched is below", "1 in 200 wrong, however often one looks (Ville 1939)"
    )
    keep_posterior: float = param(0.5, "-", "keep it above", "likelier than not; what it is now is told with it")
    hold_updates: int = param(
        1, "-", "composites for which it must stay so", "one lasts 30 s: the posterior is proof enough"
    )
    min_features: int = param(3, "-", "map features matched, at least", "two fix a shift, the third confirms")
    ambiguous_posterior: float = param(0.1, "-", "a mode counts as an alternative above", "1 in 10")
    mode_radius: float = param(
        5.0, "m", "hypotheses that put the vehicle this near together are one mode", "spacing 20 m"
    )
    lost_sigma: float = param(
        10.0, "m", "a match is lost when the vehicle is known on the map no better", "spacing 20 m"
    )


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """Dead reckoning between composites and now."""

    drift_sigma: float = param(0.2, "m/s", "drift before any composite, each of three", "coastal current")
    drift_time_constant: float = param(600.0, "s", "its correlation time before any composite", "tidal eddies")
    noise: float = param(0.02, "m^2/s", "growth of xy variance beside the drift", "0.5 m in 10 s")
    start_sigma: float = param(1.0e4, "m", "xy before the first fix", "anywhere")
    history_s: float = param(300.0, "s", "odometry remembered", "longest composite, and its delay")
    wait_s: float = param(2.0, "s", "a fix waits this long for the odometry of its time", "sensor delays")
    composite_gate: float = param(1e-6, "-", "a composite less probable than this is bridged", "never by chance")
    speed_limit: float = param(5.0, "m/s", "a dead-reckoned jump faster than this is a restart of odometry", "AUVs")


@dataclass(frozen=True, slots=True)
class GlobalParameters:
    """The global filter."""

    map_file: str = param("", "-", "prior map, GeoJSON; empty: none", "mission")
    datum: list[float] = param(
        [], "deg deg m", "origin of map: latitude, longitude, height; empty: reference/datum", "mission"
    )
    state_file: str = param("", "-", "the state is kept here over restarts; empty: nowhere", "mission")
    state_age_s: float = param(3600.0, "s", "a state saved longer ago than this is not used", "the tide turns")
    state_speed: float = param(1.0, "m/s", "how fast the vehicle may have gone since it was saved", "cruising speed")
    method: str = param("NAPS", "-", "NAPS, or POS (no negative information) or JCBB for comparison", "JOE 2013 V")
    status_period_s: float = param(1.0, "s", "global/status at least this often", "homing steers at 1 Hz")
    prior: PriorMapParameters = group(PriorMapParameters)
    scoring: ScoringParameters = group(ScoringParameters)
    matching: MatchingParameters = group(MatchingParameters)
    bank: BankParameters = group(BankParameters)
    verdict: VerdictParameters = group(VerdictParameters)
    motion: MotionParameters = group(MotionParameters)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ParameterError(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")
        if len(self.datum) not in (0, 3):
            raise ParameterError("datum must be latitude, longitude, height, or empty")
