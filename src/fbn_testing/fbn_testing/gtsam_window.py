"""The tracker's window as a gtsam graph of the same measurements: an independent solver, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gtsam
import numpy as np

from fbn_common.types import Array, Mat3, Vec3
from fbn_tracking.factors import earth_kernel, inverse, link_kernel, whitener
from fbn_tracking.geometry import anchored_observation, u_from_theta
from fbn_tracking.track import Detection, Ping, Track
from fbn_tracking.window import Base, Window

DRIFT: int = gtsam.symbol("b", 0)
_UNIT = {n: gtsam.noiseModel.Unit.Create(n) for n in (2, 3, 4, 6, 7)}


def pose_key(index: int) -> int:
    """Key of the pose of ping ``index``."""
    return int(gtsam.symbol("x", index))


def feature_key(key: int) -> int:
    """Key of a feature's variable."""
    return int(gtsam.symbol("f", key))


def values_of(window: Window) -> gtsam.Values:
    """The window's estimate."""
    values = gtsam.Values()
    values.insert(DRIFT, window.drift())
    for index, T in window.estimate.poses().items():
        values.insert(pose_key(index), gtsam.Pose3(T))
    for key in window.features:
        values.insert(feature_key(key), window.estimate.q(key))
    return values


def graph_of(window: Window) -> Any:
    """All its factors: gauge, prior at the base, links, earth measurements, detections."""
    graph, base, pings = gtsam.NonlinearFactorGraph(), window.base, list(window.pings.values())
    for factor in (*base_factors(base, pings[0]), *chain_factors(pings[1:])):
        graph.add(factor)
    for track in window.features.values():
        for factor in track_factors(track, window.weak_theta_sigma):
            graph.add(factor)
    return graph


def base_factors(base: Base, first: Ping) -> Iterable[Any]:
    """What is put in at the first pose."""
    yield gauge_factor(first.index, base.T[:2, 3].copy())
    yield base_factor(first.index, base.mean, whitener(inverse(base.covariance)))
    if base.fresh:
        yield earth_factor(first.index, first.earth_mean, first.earth_whitener)


def chain_factors(pings: Iterable[Ping]) -> Iterable[Any]:
    """Each ping's link to the one before, and its earth measurement."""
    for p in pings:
        yield link_factor(p.index - 1, p.index, p.increment, p.R_increment, p.dt, p.link_whitener)
        yield earth_factor(p.index, p.earth_mean, p.earth_whitener)


def track_factors(track: Track, weak: float) -> Iterable[Any]:
    """A feature's detections."""
    for detection in track.detections:
        yield track_factor(track, detection, weak)


def track_factor(track: Track, detection: Detection, weak: float) -> Any:
    """One of them; the first one is the anchor's own."""
    first = track.detections[0]
    if detection is first:
        return first_detection_factor(track.key, detection.z, weak)
    mounts = first.look.mount, detection.look.mount
    return detection_factor(first.index, detection.index, track.key, *mounts, detection.z)


def link_factor(index_from: int, index_to: int, inc: Vec3, R_inc: Mat3, dt: float, W: Array) -> Any:
    """Motion between two pings: ``increment + (R^T (b_x, b_y, 0) + (b_s, 0, 0)) dt``, whitened by ``W`` (6, 6)."""
    k1, k2 = pose_key(index_from), pose_key(index_to)

    def error(_: Any, v: Any, H: Any) -> Array:
        T_1, T_2 = v.atPose3(k1).matrix(), v.atPose3(k2).matrix()
        e, H1, H2, Hb = link_kernel(T_1, T_2, v.atPoint3(DRIFT), inc, R_inc, dt, W)
        if H is not None:
            H[0], H[1], H[2] = H1, H2, Hb
        return np.asarray(e)

    return gtsam.CustomFactor(_UNIT[6], [k1, k2, DRIFT], error)


def earth_factor(index: int, mean: Array, W: Array) -> Any:
    """Earth measurement z, roll, pitch, yaw (4) with whitener ``W`` (4, 4), which may be rank-deficient."""
    key = pose_key(index)

    def error(_: Any, v: Any, H: Any) -> Array:
        e, Hx = earth_kernel(v.atPose3(key).matrix(), mean, W)
        if H is not None:
            H[0] = Hx
        return np.asarray(e)

    return gtsam.CustomFactor(_UNIT[4], [key], error)


def base_factor(index: int, mean: Array, W: Array) -> Any:
    """Prior on the base's z, roll, pitch, yaw and the drift together: mean (7), whitener (7, 7)."""
    key, earth, eye = pose_key(index), np.ascontiguousarray(mean[:4]), np.eye(4)

    def error(_: Any, v: Any, H: Any) -> Array:
        e, Hx = earth_kernel(v.atPose3(key).matrix(), earth, eye)
        if H is not None:
            H[0], H[1] = W[:, :4] @ Hx, np.ascontiguousarray(W[:, 4:])
        return np.asarray(W @ np.concatenate((e, v.atPoint3(DRIFT) - mean[4:])))

    return gtsam.CustomFactor(_UNIT[7], [key, DRIFT], error)


def gauge_factor(index: int, xy: Array) -> Any:
    """Pins the base's x and y [m]: no other factor depends on them, so its width (1 m) is of no consequence."""
    key = pose_key(index)

    def error(_: Any, v: Any, H: Any) -> Array:
        T = v.atPose3(key).matrix()
        if H is not None:
            H[0] = np.hstack((np.zeros((2, 3)), T[:2, :3]))
        return np.asarray(T[:2, 3] - xy)

    return gtsam.CustomFactor(_UNIT[2], [key], error)


def first_detection_factor(key: int, z: Array, weak_theta_sigma: float) -> Any:
    """The anchor's own detection, exact in the feature's coordinates, with a loose bound on theta."""
    kf, (r, phi, _, _, a, c) = feature_key(key), z
    scale = np.array([1.0 / z[2], 1.0 / z[3]])

    def error(_: Any, v: Any, H: Any) -> Array:
        f = v.atPoint3(kf)
        if H is not None:
            J = np.zeros((4, 3))
            J[0, 0], J[1, 1], J[2:, 2] = scale[0], scale[1], (a + 3.0 * c * f[2] ** 2, 1.0 / weak_theta_sigma)
            H[0] = J
        u = u_from_theta(f[2], a, c)
        return np.array([(f[0] - r) * scale[0], (f[1] - phi) * scale[1], u, f[2] / weak_theta_sigma])

    return gtsam.CustomFactor(_UNIT[4], [kf], error)


def detection_factor(anchor: int, index: int, key: int, mount_anchor: Array, mount: Array, z: Array) -> Any:
    """A later detection of an anchored feature, from another pose or from another array of the same ping."""
    ka, kj, kf = pose_key(anchor), pose_key(index), feature_key(key)
    same, (a, c) = anchor == index, z[4:]

    def error(_: Any, v: Any, H: Any) -> Array:
        T_a = v.atPose3(ka).matrix()
        T_j = T_a if same else v.atPose3(kj).matrix()
        s, *by = anchored_observation(T_a, T_j, mount_anchor, mount, v.atPoint3(kf))
        scale = np.array([1.0 / z[2], 1.0 / z[3], a + 3.0 * c * s[2] ** 2])
        if H is not None:
            H_a, H_j, H_f = (scale[:, None] * D for D in by)
            H[0] = H_a + H_j if same else H_a
            if not same:
                H[1] = H_j
            H[-1] = H_f
        return np.array([(s[0] - z[0]) * scale[0], (s[1] - z[1]) * scale[1], u_from_theta(s[2], a, c)])

    return gtsam.CustomFactor(_UNIT[3], [ka, kf] if same else [ka, kj, kf], error)
