"""What to change, and what to rely on, in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import asin, degrees, sin

import numpy as np

from fbn_bringup.design.case import Case, Term, terms
from fbn_bringup.design.passage import Passage, passage
from fbn_common.sonar_file import SOUND_SPEED


def advice(case: Case, offset: float) -> Iterator[str]:
    """Advice for a case, and for a target that is passed at ``offset`` [m] to the side."""
    found, seen = terms(case), passage(case, offset)
    yield from _on_range(case, found)
    yield from _on_bearing(case, found[5])
    if seen.pings:
        yield from _on_lobe(case, seen)
        yield from _on_detections(case, seen)
    else:
        yield (
            f"A target {_apart(case)} and {offset:.1f} m to the side never comes into view: change the altitude, turn "
            "the head (head.mount_rpy), or take a sonar with a wider lobe or view."
        )
    yield from _on_ping_rate(case)
    yield from _on_current(case)
    yield from _on_waves(case, found[7])


def _on_range(case: Case, found: list[Term]) -> Iterator[str]:
    sigma, n1, n2 = case.array.range_sigma, found[0], found[1]
    if n1.observable:
        yield "Range rate shows from ping to ping (N1): what does not move as the vehicle says is found out at once."
    else:
        yield (
            f"From ping to ping the range rate hides in the noise of {sigma * 100:.0f} cm; it shows after "
            f"{n1.after:.1f} s (N1). To see it in each ping go at {sigma * case.ping_rate:.2f} m/s or more, or ping at "
            f"{case.speed / sigma:.1f} Hz or less."
        )
    if n2.after < case.infant.lifetime:
        yield (
            f"Ranges of near targets bend within {n2.after:.1f} s (N2): tracks need the second order, "
            f"and at {case.array.range_min:.0f} m tell how far beside the way a target lies."
        )


def _on_bearing(case: Case, n6: Term) -> Iterator[str]:
    if n6.observable:
        yield "Turns move bearings by more than their noise in one ping (N6): matching needs the rate of turn."
    elif n6.after < case.infant.lifetime:
        yield f"Turns take {n6.after:.1f} s to show in bearings (N6)."


def _on_lobe(case: Case, seen: Passage) -> Iterator[str]:
    array, below = case.array, case.target_depth - case.vehicle_depth
    edge = array.lobe_width / 2.0 + (array.mount_rpy[1] if below >= 0.0 else -array.mount_rpy[1])
    reach = array.range_min * sin(edge)
    if abs(below) > reach and seen.last > 1.2 * array.range_min:
        tilt = degrees(asin(min(1.0, abs(below) / array.range_min)) - edge)
        way = "down" if below >= 0.0 else "up"
        yield (
            f"A target {_apart(case)} is last seen at {seen.last:.0f} m. Passing within {max(reach, 0.0):.1f} m "
            f"of its depth, or with the head turned {way} by {tilt:.0f} degrees more, it stays in the lobe until "
            f"{array.range_min:.0f} m."
        )


def _on_detections(case: Case, seen: Passage) -> Iterator[str]:
    need, par = case.infant.detections, case.infant
    if seen.detections < need:
        slower = case.ground_speed * seen.detections / need - case.current
        rate = case.ping_rate * need / seen.detections
        go = f"go at {slower:.2f} m/s or " if slower > 0.0 else ""
        limit = "" if rate <= _echo_rate(case) else ", for which range_max must be lowered: sound is not back before"
        yield (
            f"A passage gives {seen.detections:.1f} detections; a feature needs {need}: "
            f"{go}ping at {rate:.1f} Hz{limit}."
        )
    elif seen.sigma_horizontal > par.sigma_horizontal or seen.sigma_vertical > par.sigma_vertical:
        yield (
            f"A passage places a target to {seen.sigma_horizontal:.2f} m horizontally and {seen.sigma_vertical:.2f} m "
            f"in depth; a feature needs {par.sigma_horizontal:.2f} and {par.sigma_vertical:.2f}: "
            "ping faster or go slower."
        )
    else:
        yield (
            f"{seen.detections:.0f} detections a passage make a feature (it needs {need}), placed to "
            f"{seen.sigma_horizontal:.2f} m horizontally and {seen.sigma_vertical:.2f} m in depth "
            "if the poses were exact."
        )


def _on_ping_rate(case: Case) -> Iterator[str]:
    if case.ping_rate > _echo_rate(case):
        yield (
            f"Sound from {case.array.range_max:.0f} m returns {_echo_rate(case):.1f} times a second at most: "
            "lower the ping rate or range_max."
        )


def _on_current(case: Case) -> Iterator[str]:
    if case.current >= case.speed:
        yield f"A current of {case.current:.2f} m/s is not slower than the vehicle, which cannot go against it."
    elif case.current > 0.0:
        yield (
            f"The current is {case.current / case.speed:.0%} of the speed. Unknown, it moves targets by more than "
            f"the noise after {case.array.range_sigma / case.current:.1f} s; the ranges of one track of "
            f"{case.infant.lifetime:.0f} s tell it to {slope_sigma(case):.3f} m/s along the line of sight."
        )


def _on_waves(case: Case, waves: Term) -> Iterator[str]:
    if np.isfinite(waves.after):
        yield f"Waves show in the ranges after {waves.after:.1f} s (N8); {quiet(case)}."
    elif case.wave_height > 0.0:
        yield f"Waves do not show in the ranges at a depth of {case.vehicle_depth:.1f} m (N8)."


def quiet(case: Case) -> str:
    """From which depth on waves do not show, in words."""
    for depth in np.arange(case.vehicle_depth, case.water_depth, 0.5):
        if not np.isfinite(terms(replace(case, vehicle_depth=float(depth)))[7].after):
            return f"from a depth of {depth:.1f} m on they do not"
    return "they do at every depth here"


def slope_sigma(case: Case) -> float:
    """Standard deviation of the range rate [m/s] of a track as long as an infant's life: least squares of a line."""
    rate = case.ping_rate * case.array.detection_probability
    t = np.arange(max(3, round(case.infant.lifetime * rate))) / rate
    return case.array.range_sigma / float(np.sqrt(((t - t.mean()) ** 2).sum()))


def _apart(case: Case) -> str:
    below = case.target_depth - case.vehicle_depth
    return f"{abs(below):.1f} m {'below' if below >= 0.0 else 'above'} the vehicle"


def _echo_rate(case: Case) -> float:
    """Most pings a second that let sound come back from the farthest range [Hz]."""
    return SOUND_SPEED / (2.0 * case.array.range_max)
