"""A vehicle with its sonar in a sea, and which terms of its motion the sonar shows."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import asin, inf, radians, sin, sqrt
from pathlib import Path

from fbn_bringup.configuration import load_parameters
from fbn_common.graph import GRAPH
from fbn_common.observability import QUARTER, Motion, Wave, numbers, thresholds
from fbn_common.parameters import ParameterError
from fbn_common.sonar import SonarArray
from fbn_common.sonar_file import load_sonar
from fbn_predict.parameters import Dynamics
from fbn_tracking.parameters import InfantParameters

STEERING = radians(30.0)  # of propeller, or fins: where servos of small vehicles end
SECOND_ORDER = (1, 2, 3)  # of N1 to N8: these grow with time squared
ANGULAR = (4, 5)
WAVES = (6, 7)
MEANING = (
    "range, by the speed towards a target",
    "range, second order: passing the nearest target",
    "range, second order: turning",
    "range, second order: accelerating",
    "bearing, by passing the nearest target",
    "bearing, by turning",
    "range, by waves of deep water",
    "range, by waves over this bed",
)


@dataclass(frozen=True, slots=True)
class Case:
    """A vehicle with its sonar in a sea; depths are below the surface [m], positive."""

    vehicle: str
    sonar: str
    arrays: dict[str, SonarArray]  # as mounted
    wavelength: float  # m
    aperture: float  # m
    speed: float  # m/s, through the water
    turn_rate: float  # rad/s
    acceleration: float  # m/s^2
    ping_rate: float  # Hz
    water_depth: float
    vehicle_depth: float
    target_depth: float
    current: float  # m/s
    wave_height: float  # m
    wave_period: float  # s
    infant: InfantParameters = field(default_factory=InfantParameters)

    def __post_init__(self) -> None:
        for name, depth in (("vehicle", self.vehicle_depth), ("target", self.target_depth)):
            if not 0.0 <= depth <= self.water_depth:
                raise ParameterError(
                    f"the {name} at {depth:g} m is not in water of {self.water_depth:g} m; see --depth, --altitude, "
                    "--target-depth"
                )
        if self.speed <= 0.0 or self.current < 0.0:
            raise ParameterError("--speed must be positive, --current not negative [m/s]")

    @property
    def array(self) -> SonarArray:
        """The array that looks most nearly ahead."""
        return min(self.arrays.values(), key=lambda a: abs(a.mount_rpy[2]))

    @property
    def ground_speed(self) -> float:
        """With the current from astern [m/s]: the fewest looks at a target."""
        return self.speed + self.current

    @property
    def motion(self) -> Motion:
        """What the observability numbers are made of."""
        wave = Wave(self.wave_height / 2.0, self.wave_period, self.water_depth)
        return Motion(
            self.speed, self.turn_rate, self.acceleration, self.ping_rate, self.wavelength, self.aperture,
            self.array.range_min, -self.vehicle_depth, wave,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Term:
    """One of N1 to N8: its value and threshold, and after which time [s] the detector sees it (inf: never)."""

    name: str
    meaning: str
    value: float
    threshold: float
    after: float

    @property
    def coherent(self) -> bool:
        """Whether a sonar that resolves a quarter of a wavelength would see it from ping to ping."""
        return self.value > QUARTER

    @property
    def observable(self) -> bool:
        """Whether the detector sees it from ping to ping."""
        return self.value > self.threshold


def make_case(
    vehicle: Path, sonar: str = "", speed: float | None = None, ping_rate: float | None = None, **sea: float
) -> Case:
    """The case of a parameter file and a sonar (empty: the one that the file names).

    Raises ParameterError for a wrong file, a sonar nobody names, and values that cannot be.
    """
    chosen = {"tracking.head.sonar": sonar} if sonar else {}
    parameters = load_parameters(GRAPH.only(("fbn_predict", "fbn_tracking")), (vehicle,), chosen)
    tracking, dynamics = parameters["fbn_tracking"], parameters["fbn_predict"].dynamics
    if not tracking.head.sonar:
        raise ParameterError(f"{vehicle.name} names no sonar (head.sonar); name one by --sonar")
    model = load_sonar(tracking.head.sonar)
    rate = model.ping_rate if ping_rate is None else ping_rate
    if rate <= 0.0:
        raise ParameterError("--ping-rate must be positive [Hz]")
    return Case(
        vehicle.stem,
        model.name,
        tracking.arrays,
        model.wavelength,
        model.aperture,
        dynamics.terminal_speed if speed is None else speed,
        *agility(dynamics),
        rate,
        infant=tracking.infant,
        **sea,
    )


def agility(dynamics: Dynamics) -> tuple[float, float]:
    """Largest turn rate [rad/s] and acceleration [m/s^2]: full steering at terminal speed, full thrust from rest."""
    steering = dynamics.fin_torque * STEERING if dynamics.fin_torque else sin(STEERING)
    turn = dynamics.angular_actuation[2] * steering / dynamics.angular_damping[2]
    return turn, dynamics.terminal_speed * dynamics.linear_damping[0]


def terms(case: Case) -> list[Term]:
    """N1 to N8, against what the detector resolves."""
    limits = thresholds(case.array.range_sigma, case.array.bearing_sigma, case.wavelength, case.aperture)
    found = zip(MEANING, numbers(case.motion), limits, strict=True)
    return [Term(f"N{i + 1}", text, n, t, _after(case, i, n, t)) for i, (text, n, t) in enumerate(found)]


def _after(case: Case, i: int, value: float, threshold: float) -> float:
    """The time after which a term has grown to what the detector resolves [s]."""
    if value <= 0.0:
        return inf
    pings = sqrt(threshold / value) if i in SECOND_ORDER else threshold / value
    after = pings / case.ping_rate
    if i in WAVES:  # water that goes to and fro: at most its own amplitude, after a quarter of a period
        reach = threshold / value / case.ping_rate * case.motion.wave.frequency
        return asin(reach) / case.motion.wave.frequency if reach < 1.0 else inf
    return after
