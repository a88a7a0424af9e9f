"""Where and how the window is cut: the old part becomes a composite, the young part the next window."""

from __future__ import annotations

import numpy as np

from fbn_common.lie import matrix_from_quaternion, quaternion_from_matrix
from fbn_common.types import Array, Mat4
from fbn_tracking.composite import Part, marginalise
from fbn_tracking.heading import drift_prior, regression
from fbn_tracking.nursery import Nursery, slack
from fbn_tracking.parameters import CompositeParameters, TrackingParameters
from fbn_tracking.track import Memory, Track
from fbn_tracking.window import Base, Window


def choose_cut(window: Window, nursery: Nursery, par: CompositeParameters) -> int | None:
    """Index of the ping at which to cut now, or None.

    Before the oldest infant, when enough poses are older than it, preferably when a feature has left the view; in
    any case when the window is full.
    """
    anchors = [t.anchor for t in nursery.infants.values() if t.detections]
    oldest = max(min([window.last, *anchors]), window.first)
    old = oldest - window.first
    left = any(track.retired for track in window.features.values())
    if old >= par.pings + par.wait_pings or (old >= par.pings and left):
        return oldest
    return max(oldest, window.first + par.pings) if len(window.pings) >= par.window else None


def cut(window: Window, last: int, nursery: Nursery, par: TrackingParameters) -> tuple[Part, Window]:
    """The part up to ping ``last``, marginalised, and the window that starts there.

    No measurement is in both: links, earth measurements and features' detections up to ``last`` are in the part,
    all others in the window; what the part knows of its last pose goes over as a prior that is stated.
    """
    nursery.take_out_moving(window)
    part = marginalise(window, last, slack(window, window.base.covariance[4:, 4:]), par.feature)
    young = Window(handover(part, last), {i: p for i, p in window.pings.items() if i >= last}, window.weak_theta_sigma)
    young.start(carried_poses(window, part, last), window.drift())
    numbers = {track.key: n for n, track in enumerate(part.tracks)}
    for track in window.features.values():
        carry(window, young, track, last, part, numbers.get(track.key), nursery)
    trim(nursery, last)
    young.update()
    nursery.refresh(list(nursery.infants.values()), nursery.around(young, young.base.covariance[4:, 4:]))
    nursery.tend(young, window.pings[window.last].stamp_ns)
    return part, young


def handover(part: Part, last: int) -> Base:
    """The next window's base: P2 with what this part knows of it, and the drift as dead reckoning now states it.

    Each window learns the drift anew: when dead reckoning takes over better parameters, what was learnt of the old
    ones' error is void.  What this part knows of it is in its composite.
    """
    covariance = np.zeros((7, 7))
    covariance[:4, :4] = part.covariance[6:10, 6:10]
    motion, deviation = part.pings[last].motion, part.window.base.deviation
    covariance[4:, 4:] = drift_prior(motion)
    mean = np.concatenate((part.mean[6:10], np.zeros(3)))
    T, covariance = orthonormal(part.estimate.T(last)), 0.5 * (covariance + covariance.T)
    return Base(T, mean, covariance, False, deviation, regression(motion, deviation))


def carried_poses(window: Window, part: Part, last: int) -> Array:
    """Initial poses (n, 4, 4) of the young window: as they were, moved along with P2."""
    old = window.estimate.state.T[last - window.first :]
    move = part.estimate.T(last) @ np.linalg.inv(old[0])
    return np.array([orthonormal(move @ T) for T in old])


def orthonormal(T: Mat4) -> Mat4:
    """The pose with its rotation made exact again: rounding grows with every product, from window to window."""
    out = T.copy()
    out[:3, :3] = matrix_from_quaternion(quaternion_from_matrix(np.ascontiguousarray(T[:3, :3])))
    return out


def carry(
    window: Window, young: Window, track: Track, last: int, part: Part, number: int | None, nursery: Nursery
) -> None:
    """A feature into the young window: as it is if wholly young, else with its young detections and a memory."""
    if number is None:
        young.add_feature(track, window.estimate.q(track.key))
        return
    detections = [d for d in track.detections if d.index > last]
    if track.retired and not detections:
        return
    misses = [look for look in track.misses if look.index > last]
    here = slice(10 + 3 * number, 13 + 3 * number)
    point = part.mean[here] + np.array([*part.base_xy, 0.0])
    memory = Memory(point, relative_covariance(part.covariance, here), part.pings[last].stamp_ns)
    nursery.take_back(
        Track(track.key, track.first_seen_ns, track.last_seen_ns, track.seen, 0.0, detections, misses, memory=memory)
    )


def relative_covariance(covariance: Array, here: slice) -> Array:
    """Covariance (3, 3) of a feature relative to P2."""
    p2 = slice(4, 7)
    cross = covariance[here, p2]
    return np.asarray(covariance[here, here] + covariance[p2, p2] - cross - cross.T)


def trim(nursery: Nursery, last: int) -> None:
    """Infants older than a forced cut keep what they saw since."""
    for track in list(nursery.infants.values()):
        kept = [d for d in track.detections if d.index >= last]
        nursery.counts["detections_lost_at_cuts"] += len(track.detections) - len(kept)
        track.detections, track.misses = kept, [look for look in track.misses if look.index >= last]
        if not kept and track.memory is None:
            del nursery.infants[track.key]
