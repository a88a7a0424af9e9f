"""What the tracker's composites are worth, by the truth of a simulated mission."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fbn_common.lie import matrix_from_quaternion
from fbn_common.records import CompositeMeasurement, SonarDetections
from fbn_common.sonar import polar
from fbn_common.types import NS, Array
from fbn_sim.simulation import Simulation
from fbn_testing.feature_runs import Outcome

PINGS_IN_VIEW = 10  # looks after which a true feature is due to be found
ECHOES = 7  # after which the tracker has no excuse left: `infant.detections`
SAME_RANGE, SAME_BEARING = 0.5, 0.07  # m, rad: an echo so near to where a feature is, is its own: four sigmas and bias
NEAR = 2.0  # m, and four sigmas that way: what is farther from every static thing is false
LASTING = 1e8  # s: what lives longer is static


class Found(NamedTuple):
    """A feature of a composite that is a true one, and how well it is placed."""

    error: Array  # (3,) m
    covariance: Array  # (3, 3)
    height: float  # m, of the true one over the array: negative below
    other_side: bool  # placed above where it is below, or the reverse

    @property
    def horizontal(self) -> float:
        """NEES of x, y over its two degrees of freedom."""
        return nees(self.error[:2], self.covariance[:2, :2]) / 2.0

    @property
    def depth(self) -> float:
        """NEES of z."""
        return float(self.error[2] ** 2 / self.covariance[2, 2])


class Moved(NamedTuple):
    """The way a composite with features says the vehicle went, against dead reckoning alone."""

    error: Array  # (2,) m, along and across the way
    alone: Array  # (2,) m, the same of dead reckoning
    nees: float  # of x, y over two degrees of freedom
    distance: float  # m


@dataclass
class Verdict:
    """One mission judged."""

    seed: int
    due: int = 0  # (dive, feature) pairs in view for ten pings or more
    promoted: int = 0  # of those
    heard: int = 0  # of those due, the ones that echoed seven times or more
    heard_promoted: int = 0  # and were promoted
    patches: int = 0  # other static things found: patches of the bed that echo steadily
    passing: int = 0  # fish or bubbles that were there while they were looked at, taken for static things
    false: int = 0  # features where nothing was
    hours: float = 0.0
    found: list[Found] = field(default_factory=list)
    moved: list[Moved] = field(default_factory=list)


def judge(outcome: Outcome) -> Verdict:
    """Composites against the truth."""
    simulation = outcome.heard.simulation
    verdict, found = Verdict(simulation.seed), set[tuple[int, int]]()
    patches, passing, false = set[int](), set[int](), set[int]()
    for c in outcome.composites:
        if c.features:
            verdict.moved.append(moved(c, simulation))
        for number, f in enumerate(c.features):
            target = nearest(c, number, simulation)
            if target is not None and passes(c, number, simulation, gap(c, number, target, simulation)):
                passing.add(f.key)
            elif target is None:
                (passing if passes(c, number, simulation) else false).add(f.key)
            elif target >= simulation.truth.scatterers.features:
                patches.add(f.key)
            else:
                found.add((dive_at(simulation, c.stamp_ns), target))
                verdict.found.append(placed(c, number, target, simulation))
    due, heard = in_view(simulation)
    verdict.due, verdict.promoted = len(due), len(due & found)
    verdict.heard, verdict.heard_promoted = len(heard), len(heard & found)
    verdict.patches, verdict.passing, verdict.false = len(patches), len(passing), len(false - passing)
    verdict.hours = (simulation.entries[-1][0] - simulation.entries[0][0]) / 3.6e12
    return verdict


def nees(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared."""
    return float(error @ np.linalg.solve(covariance, error))


def place(c: CompositeMeasurement, number: int, simulation: Simulation) -> tuple[Array, Array]:
    """Where a feature is said to be [m, map], its base being where it truly was, and the covariance (3, 3)."""
    at = slice(10 + 3 * number, 13 + 3 * number)
    base = simulation.truth.at(c.start_ns).position[0]
    return c.mean[at] + np.array([*base[:2], 0.0]), c.covariance[at, at]


def nearest(c: CompositeMeasurement, number: int, simulation: Simulation) -> int | None:
    """Row of the static thing (features first, then patches) that a feature is; None where there is none."""
    xyz, covariance = place(c, number, simulation)
    things = simulation.truth.scatterers
    offsets = (things.places - xyz)[:, :2]
    gaps = np.hypot(*offsets.T)
    gaps[things.life[:, 1] < LASTING] = np.inf
    row = int(np.argmin(gaps))
    return row if gaps[row] <= reach(offsets[row], covariance) else None


def gap(c: CompositeMeasurement, number: int, target: int, simulation: Simulation) -> float:
    """How far a feature lies from a static thing, in x and y [m]."""
    xyz, _ = place(c, number, simulation)
    return float(np.hypot(*(simulation.truth.scatterers.places[target] - xyz)[:2]))


def passes(c: CompositeMeasurement, number: int, simulation: Simulation, within: float = np.inf) -> bool:
    """Whether a fish or a cloud of bubbles was there at any time of the composite at which the feature was seen.

    And nearer than ``within`` [m] all that time: what swims by a true thing is not what was found there.
    """
    xyz, covariance = place(c, number, simulation)
    things, f = simulation.truth.scatterers, c.features[number]
    start = simulation.truth.start_ns
    seen = np.linspace(max(c.start_ns, f.first_seen_ns) - start, f.last_seen_ns - start, 11) / NS
    alive = (things.life[:, :1] <= seen) & (seen <= things.life[:, 1:]) & (things.life[:, 1:] < LASTING)  # (m, 11)
    age = seen - things.life[:, :1]
    x, y = (things.places[:, i, None] + things.drift[:, i, None] * age - xyz[i] for i in (0, 1))
    gaps = np.where(alive, np.hypot(x, y), np.inf)
    row = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    farthest = float(np.hypot(x, y)[row[0]][alive[row[0]]].max(initial=0.0))
    return bool(farthest < within and gaps[row] <= reach(np.array([x[row], y[row]]), covariance))


def reach(offset: Array, covariance: Array) -> float:
    """How far a feature may lie from a thing at this offset (2,) [m] to be that thing."""
    along = offset / max(float(np.hypot(*offset)), 1e-9)
    return float(NEAR + 4.0 * np.sqrt(along @ covariance[:2, :2] @ along))


def placed(c: CompositeMeasurement, number: int, target: int, simulation: Simulation) -> Found:
    """How well a true feature is placed."""
    xyz, covariance = place(c, number, simulation)
    truth = simulation.truth.features.positions[target]
    height = float(truth[2] - c.mean[6])
    return Found(xyz - truth, covariance, height, (xyz[2] - c.mean[6]) * height < 0.0)


def moved(c: CompositeMeasurement, simulation: Simulation) -> Moved:
    """The way between base and P2 against the truth, along and across it."""
    base, end = (simulation.truth.at(stamp).position[0] for stamp in (c.start_ns, c.stamp_ns))
    way = (end - base)[:2]
    error = c.mean[4:6] - way
    alone = (c.p2_odom.position - c.base_odom.position)[:2] - way
    length = float(np.hypot(*way))
    along = way / max(length, 1e-9)
    turn = np.array([along, [-along[1], along[0]]])
    return Moved(turn @ error, turn @ alone, nees(error, c.covariance[4:6, 4:6]) / 2.0, length)


def dive_at(simulation: Simulation, stamp_ns: int) -> int:
    """Number of the dive in which, or after which, this is."""
    return sum(dive.start_ns <= stamp_ns for dive in simulation.dives)


def in_view(simulation: Simulation) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """(dive, feature) pairs with ten looks or more from under water; and those that echoed in seven of them or more."""
    looks: dict[tuple[int, int], set[int]] = {}
    echoes: dict[tuple[int, int], set[int]] = {}
    for _, _, record in simulation.records():
        dive = dive_at(simulation, record.stamp_ns)
        if not isinstance(record, SonarDetections) or not dive or record.stamp_ns > simulation.dives[dive - 1].end_ns:
            continue
        for target, echoed in seen(simulation, record):
            looks.setdefault((dive, target), set()).add(record.ping)
            if echoed:
                echoes.setdefault((dive, target), set()).add(record.ping)
    due = {pair for pair, pings in looks.items() if len(pings) >= PINGS_IN_VIEW}
    return due, {pair for pair in due if len(echoes.get(pair, ())) >= ECHOES}


def seen(simulation: Simulation, scan: SonarDetections) -> Iterator[tuple[int, bool]]:
    """True features in a scan's range, sector and lobe, by row; and whether one of its echoes is theirs."""
    motion, array = simulation.truth.at(scan.stamp_ns), simulation.scenario.sensors.sonar.arrays[scan.frame_id]
    R = matrix_from_quaternion(motion.orientation[0])
    places = (simulation.truth.features.positions - motion.position[0] - R @ array.position_base) @ R
    for target, there in enumerate(places @ array.rotation_base_array):
        r, phi, theta = polar(there)
        inside = array.range_min < r < array.range_max and array.bearing_min < phi < array.bearing_max
        if inside and abs(theta) < 0.5 * array.lobe_width:
            near = (abs(e.range - r) < SAME_RANGE and abs(e.bearing - phi) < SAME_BEARING for e in scan.detections)
            yield target, any(near)
