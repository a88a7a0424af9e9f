"""Parameters of the reference filter."""

from __future__ import annotations

from dataclasses import dataclass

from fbn_common.geodesy import GeodeticPoint
from fbn_common.motion_ekf.parameters import FilterParameters, SensorParameters
from fbn_common.parameters import ParameterError, group, param

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class GpsParameters(SensorParameters):
    """GPS: most of its error stays for minutes."""

    rule: bool = param(True, "-", "use a fix only if it is better than the filter's own position", "ISRR 2007 6")
    white: float = param(
        0.06,
        "-",
        "least share of the stated variance that is independent from fix to fix",
        "0.4 m of 1.9 m, and a margin",
    )
    correlated: float = param(1.8, "m", "standard deviation, at most, of the part that is not", "ionosphere, orbits")
    time_constant: float = param(240.0, "s", "correlation time of the rest", "ionosphere, orbits: minutes")
    sigma_min: float = param(1.0, "m", "least standard deviation believed", "autonomous receiver")
    sigma_max: float = param(30.0, "m", "a fix worse than this is refused", "assumed")
    surface_depth: float = param(1.0, "m", "a fix from deeper than this is refused", "no reception under water")
    position: Triple = param((-0.3, 0.0, 0.35), "m", "of the antenna in base_link", "Ranger: mast aft")
    lockout: int = param(
        20, "-", "consistent outliers in a row after which the gate resets", "20 s: multipath lasts for seconds"
    )
    dead_after: float = param(0.0, "s", "silence worth a warning; 0 = never", "no GPS under water")
    frozen_after: int = param(10, "-", "equal values in a row that noise does not explain; 0 = never", "10 s at 1 Hz")


@dataclass(frozen=True, slots=True)
class Beacon:
    """One acoustic beacon."""

    x: float = param(0.0, "m", "east of the datum", "survey")
    y: float = param(0.0, "m", "north of the datum", "survey")
    z: float = param(0.0, "m", "up from the surface", "survey")
    sigma: float = param(0.5, "m", "standard deviation of its position, along a range", "survey")


@dataclass(frozen=True, slots=True)
class LblParameters(SensorParameters):
    """Acoustic ranges."""

    beacons: dict[str, Beacon] = group(dict)
    sigma_min: float = param(0.3, "m", "least standard deviation believed", "speed of sound, mounting")
    max_range: float = param(2000.0, "m", "a longer range is refused", "acoustics of small beacons")
    max_delay: float = param(5.0, "s", "a longer round trip is refused", "max_range")
    drop: float = param(60.0, "s", "for how long a beacon that lies is not listened to", "assumed")
    hold: float = param(
        5.0, "s", "for how long ranges wait for others while the position is uncertain; 0 = not", "a round of replies"
    )
    uncertain: float = param(
        3.0,
        "-",
        "predicted range's deviation over the range's own beyond which they wait",
        "lies of 12 sigma pass the gate",
    )
    margin: float = param(9.2, "-", "chi-square by which one set of beacons must beat another", "odds of 100 to 1")
    belief: float = param(60.0, "s", "used so lately, a beacon's ranges need not wait", "as drop")
    position: Triple = param((0.0, 0.0, 0.0), "m", "of the transducer in base_link", "at the origin")
    lockout: int = param(5, "-", "consistent outliers in a row after which a beacon is dropped", "5 replies")
    dead_after: float = param(0.0, "s", "silence worth a warning; 0 = never", "beacons come and go")
    frozen_after: int = param(
        4,
        "-",
        "equal ranges in a row that noise does not explain; 0 = never",
        "at rest 0.1 m of resolution repeats 0.3 m of noise at odds of 0.09: four times, 8e-5",
    )

    def __post_init__(self) -> None:
        SensorParameters.__post_init__(self)
        if self.hold < 0.0 or self.uncertain < 0.0 or self.margin < 0.0:
            raise ParameterError("lbl.hold, lbl.uncertain and lbl.margin must not be negative")


@dataclass(frozen=True, slots=True)
class MapParameters:
    """Where ``map`` is, and where the vehicle is in it at the start."""

    datum_given: bool = param(False, "-", "take the datum from here; else it is the first good fix", "mission")
    datum: GeodeticPoint = group(GeodeticPoint)
    start_x: float = param(0.0, "m", "east of the datum, at the start", "mission")
    start_y: float = param(0.0, "m", "north of the datum, at the start", "mission")
    start_sigma: float = param(1000.0, "m", "standard deviation of that; 1 km says unknown", "no fix yet")

    def __post_init__(self) -> None:
        if self.start_sigma <= 0.0:
            raise ParameterError("start_sigma must be positive")


@dataclass(frozen=True, slots=True)
class ReferenceParameters(FilterParameters):
    """Parameters of ``fbn_reference``."""

    gps: GpsParameters = group(GpsParameters)
    lbl: LblParameters = group(LblParameters)
    map: MapParameters = group(MapParameters)
    parameters_period: float = param(1.0, "s", "between two messages of parameters", "ISRR 2007 4: slow")
    fix_period: float = param(1.0, "s", "least time between two reference fixes", "GPS at 1 Hz")
    fix_delay: float = param(0.3, "s", "wait after a measurement of position for data that is late", "sensor delays")
    fix_gain: float = param(0.1, "-", "least relative decrease of a variance that is worth a reference fix", "assumed")
    known_sigma: float = param(200.0, "m", "position is said to be known below this", "a fifth of unknown")

    def __post_init__(self) -> None:
        if self.lbl.hold > self.history.length - 1.0:
            raise ParameterError("lbl.hold must be at least 1 s shorter than history.length: what waited comes late")
