"""What RViz and Foxglove draw of the likely hypotheses: each one's map with what was swept, found and missed on it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as RosPose
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from fbn_common import records as r
from fbn_common.overlay import Overlay, lay, likely
from fbn_common.sweep import CELL, Raster
from fbn_common.types import NS, Array, Vec3
from fbn_ros.markers import Colour, colour_of, label, point, vector

MOST = 3  # hypotheses drawn
LAST_S = 300.0  # s of composites drawn: what was swept before lies elsewhere by dead reckoning's drift
FULL = 30.0  # scans of a cell that is drawn in full colour
SWEPT: Colour = (0.2, 0.5, 0.9, 0.5)
EXPECTED: Colour = (0.1, 0.6, 0.2, 0.9)
MISSED: Colour = (0.95, 0.45, 0.0, 0.7)
TRACKED: Colour = (0.6, 0.2, 0.7, 0.9)
PAIR: Colour = (0.9, 0.1, 0.1, 1.0)
DOT, RING, LINE = (0.8, 0.8, 0.8), (4.0, 4.0, 0.1), (0.2, 0.0, 0.0)  # m


class OverlayMarkers:
    """Remembers composites and map; an answer of the bank gives a MarkerArray, namespaces by rank: 0 the best."""

    def __init__(self) -> None:
        self._composites: deque[r.CompositeMeasurement] = deque()
        self._map: r.FeatureMap | None = None

    def take(self, record: r.Record) -> None:
        """Remember what an overlay will need."""
        if isinstance(record, r.FeatureMap):
            self._map = record
        elif isinstance(record, r.CompositeMeasurement):
            if record.first:
                self._composites.clear()
            self._composites.append(record)
            while record.stamp_ns - self._composites[0].stamp_ns > LAST_S * NS:
                self._composites.popleft()

    def draw(self, answer: r.MatchHypotheses) -> Any | None:
        """The overlays of an answer's likely hypotheses; None before there are a map and a composite of its stamp."""
        last = next((c for c in self._composites if c.stamp_ns == answer.stamp_ns), None)
        if last is None or self._map is None or not answer.hypotheses:
            return None
        header = Header(stamp=Time(sec=answer.stamp_ns // NS, nanosec=answer.stamp_ns % NS), frame_id=answer.frame_id)
        made = [Marker(header=header, action=Marker.DELETEALL)]
        tracked = tracked_places(self._composites)
        for rank, h in enumerate(likely(answer, MOST)):
            overlay = lay(h, last.p2_odom, self._map, tracked, list(self._composites))
            for marker in _markers(overlay, h, np.array(list(tracked.values())).reshape(-1, 3)):
                marker.header, marker.action, marker.id = header, Marker.ADD, len(made)
                marker.ns = f"hypothesis {rank}: {marker.ns}"
                made.append(marker)
        return MarkerArray(markers=made)


def tracked_places(composites: deque[r.CompositeMeasurement]) -> dict[int, Vec3]:
    """Position (3,) in odom by key of every feature of these composites, as last told."""
    found: dict[int, Vec3] = {}
    for c in composites:
        base = np.array([*c.base_odom.position[:2], 0.0])
        for k, feature in enumerate(c.features):
            found[feature.key] = base + c.mean[10 + 3 * k : 13 + 3 * k]
    return found


def _markers(o: Overlay, h: r.MatchHypothesis, tracked: Array) -> Iterator[Any]:
    heights = np.array([f.position[2] for f in o.features])
    features, found = np.column_stack([o.map_xy, heights]), np.column_stack([o.tracked_xy, tracked[:, 2]])
    if o.swept is not None:
        yield _swept(o.swept, float(heights.min(initial=0.0)) - 0.5)
    missed = set(o.missed)
    known = [k for k in range(len(features)) if k not in missed]
    yield _dots("map", features[known], EXPECTED)
    yield _dots("tracked", found, TRACKED)
    for k in o.missed:
        place = RosPose(position=point(features[k]))
        yield Marker(ns="missed", type=Marker.CYLINDER, pose=place, scale=vector(RING), color=colour_of(MISSED))
    ends = [point(p) for a, b in o.pairs for p in (features[a], found[b])]
    red = colour_of((*PAIR[:3], 0.2 + 0.8 * h.posterior))
    yield Marker(ns="pairs", type=Marker.LINE_LIST, points=ends, scale=vector(LINE), color=red)
    yield label(h.pose.position, f"{h.id}: {h.posterior:.2f}, score {h.log_score:.1f}, {len(o.missed)} missed")


def _swept(raster: Raster, z: float) -> Any:
    """Cells that were swept, the stronger the colour the more scans."""
    rows, columns = np.nonzero(np.isfinite(raster.scans))
    xy = raster.corner + CELL * (np.column_stack([columns, rows]) + 0.5)
    shades = np.minimum(raster.scans[rows, columns] / FULL, 1.0)
    return Marker(
        ns="swept",
        type=Marker.CUBE_LIST,
        points=[point(np.array([x, y, z])) for x, y in xy],
        colors=[colour_of((*SWEPT[:3], float(0.1 + (SWEPT[3] - 0.1) * s))) for s in shades],
        scale=vector((CELL, CELL, 0.05)),
    )


def _dots(namespace: str, places: Array, colour: Colour) -> Any:
    dots = [point(p) for p in places]
    return Marker(ns=namespace, type=Marker.SPHERE_LIST, points=dots, scale=vector(DOT), color=colour_of(colour))
