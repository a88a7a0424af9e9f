"""Parameters of the predict filter: a vehicle as the filter believes it, and how far that belief goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.parameters import ParameterError, group, param
from fbn_common.types import Array

_RANGER = "Ranger, 1.3 m by 0.2 m: strip theory"
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Dynamics:
    """One parametrised vehicle: a vectored propeller, fins, or both.  Forces are per mass, torques per inertia."""

    propeller_reference: float = param(
        125.66, "rad/s", "rate at which the actuation gains are stated", "1,200 rpm, ISRR 2007 4"
    )
    thrust_exponent: float = param(
        1.0, "-", "thrust grows as this power of the rate", "terminal speed then grows as the rate"
    )
    angular_actuation: Triple = param(
        (-0.2, 0.25, 0.25), "rad/s^2", "by full thrust: roll; pitch and yaw per sine of tilt, pan", _RANGER
    )
    linear_damping: Triple = param((0.27, 0.7, 0.7), "1/s", "decay of velocity through the water", _RANGER)
    angular_damping: Triple = param((1.5, 1.5, 1.5), "1/s", "decay of turn rates", _RANGER)
    terminal_speed: float = param(0.75, "m/s", "at the reference rate, straight ahead", "ISRR 2007 4")
    lateral_actuation: float = param(0.08, "m/s^2", "side force of full thrust per sine of pan or tilt", _RANGER)
    quadratic_damping: Triple = param(
        (0.0, 0.0, 0.0), "s/m", "share of damping that grows with speed", "off: linear in the paper"
    )
    mass_ratio: Triple = param((1.0, 1.7, 1.7), "-", "mass with added mass, over that ahead", "slender body")
    lateral_centre: float = param(
        -0.4, "m", "where lateral resistance acts, along x", "tail fins; tuned on simulated turns"
    )
    fin_torque: float = param(
        0.0, "rad/s^2", "of a radian of rudder or plane at terminal speed, over the actuation gain", "no fins"
    )
    fin_lift: float = param(
        0.0, "m/s^2", "side force of a radian of rudder or plane at terminal speed, over lateral gain", "no fins"
    )
    buoyancy: float = param(0.017, "m/s^2", "excess over weight, per mass across; fades at the surface", "1 N")
    steering_exponent: float = param(
        0.4,
        "-",
        "force ahead falls as this power of cos pan cos tilt",
        "its effect on speed: 0.5 by quadratic drag, less by inflow",
    )
    righting_roll: float = param(19.0, "1/s^2", "righting torque per sine of roll", "metacentric height 12 mm")
    righting_pitch: float = param(0.57, "1/s^2", "righting torque per sine of pitch", "metacentric height 12 mm")
    surface_loss: float = param(
        0.02,
        "-",
        "part of the thrust lost at the surface, by its effect on speed",
        "15 % for half of the time, power 0.4",
    )
    surface_depth: float = param(0.2, "m", "depth above which the surface counts", "hull diameter")

    def __post_init__(self) -> None:
        if min(*self.linear_damping, *self.angular_damping, self.propeller_reference, self.terminal_speed) <= 0.0:
            raise ParameterError("damping, propeller_reference and terminal_speed must be positive")
        if min(self.mass_ratio) <= 0.0 or self.surface_depth <= 0.0:
            raise ParameterError("mass_ratio and surface_depth must be positive")


@dataclass(frozen=True, slots=True)
class Doubt:
    """Standard deviations of the 15 parameters' prior."""

    angular_actuation: Triple = param((0.2, 0.1, 0.1), "rad/s^2", "of angular actuation", "40 % for a new vehicle")
    damping: float = param(0.2, "-", "of damping, relative", "a new vehicle")
    terminal_speed: float = param(0.03, "-", "of terminal speed, relative", "thrust 4 %, drag 5 % between individuals")
    lateral_actuation: float = param(0.04, "m/s^2", "of the side force", "50 %")
    water: Triple = param((0.15, 0.15, 0.005), "m/s", "of the water velocity, east, north, up", "coastal current")


@dataclass(frozen=True, slots=True)
class Noise:
    """What the model leaves out, as the spread of velocity it keeps up; white acceleration of the same power."""

    velocity: Triple = param(
        (0.02, 0.03, 0.03), "m/s", "standing error of velocity, body axes", "simulated turns and waves"
    )
    turn_rate: Triple = param(
        (0.04, 0.008, 0.008), "rad/s", "standing error of turn rates under water", "trim, servo zeros; simulated dives"
    )
    wave_turn: Triple = param(
        (0.1, 0.03, 0.02), "rad/s", "the same by waves at the surface; falls as surge does", "waves of 0.25 m, 3 s"
    )
    surge: float = param(0.12, "m/s", "standard deviation of wave surge at the surface", "waves of 0.25 m, 3 s")
    surge_time: float = param(1.0, "s", "correlation time of surge", "waves of 5 s")
    surge_depth: float = param(2.0, "m", "depth over which surge falls by e", "waves of 3 s: 14 m long")
    silence: float = param(
        0.5, "m/s", "standing error of velocity when actuators are silent", "the vehicle may have stopped"
    )
    silence_turn: float = param(0.3, "rad/s", "standing error of turn rates then", "the rudder may be anywhere")


@dataclass(frozen=True, slots=True)
class PredictParameters:
    """Parameters of ``fbn_predict``."""

    dynamics: Dynamics = group(Dynamics)
    doubt: Doubt = group(Doubt)
    noise: Noise = group(Noise)
    actuator_timeout: float = param(
        2.0, "s", "silence of actuators after which uncertainty grows", "20 missed commands"
    )
    frozen_after: int = param(
        20,
        "-",
        "equal commands in a row, and thrice as many as ever, after which they count as silence; 0 = never",
        "2 s at 10 Hz; autopilots change a command with each message",
    )
    history: float = param(
        6.0, "s", "for how long late commands and feedback are worked in", "5 s of delay, and a margin"
    )
    max_gap: float = param(10.0, "s", "a longer jump of the clock starts anew", "assumed")
    ahead: float = param(1.0, "s", "a stamp farther ahead of the clock is refused", "clocks on one vehicle agree")

    def __post_init__(self) -> None:
        if not 1.0 <= self.history <= 15.0:
            raise ParameterError("history must be 1 to 15 s")


class Prior(NamedTuple):
    """The 15 parameters' prior."""

    mean: Array  # (15,)
    covariance: Array  # (15, 15)


def prior(dynamics: Dynamics, doubt: Doubt) -> Prior:
    """Mean and covariance of the 15 parameters.

    Forward thrust is known through terminal speed, ``K = D v``: gain and damping are strongly correlated.
    """
    damping = np.array([*dynamics.linear_damping, *dynamics.angular_damping])
    thrust = dynamics.linear_damping[0] * dynamics.terminal_speed
    lateral = dynamics.lateral_actuation
    mean = np.array([*dynamics.angular_actuation, *damping, thrust, lateral, lateral, 0.0, 0.0, 0.0])
    spread = np.zeros((15, 15))
    spread[0:3, 0:3] = np.diag(doubt.angular_actuation)
    spread[3:9, 3:9] = np.diag(doubt.damping * damping)
    spread[9, 3] = doubt.damping * thrust
    spread[9, 9] = doubt.terminal_speed * thrust
    spread[10, 10] = spread[11, 11] = doubt.lateral_actuation
    spread[12:, 12:] = np.diag(doubt.water)
    return Prior(mean, spread @ spread.T)
