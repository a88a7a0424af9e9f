"""The vehicle: its parameters as a type of vehicle has them, and one individual drawn from them.

An individual differs from its type: propeller, drag, buoyancy, trim and servo zeros scatter from seed to seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbn_common.lie import skew
from fbn_common.parameters import ParameterError, group, param
from fbn_common.types import Array, Mat6, Vec3
from fbn_sim.randomness import generator

_RANGER = "Ranger: 1.3 m long, 0.2 m diameter"
_SLENDER = "slender body, 1.3 m by 0.2 m"


@dataclass(frozen=True, slots=True)
class Scatter:
    """How much individuals differ from their type (standard deviations)."""

    thrust: float = param(0.04, "-", "of the propeller's thrust", "a few per cent of speed at a given rate")
    drag: float = param(0.05, "-", "of drag, each axis", "assumed")
    buoyancy: float = param(0.3, "N", "of the buoyancy in excess of weight", "30 g of ballast")
    trim: float = param(0.0004, "m", "of the centre of gravity, forward and sideways", "2 deg of tilt at rest")
    servo: float = param(0.012, "rad", "of the zeros of pan and tilt, or the fins", "0.7 deg")


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A type of vehicle: rigid body, hydrodynamics, actuators.  Six numbers are x, y, z and about x, y, z."""

    length: float = param(1.3, "m", "of the hull", _RANGER)
    diameter: float = param(0.2, "m", "of the hull", _RANGER)
    mass: float = param(32.7, "kg", "with the water inside", "0.8 of the cylinder's volume")
    inertia: tuple[float, float, float] = param((0.18, 3.9, 3.9), "kg m^2", "about the centre of buoyancy", _SLENDER)
    gravity_centre: tuple[float, float, float] = param(
        (0.0, 0.0, -0.012), "m", "from the centre of buoyancy", "the propeller pitches it by 10 deg"
    )
    excess_buoyancy: float = param(0.8, "N", "over the weight, under water", "80 g, so that it comes up by itself")
    added_mass: tuple[float, float, float, float, float, float] = param(
        (1.8, 27.0, 27.0, 0.02, 2.9, 2.9), "kg, kg m^2", "added mass, diagonal", _SLENDER
    )
    linear_drag: tuple[float, float, float, float, float, float] = param(
        (0.3, 6.0, 6.0, 0.4, 1.0, 1.0), "N s/m, N m s", "drag proportional to speed", "small"
    )
    quadratic_drag: tuple[float, float, float, float, float, float] = param(
        (4.3, 140.0, 140.0, 0.05, 9.8, 9.8), "N s^2/m^2, N m s^2", "drag by speed squared", "Cd 0.27 ahead, 1.1 across"
    )
    body_lift: float = param(6.0, "kg/m", "lateral force over forward times lateral speed, of the hull", "assumed")
    fin_lift: float = param(40.0, "kg/m", "the same of the tail", "0.027 m^2, slope 3 per rad")
    fin_position: float = param(-0.55, "m", "of the tail's lift along x", _RANGER)
    thrust: float = param(2.867e-4, "N s^2", "thrust over propeller rate squared", "0.75 m/s at 1,200 rpm")
    thrust_inflow: float = param(0.02, "N s^2/m", "loss over rate times forward speed", "0.75 m/s at 1,200 rpm")
    propeller_torque: float = param(2.5e-6, "N m s^2", "reaction over rate squared", "1 deg of roll")
    propeller_position: float = param(-0.62, "m", "along x", _RANGER)
    surface_loss: float = param(0.15, "-", "part of the thrust lost at the surface", "ventilation, assumed")
    steering: str = param("propeller", "-", "propeller (pan and tilt) or fins (rudder and stern plane)", _RANGER)
    steering_limit: float = param(0.5, "rad", "largest angle of pan and tilt, or the fins", "assumed")
    steering_rate: float = param(1.0, "rad/s", "fastest change of those", "hobby-class servo under load")
    steering_lag: float = param(0.15, "s", "first-order lag of those", "assumed")
    propeller_rate_limit: float = param(90.0, "rad/s^2", "fastest change of the propeller's rate", "assumed")
    propeller_lag: float = param(0.4, "s", "first-order lag of the propeller's rate", "assumed")
    speed_per_rate: float = param(
        0.75 / 125.664, "m", "speed over propeller rate, in the autopilot", "0.75 m/s at 1,200 rpm"
    )
    antenna: tuple[float, float, float] = param((-0.3, 0.0, 0.35), "m", "place of the GPS antenna", "mast aft")
    scatter: Scatter = group(Scatter)

    def __post_init__(self) -> None:
        if self.steering not in ("propeller", "fins"):
            raise ParameterError(f"steering must be 'propeller' or 'fins', got {self.steering!r}")
        if min(self.mass, *self.inertia, self.length, self.diameter, self.steering_lag, self.propeller_lag) <= 0.0:
            raise ParameterError("mass, inertia, sizes and lags must be positive")


class Body(NamedTuple):
    """One individual, as the kernels take it; the origin is the centre of buoyancy."""

    mass_inverse: Mat6  # of rigid body and added mass together
    rigid: Mat6
    added: Mat6
    linear_drag: Array  # (6,)
    quadratic_drag: Array  # (6,)
    weight: float  # N
    buoyancy: float  # N
    gravity_centre: Vec3
    length: float
    radius: float
    body_lift: float
    fin_lift: float
    fin_position: float
    thrust: float
    thrust_inflow: float
    propeller_torque: float
    propeller_position: float
    surface_loss: float
    finned: bool
    servo_zero: Array  # (2,) rad, pan and tilt
    actuator_limit: Array  # (3,) propeller, pan, tilt
    actuator_rate: Array  # (3,) per second
    actuator_lag: Array  # (3,) s
    antenna: Vec3


def draw_body(vehicle: Vehicle, seed: int) -> Body:
    """An individual of the type, ballasted to its excess buoyancy in the water of the day."""
    rng, s = generator(seed, "vehicle"), vehicle.scatter
    drag = 1.0 + s.drag * rng.standard_normal(6)
    thrust = 1.0 + s.thrust * rng.standard_normal()
    excess = vehicle.excess_buoyancy + s.buoyancy * rng.standard_normal()
    centre = np.array(vehicle.gravity_centre) + s.trim * np.array([*rng.standard_normal(2), 0.0])
    servo_zero = s.servo * rng.standard_normal(2)
    rigid, added = rigid_mass(vehicle.mass, np.array(vehicle.inertia), centre), np.diag(vehicle.added_mass)
    weight = vehicle.mass * 9.80665
    limit = vehicle.steering_limit
    return Body(
        mass_inverse=np.ascontiguousarray(np.linalg.inv(rigid + added)),
        rigid=rigid,
        added=added,
        linear_drag=np.array(vehicle.linear_drag) * drag,
        quadratic_drag=np.array(vehicle.quadratic_drag) * drag,
        weight=weight,
        buoyancy=weight + excess,
        gravity_centre=centre,
        length=vehicle.length,
        radius=vehicle.diameter / 2.0,
        body_lift=vehicle.body_lift,
        fin_lift=vehicle.fin_lift,
        fin_position=vehicle.fin_position,
        thrust=vehicle.thrust * thrust,
        thrust_inflow=vehicle.thrust_inflow * thrust,
        propeller_torque=vehicle.propeller_torque,
        propeller_position=vehicle.propeller_position,
        surface_loss=vehicle.surface_loss,
        finned=vehicle.steering == "fins",
        servo_zero=servo_zero,
        actuator_limit=np.array([1e3, limit, limit]),
        actuator_rate=np.array([vehicle.propeller_rate_limit, vehicle.steering_rate, vehicle.steering_rate]),
        actuator_lag=np.array([vehicle.propeller_lag, vehicle.steering_lag, vehicle.steering_lag]),
        antenna=np.array(vehicle.antenna),
    )


def rigid_mass(mass: float, inertia: Vec3, centre: Vec3) -> Mat6:
    """Mass matrix (6, 6) of a rigid body about an origin from which its centre of gravity lies at ``centre``."""
    s = skew(centre)
    m = np.zeros((6, 6))
    m[:3, :3] = mass * np.eye(3)
    m[:3, 3:] = -mass * s
    m[3:, :3] = mass * s
    m[3:, 3:] = np.diag(inertia)
    return m
