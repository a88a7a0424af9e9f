"""Cases for the simulator's tests: bodies without scatter, still water, motion in closed form."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from fbn_common.types import Array
from fbn_sim.motion import Motion
from fbn_sim.scenario import load_scenario
from fbn_sim.sea import EDDIES, WAVES, SeaTable
from fbn_sim.sensors.sample import Flight, quaternions
from fbn_sim.simulation import Simulation, simulate
from fbn_sim.vehicle import Body, Scatter, Vehicle, draw_body

START_NS = 1_159_884_000_000_000_000
DEEP = 1e9  # m: the current's profile is flat


def neutral_body(**changes: object) -> Body:
    """A Ranger as drawn on paper, but of neutral buoyancy, without righting moment and propeller torque."""
    exact = Scatter(thrust=0.0, drag=0.0, buoyancy=0.0, trim=0.0, servo=0.0)
    plain = Vehicle(excess_buoyancy=0.0, gravity_centre=(0.0, 0.0, 0.0), propeller_torque=0.0, scatter=exact)
    return draw_body(dataclasses.replace(plain, **changes), 0)  # type: ignore[arg-type]


def water(east: float = 0.0, north: float = 0.0) -> SeaTable:
    """A sea that flows everywhere alike, without waves."""
    flow = np.tile([east, north], (2000, 1))
    return SeaTable(
        flow, np.zeros((2000, 2)), 1.0, DEEP, np.ones((EDDIES, 4)) * [0, 1, 1, 0], np.ones((WAVES, 5)) * [0, 1, 1, 0, 0]
    )


def at_depth(depth: float, velocity: Array | None = None) -> Array:
    """A state (13,): level, heading east."""
    state = np.zeros(13)
    state[2], state[6] = -depth, 1.0
    state[7:] = 0.0 if velocity is None else velocity
    return state


def circling(depth: float, speed: float = 0.8, rate: float = 0.02, seconds: float = 1200.0, dt: float = 0.1) -> Motion:
    """Level flight on a circle, or straight to the east with a rate of 0; the antenna is up at depth 0."""
    t = np.arange(0.0, seconds, dt)
    n, zero = len(t), np.zeros(len(t))
    x = speed * t if rate == 0.0 else speed / rate * np.sin(rate * t)
    y = zero if rate == 0.0 else speed / rate * (1.0 - np.cos(rate * t))
    return Motion(
        time_s=t,
        position=np.column_stack([x, y, np.full(n, -depth)]),
        orientation=quaternions(np.column_stack([zero, zero, rate * t])),
        velocity=np.tile([speed, 0.0, 0.0, 0.0, 0.0, rate], (n, 1)),
        actuators=np.zeros((n, 3)),
        current=np.zeros((n, 3)),
        altitude=np.full(n, 5.0 - depth),
        surface=np.full(n, depth - 0.35),
        leg=zero,
        pilot_xy=np.zeros((n, 2)),
    )


def flight(motion: Motion, seed: int = 1) -> Flight:
    """What a sensor is given."""
    return Flight(motion, START_NS, seed)


@cache
def short_mission(seed: int = 1, overrides: tuple[tuple[str, object], ...] = ()) -> Simulation:
    """The first dive of the river scenario, cut short."""
    return simulate(load_scenario("charles_river_2006", {"mission.limit": 160.0} | dict(overrides)), seed)
