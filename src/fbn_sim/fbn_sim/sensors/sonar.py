"""The forward-looking sonar at the level of detections.

Echo excess in dB decides: level, spreading and absorption, the target's strength by aspect, the lobe, and a
fluctuation; close by, reverberation limits it.  So the chance to be seen depends on range, aspect and place in
the lobe.  Beside the features echo patches of the bed, fish and bubbles, and there is noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fbn_common.kernels import kernel
from fbn_common.lie import so3_exp
from fbn_common.parameters import group, param
from fbn_common.records import SonarDetection, SonarDetections
from fbn_common.sonar import SonarArray
from fbn_common.sonar_file import SonarHead, load_sonar, with_sonar_file
from fbn_common.types import Array, Mat3, Vec3, Vec6
from fbn_sim.kernels import cross, length, transposed_times
from fbn_sim.motion import Motion, interpolate
from fbn_sim.randomness import generator
from fbn_sim.sensors.clutter import Clutter, Scatterers
from fbn_sim.sensors.sample import Entry, Flight, Timing, rotations, sample

TOPIC = "sonar/detections"
MARGIN = 0.06  # rad, beyond the nominal sector that is still looked at before noise


@dataclass(frozen=True, slots=True)
class Sonar:
    """Transmission, noise and imperfections that all arrays share; the arrays are mounted as ``SonarArray`` tells."""

    timing: Timing = group(partial(Timing, 1.0, 0.15, 0.08, 0.005))
    head: SonarHead = group(SonarHead)
    arrays: dict[str, SonarArray] = group(dict)
    clutter: Clutter = group(Clutter)
    level: float = param(
        31.5, "dB", "echo excess of the reference target, 10 m off, amid the lobe", "two scans of three"
    )
    absorption: float = param(0.15, "dB/m", "of sound, one way", "900 kHz in fresh water")
    reverberation_limit: float = param(12.0, "dB", "echo excess is no better", "close by, reverberation rules")
    fluctuation: float = param(4.0, "dB", "standard deviation from ping to ping", "Rayleigh-like")
    best_probability: float = param(0.85, "-", "chance that the detector keeps a strong echo", "assumed")
    range_noise: float = param(0.03, "m", "white noise of range", "3 cm, IROS 2007 II")
    range_step: float = param(0.025, "m", "quantisation of range", "assumed")
    bearing_noise: float = param(0.0165, "rad", "white noise of bearing", "1 deg together with the steps")
    bearing_step: float = param(0.0087, "rad", "quantisation of bearing", "0.5 deg beams")
    target_size: float = param(0.03, "m", "standard deviation of the echo's place on the target", "reflector of 0.3 m")
    sound_speed: float = param(1480.0, "m/s", "of the water", "fresh, 20 degC")
    sound_speed_error: float = param(0.001, "-", "standard deviation of the range's scale", "0.4 K of temperature")
    misalignment: float = param(0.007, "rad", "standard deviation of each array's mount, each axis", "0.4 deg")
    stamp_offset: float = param(0.01, "s", "standard deviation of the constant part of the stamps' error", "assumed")
    stamp_jitter: float = param(0.004, "s", "standard deviation of its white part", "assumed")
    merge_range: float = param(0.25, "m", "echoes nearer to one another than this in range ...", "assumed")
    merge_bearing: float = param(0.03, "rad", "... and this in bearing melt into one", "1.7 deg")
    most: int = param(12, "-", "detections a ping and array at most, the strongest", "a fixed number of maxima")

    @staticmethod
    def prepared(values: Mapping[str, Any]) -> Mapping[str, Any]:
        """With what the sonar file that ``head.sonar`` names says of arrays and simulation."""
        name = values.get("head.sonar")
        return with_sonar_file((load_sonar(name).simulation if name else {}) | dict(values))


@kernel
def sight(offset: Vec3, turn: Mat3, velocity: Vec6, mount: Mat3, origin: Vec3, sound_speed: float) -> Vec3:
    """Range, bearing to the axis and angle around it (3,) of a point at ``offset`` [m, map] from the vehicle.

    The way there and back is timed: the range is half the length of both, the bearing is that at reception.
    ``turn``: R_map_base; ``velocity``: of the body; ``mount``: R_base_array, ``origin`` of the array on the body.
    """
    base = transposed_times(turn, offset)
    delay = length(base - origin) / sound_speed
    rate = -velocity[:3] - cross(velocity[3:], base)
    middle = transposed_times(mount, base + rate * delay - origin)
    late = transposed_times(mount, base + rate * 2.0 * delay - origin)
    out = np.empty(3)
    out[0] = length(middle)
    out[1] = np.arccos(min(max(late[2] / max(length(late), 1e-9), -1.0), 1.0))
    out[2] = np.arctan2(late[1], late[0])
    return out


@kernel
def _insonified(
    times: Array, positions: Array, turns: Array, velocity: Array, mount: Mat3, origin: Vec3, limits: Array,
    places: Array, drift: Array, life: Array, out: Array,
) -> int:  # fmt: skip
    """Rows (ping, source, range, bearing, angle, aspect) of what is inside ``limits``; returns how many there are.

    ``limits``: least and greatest range [m] and bearing [rad], greatest angle about the axis [rad], sound speed.
    """
    found = 0
    for i in range(times.shape[0]):
        for j in range(places.shape[0]):
            if times[i] < life[j, 0] or times[i] > life[j, 1]:
                continue
            offset = places[j] + drift[j] * (times[i] - life[j, 0]) - positions[i]
            if length(offset) > limits[1] + 3.0:
                continue
            r, phi, theta = sight(offset, turns[i], velocity[i], mount, origin, limits[5])
            if not (limits[0] <= r <= limits[1] and limits[2] <= phi <= limits[3] and abs(theta) <= limits[4]):
                continue
            if found < out.shape[0]:
                out[found, 0], out[found, 1], out[found, 2] = i, j, r
                out[found, 3], out[found, 4], out[found, 5] = phi, theta, np.arctan2(-offset[1], -offset[0])
            found += 1
    return found


def echoes(pings: Motion, array: SonarArray, mount: Mat3, sound_speed: float, things: Scatterers) -> Array:
    """Rows (n, 6) for all in the array's sector at the pings, free of noise.

    Columns: number of the ping, row of the thing, range [m], bearing to the axis, angle around it [rad], and
    aspect: the direction in which the vehicle lies from the thing [rad, map].
    """
    sector = [array.range_min, array.range_max, array.bearing_min - MARGIN, array.bearing_max + MARGIN]
    limits = np.array([*sector, 1.5 * array.lobe_width, sound_speed])
    turns = np.ascontiguousarray(rotations(pings.orientation))
    given = (pings.time_s, pings.position, turns, pings.velocity, mount, array.position_base, limits)
    out = np.empty((8 * len(pings.time_s) + 64, 6))
    found = _insonified(*given, things.places, things.drift, things.life, out)
    if found > len(out):
        out = np.empty((found, 6))
        _insonified(*given, things.places, things.drift, things.life, out)
    return out[:found]


def excess(sonar: Sonar, array: SonarArray, seen: Array, things: Scatterers) -> Array:
    """Mean echo excess (n,) [dB] of rows of :func:`echoes`; positive is over the threshold."""
    source, r, theta, aspect = seen[:, 1].astype(np.int64), seen[:, 2], seen[:, 4], seen[:, 5]
    spread = 40.0 * np.log10(r / 10.0) + 2.0 * sonar.absorption * (r - 10.0)
    lobes = np.cos(things.aspect_order[source] * aspect + things.aspect_phase[source])
    strength = things.strength[source] + things.aspect_gain[source] * lobes
    clear = np.minimum(sonar.level - spread, sonar.reverberation_limit)
    return np.asarray(clear + strength - 6.0 * (theta / (array.lobe_width / 2.0)) ** 4)


def sonar_records(sonar: Sonar, things: Scatterers, flight: Flight) -> list[Entry]:
    """One record an array and ping, also when nothing was detected."""
    rng = generator(flight.seed, "sonar")
    pings = sample(flight, sonar.timing, rng)
    if not len(pings.time_s):
        return []
    wrong = sonar.stamp_offset * rng.standard_normal() + sonar.stamp_jitter * rng.standard_normal(len(pings.time_s))
    truth = interpolate(flight.motion, pings.time_s + wrong)
    scale = 1.0 + sonar.sound_speed_error * rng.standard_normal()
    entries: list[Entry] = []
    for name, array in sonar.arrays.items():
        own = generator(flight.seed, "sonar", name)
        mount = array.rotation_base_array @ so3_exp(sonar.misalignment * own.standard_normal(3))
        seen = echoes(truth, array, np.ascontiguousarray(mount), sonar.sound_speed, things)
        noise = _noise(sonar, array, len(pings.time_s), own)
        heard = np.concatenate([_heard(sonar, array, seen, things, scale, own), noise])
        heard = heard[np.argsort(heard[:, 0], kind="stable")]
        bounds = np.searchsorted(heard[:, 0], np.arange(len(pings.time_s) + 1))
        for i, kept in enumerate(pings.kept):
            if kept:
                found = _detections(sonar, array, heard[bounds[i] : bounds[i + 1], 1:])
                record = _record(pings.stamp_ns[i], name, i, array, found)
                entries.append(Entry(pings.log_time_ns[i], TOPIC, record))
    return entries


def _heard(
    sonar: Sonar, array: SonarArray, seen: Array, things: Scatterers, scale: float, rng: np.random.Generator
) -> Array:
    """Rows (ping, range, bearing, dB) of the echoes that came over the threshold, with noise."""
    n = len(seen)
    level = excess(sonar, array, seen, things) + sonar.fluctuation * rng.standard_normal(n)
    over = (level > 0.0) & (rng.random(n) < sonar.best_probability)
    source, aspect = seen[:, 1].astype(np.int64), seen[:, 5]
    place = sonar.target_size * np.sqrt(2.0) * np.cos(2.0 * aspect + 3.0 * things.aspect_phase[source])
    r = (seen[:, 2] + place) * scale + sonar.range_noise * rng.standard_normal(n)
    phi = seen[:, 3] + sonar.bearing_noise * rng.standard_normal(n)
    return np.column_stack([seen[:, 0], r, phi, level])[over]


def _noise(sonar: Sonar, array: SonarArray, pings: int, rng: np.random.Generator) -> Array:
    """Rows (ping, range, bearing, dB) of false alarms, evenly over the image."""
    count = rng.poisson(sonar.clutter.noise, pings)
    n = int(count.sum())
    r = rng.uniform(array.range_min, array.range_max, n)
    phi = rng.uniform(array.bearing_min, array.bearing_max, n)
    return np.column_stack([np.repeat(np.arange(pings), count), r, phi, rng.exponential(2.5, n)])


def _detections(sonar: Sonar, array: SonarArray, heard: Array) -> tuple[SonarDetection, ...]:
    """What the detector makes of one ping's echoes (n, 3): merged, quantised, the strongest, by bearing."""
    if not len(heard):
        return ()
    out = []
    for r, phi, level in merged(heard, sonar.merge_range, sonar.merge_bearing)[: sonar.most]:
        r = round(r / sonar.range_step) * sonar.range_step
        phi = round((phi - array.bearing_min) / sonar.bearing_step) * sonar.bearing_step + array.bearing_min
        if array.range_min <= r <= array.range_max and array.bearing_min <= phi <= array.bearing_max:
            intensity = min(max((level + 3.0) / 27.0, 0.0), 1.0)
            out.append(SonarDetection(r, phi, array.range_sigma, array.bearing_sigma, intensity))
    return tuple(sorted(out, key=lambda d: d.bearing))


def merged(heard: Array, near_range: float, near_bearing: float) -> list[list[float]]:
    """Echoes (range, bearing, dB), strongest first; what is near a stronger one melts into it, weighed by power."""
    groups: list[list[float]] = []  # weighted range, weighted bearing, dB of the strongest, power
    for r, phi, level in heard[np.argsort(-heard[:, 2], kind="stable")].tolist():
        power = 10.0 ** (level / 10.0)
        for g in groups:
            if abs(r - g[0]) < near_range and abs(phi - g[1]) < near_bearing:
                g[0] = (g[0] * g[3] + r * power) / (g[3] + power)
                g[1] = (g[1] * g[3] + phi * power) / (g[3] + power)
                g[3] += power
                break
        else:
            groups.append([r, phi, level, power])
    return [g[:3] for g in groups]


def _record(
    stamp_ns: int, name: str, ping: int, array: SonarArray, found: tuple[SonarDetection, ...]
) -> SonarDetections:
    sector = (array.range_min, array.range_max, array.bearing_min, array.bearing_max, array.lobe_width)
    return SonarDetections(stamp_ns, name, ping, *sector, found)
