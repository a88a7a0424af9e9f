"""What is known of a feature's elevation, which is no Gaussian, put into the joint covariance of a composite.

Ranges tell theta's square, the lobe is flat, floor and surface cut it off.  So a feature's place is taken in two
parts: given theta, as the linear system has it; and the place's moments over theta's posterior.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fbn_common.types import NS, Array, Mat3, Vec3
from fbn_tracking.geometry import world_point
from fbn_tracking.infants import normal_equations, profile, symmetric_inverse
from fbn_tracking.modes import Surroundings, half_lobe, misses_costs, place_costs, widened
from fbn_tracking.track import Track

_REACH, _GRID = 1.8, 37  # half lobes to either side, and points, at which the posterior is taken


class Elevation(NamedTuple):
    """Moments of a place over its elevation's posterior: mean less the smoothed place [m], covariance [m^2]."""

    shift: Vec3
    spread: Mat3


def elevation_posterior(track: Track, theta: float, around: Surroundings) -> Elevation | None:
    """The moments over all elevations, given the poses; ``theta``: the smoothed one.  None where none is possible.

    Taken at every theta of a grid, with all else at its likeliest.
    """
    first, detections = track.detections[0], track.detections
    R, p = around.stack(d.look for d in detections)
    t = np.array([(d.stamp_ns - first.stamp_ns) / NS for d in detections])
    z = widened(detections, around)
    reach = _REACH * half_lobe(first)
    thetas = np.concatenate(([theta], np.linspace(-reach, reach, _GRID)))
    start = np.array([first.z[0], first.z[1], 0.0, 0.0, 0.0])
    energies, points = profile(thetas, start, R, p, t, z, symmetric_inverse(around.slack))
    cost = 0.5 * energies + misses_costs(track.misses, points, around) + place_costs(points, 0.0, track, around)
    if not np.isfinite(cost).all():
        return None
    weights = np.exp(cost[1:].min() - cost[1:])
    weights /= weights.sum()
    mean = weights @ points[1:]
    apart = points[1:] - mean
    return Elevation(mean - points[0], np.asarray(apart.T @ (weights[:, None] * apart)))


def likelier_side(track: Track, q: Vec3, around: Surroundings) -> Vec3:
    """``q`` (r, phi, theta), or the same at the other elevation where that costs less, the poses staying as they are.

    Ranges hardly tell the two apart; floor, surface, misses and what stands on floors do.
    """
    _, costs = both_sides(track, q, around)
    return q if costs[0] <= costs[1] else mirrored(q)


def mirrored(q: Vec3) -> Vec3:
    """The same range and bearing at the other elevation."""
    return np.array([q[0], q[1], -q[2]])


def both_sides(track: Track, q: Vec3, around: Surroundings) -> tuple[Array, Array]:
    """World points (2, 3) of ``q`` and of the same at the other elevation, and minus log posteriors (2,)."""
    first, detections = track.detections[0], track.detections
    R, p = around.stack(d.look for d in detections)
    sides = np.array([q, mirrored(q)])
    t = np.array([(d.stamp_ns - first.stamp_ns) / NS for d in detections])
    z, free, none = widened(detections, around), np.zeros((2, 2)), np.zeros((3, 3))
    at_rest = [np.concatenate((side, np.zeros(2))) for side in sides]
    energies = [normal_equations(x, R, p, t, z, free, np.zeros(3), none)[2] for x in at_rest]
    points = np.array([world_point(R[0], p[0], side)[0] for side in sides])
    prior = misses_costs(track.misses, points, around) + place_costs(points, 0.0, track, around)
    return points, 0.5 * np.array(energies) + prior


def told(root: Array, J: Array, row: int, place: slice, spread: Mat3) -> tuple[Array, Array, Mat3]:
    """A joint covariance with what the system knows of one theta replaced by the posterior's moments.

    ``root`` (n, k): square root of the variables' covariance, theta being ``row``; ``J`` (m, n): outputs by variables,
    ``place`` the feature's.  Gives the root given theta; the column (m,) by which one sigma of theta moves the outputs,
    the place by the spread's own principal axis, all else as theta does, by no more than the system left it;
    and the part (3, 3) of the spread off that axis, the place's alone (total covariance).
    """
    own, along = root[row], J[place, row]
    sigma = float(np.linalg.norm(own))
    moved = root @ own / sigma
    values, vectors = np.linalg.eigh(spread)
    axis = vectors[:, 2] * np.sqrt(max(values[2], 0.0)) * (1.0 if vectors[:, 2] @ along >= 0.0 else -1.0)
    known = float(np.linalg.norm(axis) / max(float(np.linalg.norm(along)), 1e-9))
    column = J @ moved * min(1.0, known / sigma)
    column[place] = axis
    return root - np.outer(moved, own / sigma), column, np.asarray(spread - np.outer(axis, axis))
