"""GPS, which works on the surface only, and ranges to acoustic beacons."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from fbn_common.geodesy import GeodeticPoint, geodetic_array_from_enu
from fbn_common.parameters import group, param
from fbn_common.records import BeaconRange, NavSatFix
from fbn_common.types import Array
from fbn_sim.motion import interpolate
from fbn_sim.randomness import gauss_markov, generator
from fbn_sim.sensors.sample import Entry, Flight, Timing, rotations, sample

Flags = npt.NDArray[np.bool_]
GPS_TOPIC, LBL_TOPIC = "gps/fix", "lbl/range"


@dataclass(frozen=True, slots=True)
class Gps:
    """A single-frequency receiver on a short mast."""

    timing: Timing = group(partial(Timing, 1.0, 0.12, 0.05))
    slow_sigma: float = param(1.6, "m", "time-correlated error, each axis", "autonomous GPS: ionosphere, orbits")
    slow_time_constant: float = param(240.0, "s", "its correlation time", "minutes")
    white_sigma: float = param(0.4, "m", "white error, each axis", "code noise, smoothed")
    first_sigma: float = param(3.0, "m", "additional error of the first fixes after surfacing ...", "filter converging")
    first_time_constant: float = param(4.0, "s", "... and the time in which it falls to 1/e", "assumed")
    to_first_fix_min: float = param(3.0, "s", "time to first fix after surfacing, least", "hot start")
    to_first_fix_max: float = param(12.0, "s", "the same, longest", "hot start, wet antenna")
    multipath_rate: float = param(0.008, "1/s", "jumps a second on the surface", "assumed")
    multipath_size: float = param(9.0, "m", "mean size of a jump", "assumed")
    multipath_seconds: float = param(3.0, "s", "mean length of a jump", "assumed")
    splash: float = param(0.03, "-", "chance that a wave costs a fix", "assumed")
    up_factor: float = param(1.8, "-", "vertical over horizontal error", "geometry of satellites")
    stated_sigma: float = param(1.9, "m", "published, each axis: of the total typical error", "honest receiver")


@dataclass(frozen=True, slots=True)
class Beacon:
    """One transponder."""

    position: tuple[float, float, float] = param((0.0, 0.0, -3.0), "m", "map", "scenario")
    surveyed: tuple[float, float, float] = param((0.0, 0.0, 0.0), "m", "error of the position as told", "scenario")
    lie: float = param(0.0, "m", "constant added to its ranges", "a wrong turn-round time")


@dataclass(frozen=True, slots=True)
class Lbl:
    """Interrogates its beacons in turn; a reply takes sound's way there and back."""

    timing: Timing = group(partial(Timing, 0.5, 0.05))
    noise: float = param(0.3, "m", "white noise of range", "data sheet class")
    scale_sigma: float = param(0.002, "-", "of the scale: speed of sound", "3 m/s")
    missing: float = param(0.15, "-", "chance that no reply is heard", "assumed")
    multipath: float = param(0.05, "-", "chance that a reply came by a longer way", "assumed")
    multipath_size: float = param(12.0, "m", "mean excess of that way", "assumed")
    turn_round: float = param(0.05, "s", "a beacon's delay, known and taken off", "data sheet class")
    sound_speed: float = param(1480.0, "m/s", "of the water", "fresh, 20 degC")
    stated_sigma: float = param(0.6, "m", "standard deviation published", "noise and speed of sound")
    beacons: dict[str, Beacon] = group(dict)


def draw_gps_error(gps: Gps, seconds: int, seed: int) -> Array:
    """East, north, up error (n, 3) [m] at each whole second, without jumps; it goes on under water."""
    rng = generator(seed, "gps", "error")
    slow = gauss_markov(rng, (seconds, 3), 1.0, gps.slow_sigma, gps.slow_time_constant)
    return (slow + gps.white_sigma * rng.standard_normal((seconds, 3))) * np.array([1.0, 1.0, gps.up_factor])


def gps_records(gps: Gps, error: Array, antenna: Array, datum: GeodeticPoint, flight: Flight) -> list[Entry]:
    """The receiver's records, one a second: status -1 with the last position while it has no fix."""
    rng = generator(flight.seed, "gps")
    taken = sample(flight, gps.timing, rng)
    n = len(taken.time_s)
    has_fix, since = _fixes(gps, taken.time_s, taken.motion.surface < 0.0, rng)
    place = taken.motion.position + np.einsum("nij,j->ni", rotations(taken.motion.orientation), antenna)
    place = place + error[np.minimum(taken.time_s.astype(np.int64), len(error) - 1)] + _jumps(gps, taken.time_s, rng)
    first = rng.standard_normal((n, 3)) * gps.first_sigma * np.exp(-since / gps.first_time_constant)[:, None]
    geodetic = _held(geodetic_array_from_enu(place + first, datum), has_fix)
    variance = gps.stated_sigma**2 * np.array([1.0, 1.0, gps.up_factor**2])
    settling = (gps.first_sigma * np.exp(-since / gps.first_time_constant)) ** 2
    return [
        Entry(log, GPS_TOPIC, _fix(stamp, bool(ok), g, np.diag(variance + extra)))
        for stamp, log, kept, ok, g, extra in zip(
            taken.stamp_ns, taken.log_time_ns, taken.kept, has_fix, geodetic, settling, strict=True
        )
        if kept
    ]


def _fix(stamp_ns: int, ok: bool, geodetic: Array, covariance: Array) -> NavSatFix:
    latitude, longitude, height = (float(c) for c in geodetic)
    if ok:
        return NavSatFix(stamp_ns, "gps_link", 0, latitude, longitude, height, covariance, 2)
    return NavSatFix(stamp_ns, "gps_link", -1, latitude, longitude, height, np.zeros((3, 3)), 0)


def _fixes(gps: Gps, times: Array, up: Flags, rng: np.random.Generator) -> tuple[Flags, Array]:
    """Whether there is a fix at each time, and seconds since the first one of this surfacing."""
    wait = rng.uniform(gps.to_first_fix_min, gps.to_first_fix_max, len(times))
    wet = rng.random(len(times)) < gps.splash
    has, since = np.zeros(len(times), dtype=bool), np.zeros(len(times))
    surfaced, needed, below = -1.0, 0.0, 10.0
    for i, t in enumerate(times):
        below = 0.0 if up[i] else below + (t - times[i - 1] if i else 1.0)
        if below > 3.0:  # a wave over the antenna is not a dive
            surfaced = -1.0
        elif surfaced < 0.0:
            surfaced, needed = t, wait[i]
        since[i] = max(t - surfaced - needed, 0.0) if surfaced >= 0.0 else 0.0
        has[i] = up[i] and surfaced >= 0.0 and t - surfaced >= needed and not wet[i]
    return has, since


def _jumps(gps: Gps, times: Array, rng: np.random.Generator) -> Array:
    """Multipath (n, 3) [m]: jumps at random times that last for seconds."""
    out = np.zeros((len(times), 3))
    if not len(times):
        return out
    most = int(3.0 * times[-1] * gps.multipath_rate) + 5
    for begin in np.cumsum(rng.exponential(1.0 / gps.multipath_rate, most)):
        length = 1.0 + rng.exponential(gps.multipath_seconds)
        size, angle = rng.exponential(gps.multipath_size), rng.uniform(-np.pi, np.pi)
        inside = (times >= begin) & (times < begin + length)
        out[inside] += size * np.array([np.cos(angle), np.sin(angle), 0.5])
    return out


def _held(values: Array, valid: Flags) -> Array:
    """The values, and where they are not valid the last that were (the first of all at the beginning)."""
    index = np.where(valid, np.arange(len(values)), -1)
    return np.asarray(values[np.maximum(np.maximum.accumulate(index), 0)]) if len(values) else values


def lbl_records(lbl: Lbl, flight: Flight) -> list[Entry]:
    """Ranges to the beacons in turn; stamped at reception, with the round trip as travel_delay."""
    rng = generator(flight.seed, "lbl")
    if not lbl.beacons:
        return []
    taken = sample(flight, lbl.timing, rng)
    n, names = len(taken.time_s), list(lbl.beacons)
    turn = np.arange(n) % len(names)
    there = np.array([b.position for b in lbl.beacons.values()])[turn]
    lie = np.array([b.lie for b in lbl.beacons.values()])[turn]
    back = np.linalg.norm(taken.motion.position - there, axis=1)
    asked = interpolate(flight.motion, np.maximum(taken.time_s - 2.0 * back / lbl.sound_speed - lbl.turn_round, 0.0))
    way = 0.5 * (back + np.linalg.norm(asked.position - there, axis=1))
    longer = np.where(rng.random(n) < lbl.multipath, rng.exponential(lbl.multipath_size, n), 0.0)
    scale = 1.0 + lbl.scale_sigma * rng.standard_normal()
    measured = (way + longer) * scale + lie + lbl.noise * rng.standard_normal(n)
    heard = (rng.random(n) >= lbl.missing) & np.array(taken.kept)
    delay = 2.0 * measured / lbl.sound_speed + lbl.turn_round
    return [
        Entry(log, LBL_TOPIC, BeaconRange(stamp, "base_link", names[b], float(r), lbl.stated_sigma**2, float(d)))
        for stamp, log, ok, b, r, d in zip(taken.stamp_ns, taken.log_time_ns, heard, turn, measured, delay, strict=True)
        if ok and r > 0.0
    ]
