"""What the vehicle reports of its own actuators."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from fbn_common.parameters import group, param
from fbn_common.records import JointState
from fbn_sim.randomness import generator
from fbn_sim.sensors.sample import Entry, Flight, Timing, sample

TOPIC = "actuators"
NAMES = {"propeller": ("propeller", "pan", "tilt"), "fins": ("propeller", "rudder", "stern_plane")}


@dataclass(frozen=True, slots=True)
class Actuation:
    """Encoders of propeller and servos; they do not see the servos' zeros."""

    timing: Timing = group(partial(Timing, latency=0.01, jitter=0.01))
    rate_noise: float = param(0.5, "rad/s", "white noise of the propeller's rate", "5 rpm")
    angle_noise: float = param(0.003, "rad", "white noise of the angles", "0.2 deg")


def actuator_records(sensor: Actuation, steering: str, flight: Flight) -> list[Entry]:
    """Rate of the propeller and the two angles, with zeros where a joint has no such quantity."""
    rng = generator(flight.seed, "actuators")
    taken = sample(flight, sensor.timing, rng)
    n, names, none = len(taken.time_s), NAMES[steering], np.empty(0)
    rate = taken.motion.actuators[:, 0] + sensor.rate_noise * rng.standard_normal(n)
    rate = np.where(np.abs(taken.motion.actuators[:, 0]) < 1e-3, 0.0, rate)
    angle = taken.motion.actuators[:, 1:] + sensor.angle_noise * rng.standard_normal((n, 2))
    positions = np.column_stack([np.zeros(n), angle])
    velocities = np.column_stack([rate, np.zeros((n, 2))])
    return [
        Entry(log, TOPIC, JointState(stamp, "base_link", names, position, velocity, none))
        for stamp, log, kept, position, velocity in zip(
            taken.stamp_ns, taken.log_time_ns, taken.kept, positions, velocities, strict=True
        )
        if kept
    ]
