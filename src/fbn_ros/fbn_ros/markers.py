"""What RViz and Foxglove draw: tracked features, the map, and where the vehicle may be."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as RosPose
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from fbn_common import records as r
from fbn_common.lie import quaternion_from_matrix
from fbn_common.types import NS, Mat3, Vec3

Colour = tuple[float, float, float, float]

COLOURS: dict[r.Stage, Colour] = {
    r.Stage.INFANT: (0.6, 0.6, 0.6, 0.5),
    r.Stage.FEATURE: (1.0, 0.55, 0.0, 0.8),
    r.Stage.RETIRED: (0.2, 0.4, 0.8, 0.5),
}
PRIOR: Colour = (0.1, 0.6, 0.2, 0.7)
FOUND: Colour = (1.0, 0.8, 0.1, 0.7)
TARGET: Colour = (0.9, 0.1, 0.1, 0.9)
SWEPT: Colour = (0.2, 0.5, 0.9, 0.2)
SMALLEST_M = 0.3  # a feature known to a centimetre is still to be seen
SIGMAS = 2.0  # of the ellipsoids' half axes
ARROW = (2.0, 0.3, 0.3)


def markers_of(record: r.Record) -> Any | None:
    """The MarkerArray of a record; it replaces the one before.  None for records that are not drawn."""
    draw = _DRAWN.get(type(record))
    if draw is None:
        return None
    frame_id = record.frame_id  # type: ignore[attr-defined]
    header = Header(stamp=Time(sec=record.stamp_ns // NS, nanosec=record.stamp_ns % NS), frame_id=frame_id)
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for i, marker in enumerate(draw(record)):
        marker.header, marker.id, marker.action = header, i, Marker.ADD
        markers.append(marker)
    return MarkerArray(markers=markers)


def _tracked(record: r.TrackedFeatures) -> Iterator[Any]:
    for feature in record.features:
        yield _ellipsoid(feature.position, feature.covariance, COLOURS[feature.stage], feature.stage.name.lower())
        yield label(feature.position, f"{feature.key} ({feature.detections})")
        if feature.rival_probability > 0.0:
            yield _rival(feature)


def _rival(feature: r.TrackedFeature) -> Any:
    """A line to where a feature may lie instead, the fainter the less likely."""
    colour = (*COLOURS[feature.stage][:3], 0.2 + 0.8 * feature.rival_probability)
    line = Marker(
        ns="rival", type=Marker.LINE_STRIP, pose=_still(), scale=vector((0.1, 0.0, 0.0)), color=colour_of(colour)
    )
    line.points = [point(feature.position), point(feature.rival_position)]
    return line


def _composite(record: r.CompositeMeasurement) -> Iterator[Any]:
    """The cells that the sonar swept, the bluer the oftener; the way from base to P2; its features."""
    base = record.base_odom.position * np.array([1.0, 1.0, 0.0])  # x and y are relative to it, z is not
    swept = record.swept
    seen = np.flatnonzero(swept.scans > 0.0)
    if len(seen):
        middles = np.column_stack((seen % swept.width, seen // swept.width)) + 0.5  # in cells
        at = base[:2] + swept.origin + swept.cell_size * middles
        alpha = 0.05 + 0.3 * swept.scans[seen] / swept.scans.max()
        size = vector((swept.cell_size, swept.cell_size, 0.05))
        cells = Marker(ns="swept", type=Marker.CUBE_LIST, pose=_still(), scale=size, color=colour_of(SWEPT))
        cells.points = [point(np.array([x, y, 0.0])) for x, y in at]
        cells.colors = [colour_of((*SWEPT[:3], a)) for a in alpha]
        yield cells
    ends = (np.array([base[0], base[1], record.mean[0]]), base + record.mean[4:7])
    way = Marker(ns="way", type=Marker.LINE_STRIP, pose=_still(), scale=vector((0.2, 0.0, 0.0)), color=colour_of(FOUND))
    way.points = [point(end) for end in ends]
    yield way
    for i in range(10, 10 + 3 * len(record.features), 3):
        block = record.covariance[i : i + 3, i : i + 3]
        yield _ellipsoid(base + record.mean[i : i + 3], block, COLOURS[r.Stage.RETIRED], "features")


def _map(record: r.FeatureMap) -> Iterator[Any]:
    for i, feature in enumerate(record.features):
        block = record.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        colour = TARGET if feature.target else PRIOR if feature.prior else FOUND
        yield _ellipsoid(feature.position, block, colour, "prior" if feature.prior else "found")
        yield label(feature.position, feature.name or str(feature.id))


def _hypotheses(record: r.MatchHypotheses) -> Iterator[Any]:
    for hypothesis in record.hypotheses:
        q = hypothesis.pose.orientation
        pose = RosPose(position=point(hypothesis.pose.position), orientation=_quaternion(q))
        colour = (0.1, 0.3, 0.9, 0.2 + 0.8 * hypothesis.posterior)
        yield Marker(ns="hypotheses", type=Marker.ARROW, pose=pose, scale=vector(ARROW), color=colour_of(colour))
        yield label(hypothesis.pose.position, f"{hypothesis.posterior:.2f} ({len(hypothesis.map_ids)} pairs)")


_DRAWN: dict[type, Callable[[Any], Iterator[Any]]] = {
    r.TrackedFeatures: _tracked,
    r.CompositeMeasurement: _composite,
    r.FeatureMap: _map,
    r.MatchHypotheses: _hypotheses,
}


def _ellipsoid(position: Vec3, covariance: Mat3, colour: Colour, namespace: str) -> Any:
    """Two standard deviations around a position."""
    variances, axes = np.linalg.eigh(covariance)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0  # a reflection is no rotation
    q = quaternion_from_matrix(np.ascontiguousarray(axes))
    diameters = np.maximum(2.0 * SIGMAS * np.sqrt(np.maximum(variances, 0.0)), SMALLEST_M)
    pose = RosPose(position=point(position), orientation=_quaternion(q))
    return Marker(ns=namespace, type=Marker.SPHERE, pose=pose, scale=vector(diameters), color=colour_of(colour))


def _still() -> Any:
    return RosPose(position=Point(), orientation=Quaternion(w=1.0))


def label(position: Vec3, text: str) -> Any:
    """Text a metre above a position."""
    above = RosPose(position=point(position + np.array([0.0, 0.0, 1.0])))
    scale = Vector3(z=0.6)
    return Marker(
        ns="labels", type=Marker.TEXT_VIEW_FACING, pose=above, scale=scale, color=colour_of((0, 0, 0, 1)), text=text
    )


def point(v: Vec3) -> Any:
    """A position (3,) as a message."""
    return Point(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def vector(v: Any) -> Any:
    """Three numbers as a message, of a marker's scale."""
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _quaternion(q: Any) -> Any:
    return Quaternion(x=float(q[0]), y=float(q[1]), z=float(q[2]), w=float(q[3]))


def colour_of(colour: Colour) -> Any:
    """Red, green, blue and opacity as a message."""
    return ColorRGBA(r=float(colour[0]), g=float(colour[1]), b=float(colour[2]), a=float(colour[3]))
