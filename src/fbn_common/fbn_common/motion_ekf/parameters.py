"""Parameters that the dead-reckoning and the reference filter share: their sensors and their history."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common import chi_square
from fbn_common.motion_ekf.layout import SNAPSHOT_NS, Config, IntArray, Kind
from fbn_common.parameters import ParameterError, group, param
from fbn_common.types import Array

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """What every sensor has."""

    use: bool = param(True, "-", "whether the filter listens to it", "all sensors")
    gate: float = param(1e-4, "-", "probability with which a good measurement is gated", "one in 10,000")
    lockout: int = param(20, "-", "consistent outliers in a row after which the gate resets", "2 s at 10 Hz")
    dead_after: float = param(2.0, "s", "silence worth a warning; 0 = never", "20 periods at 10 Hz")
    frozen_after: int = param(20, "-", "equal values in a row that noise does not explain; 0 = never", "2 s at 10 Hz")

    def __post_init__(self) -> None:
        if not 0.0 < self.gate < 0.5 or self.lockout < 1:
            raise ParameterError("gate must be in (0, 0.5), lockout at least 1")


@dataclass(frozen=True, slots=True)
class CompassParameters(SensorParameters):
    """Three-axis compass: white noise, and an error that stays with time and heading."""

    white: float = param(0.12, "-", "share of the stated variance that is white", "0.5 deg of 1.5 deg, and a margin")
    sigma_min: float = param(0.004, "rad", "least standard deviation believed", "0.25 deg")
    sigma_unknown: float = param(0.035, "rad", "standard deviation where none is stated", "2 deg")
    deviation: float = param(0.026, "rad", "standard deviation of the deviation of yaw", "1.5 deg after calibration")
    hard_iron: float = param(
        0.5, "-", "share of its variance that turns once a circle", "2 of 3 of an uncompensated one"
    )
    soft_iron: float = param(
        0.2, "-", "share of its variance that turns twice a circle", "half of hard iron's amplitude"
    )
    tilt: float = param(0.0105, "rad", "standard deviation of the mount's tilt", "0.6 deg")
    time_constant: float = param(600.0, "s", "correlation time of the constant part of deviation", "warming up")
    iron_time_constant: float = param(1e5, "s", "correlation time of its parts by heading", "iron stays as it is")
    tilt_time_constant: float = param(1e5, "s", "correlation time of tilt", "a mount does not move")
    wave_acceleration: float = param(
        0.2, "m/s^2", "standard deviation at the surface, taken for gravity", "waves of 0.25 m, 3 s, damped in 0.5 s"
    )
    wave_depth: float = param(2.2, "m", "depth over which it falls by e", "waves of 3 s: g T^2 / (2 pi)^2")
    dip: float = param(
        1.18, "rad", "inclination of the earth's field: acceleration tilts the vertical and turns yaw", "68 deg"
    )


@dataclass(frozen=True, slots=True)
class DepthParameters(SensorParameters):
    """Pressure sensor."""

    sigma: float = param(0.03, "m", "standard deviation where no variance is stated", "0.1 % of 30 m")
    white: float = param(
        0.25, "-", "share of the stated variance that is white", "noise is half of the accuracy, at most"
    )
    sigma_min: float = param(0.005, "m", "least standard deviation believed", "resolution")
    bias: float = param(0.05, "m", "standard deviation of the offset: tide, air pressure, waves", "5 hPa")
    time_constant: float = param(3600.0, "s", "correlation time of the offset", "weather and tide")
    density: float = param(1012.0, "kg/m^3", "of the water", "between fresh water and sea")
    density_sigma: float = param(0.0125, "-", "its standard deviation, relative", "fresh water or sea")
    gravity: float = param(9.80665, "m/s^2", "gravity", "standard")
    surface_pressure: float = param(101325.0, "Pa", "at the surface", "standard atmosphere")
    max_depth: float = param(200.0, "m", "deeper readings are refused", "rating of small vehicles")
    position: Triple = param((0.0, 0.0, 0.0), "m", "of the sensor in base_link", "at the origin")


@dataclass(frozen=True, slots=True)
class AltimeterParameters(SensorParameters):
    """Altimeter, used for vertical speed: altitude against time, less what the bottom may do."""

    sigma: float = param(0.05, "m", "standard deviation of a range", "data sheet class")
    slope: float = param(0.1, "-", "standard deviation of the bottom's slope along the track", "gentle bed, stones")
    baseline: float = param(
        1.0, "s", "time between the two altitudes of a vertical speed", "noise against acceleration"
    )
    max_tilt: float = param(0.35, "rad", "no use beyond this tilt", "20 deg")


@dataclass(frozen=True, slots=True)
class SurfaceParameters:
    """What is different about motion at the surface only; reference estimates the layer, thrust lost is considered."""

    loss: float = param(0.03, "-", "standard deviation of the share of thrust lost", "as much as dynamics.surface_loss")
    depth: float = param(0.2, "m", "depth above which thrust is lost", "dynamics.surface_depth")
    layer: float = param(0.1, "m/s", "standard deviation of the top layer's own motion", "3 % of 3 to 4 m/s of wind")
    layer_depth: float = param(0.7, "m", "depth over which that falls by e", "wind-driven layer of sheltered water")
    layer_time_constant: float = param(600.0, "s", "its correlation time", "wind is called steady for ten minutes")


@dataclass(frozen=True, slots=True)
class HistoryParameters:
    """How late data may be, and what happens to clocks."""

    length: float = param(6.0, "s", "for how long late data is worked in", "5 s of delay, and a margin")
    ahead: float = param(1.0, "s", "a stamp farther ahead of the clock is refused", "clocks on one vehicle agree")
    patience: float = param(1.0, "s", "for how long a missing motion is waited for", "several lost messages")
    max_gap: float = param(10.0, "s", "a longer gap in the motions starts the filter anew", "ring of 20 s")
    start_timeout: float = param(5.0, "s", "start without depth after so long", "assumed")
    drift_speed: float = param(1.0, "m/s", "speed assumed over a gap without motions", "vehicle or current")

    def __post_init__(self) -> None:
        if not 1.0 <= self.length <= 12.0:
            raise ParameterError("history.length must be 1 to 12 s")


@dataclass(frozen=True, slots=True)
class WalkParameters:
    """How fast the vehicle's parameters may change: standard deviation after an hour, and where it ends."""

    angular_actuation: float = param(0.1, "rad/s^2", "per root hour", "a servo horn slips, a trim changes")
    damping: float = param(0.02, "-", "relative to 0.27 and 1.5 1/s, per root hour", "a hull stays as it is")
    thrust: float = param(0.003, "m/s^2", "per root hour", "1.5 % of terminal speed: battery, growth")
    water: float = param(0.01, "m/s", "per root hour, east and north, in still water", "seiches, density")
    water_share: float = param(
        0.25, "-", "the same over the water's own speed, in addition", "tide of 12.4 h: its change in a quarter of one"
    )
    water_limit: float = param(0.5, "m/s", "standard deviation at which the water's walk ends", "coastal")
    wander: float = param(
        0.2, "-", "standard deviation about that, over the water's own speed", "tidal channels and their eddies"
    )
    wander_time: float = param(900.0, "s", "its correlation time", "basins and large eddies: a quarter of an hour")


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Parameters that both filters have."""

    compass: CompassParameters = group(CompassParameters)
    depth: DepthParameters = group(DepthParameters)
    altimeter: AltimeterParameters = group(AltimeterParameters)
    walk: WalkParameters = group(WalkParameters)
    surface: SurfaceParameters = group(SurfaceParameters)
    history: HistoryParameters = group(HistoryParameters)


def considered(compass: CompassParameters, depth: DepthParameters, surface: SurfaceParameters) -> tuple[Array, Array]:
    """Correlation times [s] and stationary variances (15,) of the states from OWN on, the fix's own left at 1."""
    once, twice = compass.hard_iron, compass.soft_iron
    shares = np.array([1.0 - once - twice, once, once, twice, twice])  # sine and cosine together make a share
    tau = [compass.time_constant] + [compass.iron_time_constant] * 4 + [np.inf] * 2 + [surface.layer_time_constant] * 2
    tau += [1e5] + [compass.tilt_time_constant] * 2 + [depth.time_constant, 1.0, 1.0]
    variance = [*(shares * compass.deviation**2)] + [0.0] * 2 + [surface.layer**2] * 2  # steady water: of the prior
    variance += [surface.loss**2] + [compass.tilt**2] * 2 + [depth.bias**2, 1.0, 1.0]
    return np.array(tau), np.maximum(variance, 1e-10)  # one switched off stays invertible


def quantile_table(probabilities: dict[Kind, float]) -> Array:
    """NIS gates (4, kinds) by degrees of freedom, from the probability to gate a good measurement."""
    table = np.full((4, len(Kind)), np.inf)
    for kind, probability in probabilities.items():
        table[1:, kind] = [chi_square.bound_of_tail(probability, dof) for dof in (1, 2, 3)]
    return table


def walk_densities(walk: WalkParameters) -> tuple[Array, Array]:
    """Power spectral densities (15,) of the parameters' walks, and the variances (15,) where they stop."""
    sigma = np.array(
        [walk.angular_actuation] * 3
        + [walk.damping * 0.27] * 3
        + [walk.damping * 1.5] * 3
        + [walk.thrust] * 3
        + [walk.water, walk.water, walk.water / 30.0]
    )
    limit = np.array([1.0] * 3 + [0.3] * 3 + [2.0] * 3 + [0.3] * 3 + [walk.water_limit] * 2 + [walk.water_limit / 30.0])
    return sigma**2 / 3600.0, limit**2


def config_of(p: FilterParameters, sensors: dict[Kind, SensorParameters], estimated: int, corrects: IntArray) -> Config:
    """The kernels' numbers for these sensors; what concerns positions alone is left at values without effect."""
    walk, limit = walk_densities(p.walk)
    tau, variance = considered(p.compass, p.depth, p.surface)
    lockout, lever = np.full(len(Kind), 1e18), np.zeros((len(Kind), 3))
    for kind, sensor in sensors.items():
        lockout[kind] = sensor.lockout
    lever[Kind.DEPTH] = p.depth.position
    gate = quantile_table({kind: sensor.gate for kind, sensor in sensors.items()})
    return Config(
        estimated, corrects, SNAPSHOT_NS, walk, limit, p.walk.water_share**2 / 3600.0,
        p.walk.wander**2, p.walk.wander_time, tau, variance,
        p.compass.dip, p.compass.wave_acceleration, p.compass.wave_depth, p.surface.depth, p.surface.layer_depth,
        p.depth.density_sigma / p.depth.bias, gate, lockout, lever, 1.0, 1.0, 1.0, True, 60.0,
    )  # fmt: skip
