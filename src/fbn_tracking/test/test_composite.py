"""Composites against a batch made independently, and against one another: nothing counted twice, none lost."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares
from synthetic_world import World, corridor, play, simulate

from fbn_common.lie import matrix_from_quaternion, rpy_from_matrix, skew, so3_exp, so3_log
from fbn_common.sonar import cartesian, polar
from fbn_testing.gtsam_window import DRIFT, feature_key, graph_of, pose_key, values_of
from fbn_tracking.estimator import Tracking
from fbn_tracking.gating import anchored_place
from fbn_tracking.geometry import anchored_observation, cartesian_jacobian, elevation_shape, finite_slope
from fbn_tracking.matching import Joint, predict_feature
from fbn_tracking.parameters import CompositeParameters, FeatureParameters, TrackingParameters
from fbn_tracking.solver import solve

LINEAR = FeatureParameters(elevation="linear", weak_theta_sigma=1e6)
WHOLE = CompositeParameters(pings=1000, window=2000)
# Nearly without noise the problem is nearly linear, and any two ways to solve it must agree closely.
CALM = World(
    corridor(3, 10.0), drift=(0.02, -0.01, 0.0), drift_sigma=0.05, step_sigma=0.01, turn_sigma=0.002, pitch=0.1,
    detection_probability=1.0, range_sigma=0.05, bearing_sigma=0.0175, earth_sigma=(0.02, 0.005, 0.005, 0.01),
)  # fmt: skip


def _closed(run):
    """The run, and a last ping that starts a new chain, so that the tracker closes its window."""
    last = run.motions[-1]
    stamp = last.stamp_ns + 1_000_000_000
    run.motions.append(replace(last, stamp_ns=stamp, previous_ns=stamp))
    return run


def _composites(world, pings, seed, composite, feature=LINEAR):
    tracker = Tracking(TrackingParameters(feature=feature, composite=composite))
    outputs = play(tracker, _closed(simulate(world, pings, seed)))
    return [o.record for o in outputs if o.topic == "tracking/composite"]


class Batch:
    """The whole problem again, by plain numpy and scipy: the reference for one window from first ping to last."""

    def __init__(self, run, used, parameters):
        self.run, self.parameters = run, parameters
        self.tracks = sorted({key for key, *_ in used})
        self.used = used
        self.n = len(run.motions)

    def unpack(self, x):
        p, rotations = x[: 3 * self.n].reshape(-1, 3), x[3 * self.n : 6 * self.n].reshape(-1, 3)
        R = [self.R0[k] @ so3_exp(rotations[k]) for k in range(self.n)]
        return p, R, x[6 * self.n : 6 * self.n + 3], x[6 * self.n + 3 :].reshape(-1, 3)

    def residuals(self, x):
        p, R, drift, points = self.unpack(x)
        first = self.run.motions[0]
        rows = [p[0, :2] - first.pose.position[:2], drift / np.sqrt(np.diag(first.drift_covariance) + 1e-8)]
        for k, m in enumerate(self.run.motions):
            rows.append(np.sqrt(np.diag(m.earth_information)) * (np.array([p[k, 2], *rpy_from_matrix(R[k])]) - m.earth))
            if k:
                dt = (m.stamp_ns - m.previous_ns) / 1e9
                step = R[k - 1].T @ (p[k] - p[k - 1] - np.array([drift[0], drift[1], 0.0]) * dt)
                step -= np.array([drift[2] * dt, 0.0, 0.0])
                turn = so3_log(matrix_from_quaternion(m.increment.orientation).T @ R[k - 1].T @ R[k])
                e = np.concatenate((step - m.increment.position, turn))
                rows.append(e / np.sqrt(np.diag(m.increment_covariance) + 1e-12))
        for key, k, name, r, phi in self.used:
            array = self.parameters.arrays[name]
            a, _ = elevation_shape(array.lobe_width / 2, 1.0, False)
            R_a, p_a = R[k] @ array.rotation_base_array, p[k] + R[k] @ array.position_base
            s = polar(R_a.T @ (points[self.tracks.index(key)] - p_a))
            rows.append([(s[0] - r) / 0.05, (s[1] - phi) / 0.0175, a * s[2]])
        return np.concatenate(rows)

    def solve(self):
        """Outputs in the composite's order, and their covariance."""
        start_p = [p for _, p in self.run.poses[: self.n]]
        self.R0 = [np.ascontiguousarray(R) for R, _ in self.run.poses[: self.n]]
        points = []
        for key in self.tracks:
            _, k, name, r, phi = next(u for u in self.used if u[0] == key)
            array = self.parameters.arrays[name]
            R, p = self.run.poses[k]
            points.append(p + R @ (array.position_base + array.rotation_base_array @ cartesian(r, phi, 0.05)))
        x0 = np.concatenate((np.ravel(start_p), np.zeros(3 * self.n), np.zeros(3), np.ravel(points)))
        found = least_squares(self.residuals, x0, xtol=1e-15, ftol=1e-15, gtol=1e-10, x_scale="jac")
        J = self._jacobian(found.x)
        covariance = np.linalg.inv(J.T @ J)
        M = self._numeric(self.outputs, found.x)
        return self.outputs(found.x), M @ covariance @ M.T

    def outputs(self, x):
        p, R, drift, points = self.unpack(x)
        base = np.array([p[0, 0], p[0, 1], 0.0])
        return np.concatenate((
            [p[0, 2]], rpy_from_matrix(R[0]), p[-1] - base, rpy_from_matrix(R[-1]), np.ravel(points - base), drift,
        ))  # fmt: skip

    def _jacobian(self, x):
        return self._numeric(self.residuals, x)

    def _numeric(self, function, x, step=1e-6):
        return np.array([(function(x + d) - function(x - d)) / (2 * step) for d in step * np.eye(len(x))]).T


def _detections_used(tracker_outputs):
    """(key, ping, array, range, bearing) of all detections that belong to a feature, from the tracker's window."""
    return [
        (track.key, d.index, d.look.array, d.z[0], d.z[1])
        for track in tracker_outputs.features.values()
        for d in track.detections
    ]


@pytest.fixture(scope="module")
def against_batch():
    """One window's composite, and the independent batch of the same pings and detections."""
    parameters = TrackingParameters(feature=LINEAR, composite=WHOLE)
    run = simulate(CALM, 16, 1001)
    tracker = Tracking(parameters)
    play(tracker, run)
    tracker._nursery.graduate_remaining(tracker._window)
    used = _detections_used(tracker._window)
    batch = Batch(run, used, parameters).solve()
    stamp = run.motions[-1].stamp_ns + 1_000_000_000
    tracker.put("deadreck/ping_motion", replace(run.motions[-1], stamp_ns=stamp, previous_ns=stamp))
    composite = next(o.record for o in tracker.advance(stamp) if o.topic == "tracking/composite")
    order = np.argsort([f.key for f in composite.features])
    at = np.r_[0:10, (10 + 3 * order[:, None] + np.arange(3)).ravel(), -3:0]
    return composite.mean[at], composite.covariance[np.ix_(at, at)], *batch, len(composite.features)


def test_the_mean_is_that_of_the_independent_batch(against_batch):
    mean, covariance, expected, _, features = against_batch
    assert features >= 2
    # the tracker stops where a step gains less than 1e-6 of the energy, some 10 here: the root of twice that
    # is 4e-3 of a sigma in all directions together, and in none alone half as much
    assert np.abs((mean - expected) / np.sqrt(np.diag(covariance))).max() < 2e-3


def test_the_covariance_is_that_of_the_independent_batch(against_batch):
    _, covariance, _, expected, _ = against_batch
    scale = 1.0 / np.sqrt(np.diag(expected))
    # the batch's Jacobian is numerical, by steps of 1e-6; the base's weak prior (1000 m, 30 rad) it does not have
    np.testing.assert_allclose(covariance * np.outer(scale, scale), expected * np.outer(scale, scale), atol=1e-3)


@pytest.fixture(scope="module")
def smoothed_window():
    """A window with features, seen by both arrays, as the tracker left it, and gtsam's graph of its records."""
    tracker = Tracking(TrackingParameters(composite=WHOLE))
    play(tracker, simulate(World(corridor(6, 8.0), detection_probability=1.0, pitch=0.1), 45, 1006))
    window = tracker._window
    assert len(window.features) >= 4
    return window, graph_of(window)


def _keys(window):
    ends = dict.fromkeys([window.first, window.last, *(t.anchor for t in window.features.values())])
    return list(ends), [*map(pose_key, ends), DRIFT, *map(feature_key, window.features)]


def test_the_square_root_marginal_is_that_of_a_dense_qr(smoothed_window):
    window, graph = smoothed_window
    found = solve(window.system, window.estimate.state, (0, window.last - window.first), exact=True)
    window.start(found.state.T, found.state.drift)
    window.estimate.state.q[:] = found.state.q
    kept, keys = _keys(window)
    ordering = gtsam.Ordering()
    for key in (*(pose_key(i) for i in window.pings if i not in kept), *keys):
        ordering.push_back(key)
    A, _ = graph.linearize(values_of(window)).jacobian(ordering)
    root = found.root(found.layout.columns([i - window.first for i in kept], range(len(window.features))))
    R = np.linalg.qr(A, mode="r")[-len(root) :, -len(root) :]
    inverse = np.linalg.inv(R)
    expected = inverse @ inverse.T
    scale = np.sqrt(np.diag(expected))
    # condition numbers are some 1e4: rounding leaves 1e-12
    assert np.abs((root @ root.T - expected) / np.outer(scale, scale)).max() <= 1e-9


def test_the_optimum_is_that_of_gtsam(smoothed_window):
    window, graph = smoothed_window
    found = solve(window.system, window.estimate.state, (0,), exact=True)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    parameters.setMaxIterations(300)
    peer = gtsam.LevenbergMarquardtOptimizer(graph, values_of(window), parameters).optimize()
    assert found.energy <= graph.error(peer) * (1.0 + 1e-5)  # ours stops where a step gains less than 1e-6 of it
    assert graph.error(peer) <= found.energy * (1.0 + 1e-5)
    T = peer.atPose3(pose_key(window.last)).matrix()
    np.testing.assert_allclose(found.state.T[-1][:3, 3], T[:3, 3], atol=1e-3)  # m, of which 5 cm are allowed online


def test_the_compiled_prediction_and_place_are_the_plain_formulas(smoothed_window):
    window, _ = smoothed_window
    track = next(iter(window.features.values()))
    joint, look = Joint.of(window, window.last, [track]), window.pings[window.last].looks[0]
    a, c, first = *look.limits[4:], track.detections[0]
    T_a, T, q = window.T(track.anchor), window.T(window.last), window.estimate.q(track.key)
    s, *by = anchored_observation(T_a, T, first.look.mount, look.mount, q)
    H = np.hstack(by) * np.array([[1.0], [1.0], [a + 3.0 * c * s[2] ** 2]])
    at, kf = joint.offset, joint.offset[("feature", track.key)]
    columns = np.r_[at["pose", track.anchor] + np.arange(6), at["pose", window.last] + np.arange(6), kf + np.arange(3)]
    found = predict_feature(window, track, look, joint)
    np.testing.assert_allclose(found.z, [s[0], s[1], a * s[2] + c * s[2] ** 3], rtol=1e-12)
    np.testing.assert_allclose(found.S, H @ joint.covariance[np.ix_(columns, columns)] @ H.T, rtol=1e-9)
    point, covariance = anchored_place(T_a, first.look.mount, q, joint.covariance, columns[0], kf, *first.z[4:])
    mount, R, (in_array, by_q) = first.look.mount, T_a[:3, :3], cartesian_jacobian(q)
    y, sigma = mount[:3, 3] + mount[:3, :3] @ in_array, float(np.sqrt(joint.covariance[kf + 2, kf + 2]))
    sigma_u = (first.z[4] + 3.0 * first.z[5] * q[2] ** 2) * sigma
    by_q[:, 2] *= finite_slope(q[2], sigma_u, *first.z[4:]) * min(sigma_u, 1.0) / sigma
    J, rows = np.hstack((-R @ skew(y), R, R @ mount[:3, :3] @ by_q)), np.r_[columns[:6], columns[12:]]
    np.testing.assert_allclose(point, T_a[:3, 3] + R @ y, rtol=1e-12)
    np.testing.assert_allclose(covariance, J @ joint.covariance[np.ix_(rows, rows)] @ J.T, rtol=1e-9)


def _fuse(composites):
    """All composites of a chain as one Gaussian, linearly: each one's stated prior divided out, base linked to P2.

    State: per boundary x, y, z, roll, pitch, yaw | features by key | drift; information form about the means.
    """
    keys = sorted({f.key for c in composites for f in c.features})
    nodes = len(composites) + 1
    size = 6 * nodes + 3 * len(keys) + 3
    information, vector = 1e-9 * np.eye(size), np.zeros(size)
    information[:2, :2] += 1e10 * np.eye(2)
    for n, c in enumerate(composites):
        M = np.zeros((len(c.mean), size))
        M[:4, 6 * n + 2 : 6 * n + 6] = np.eye(4)
        M[4:10, 6 * n + 6 : 6 * n + 12] = np.eye(6)
        M[4:6, 6 * n : 6 * n + 2] -= np.eye(2)
        for i, f in enumerate(c.features):
            at = 6 * nodes + 3 * keys.index(f.key)
            M[10 + 3 * i : 13 + 3 * i, at : at + 3] = np.eye(3)
            M[10 + 3 * i : 12 + 3 * i, 6 * n : 6 * n + 2] -= np.eye(2)
        M[-3:, -3:] = np.eye(3)
        full = np.linalg.inv(c.covariance)
        information += M.T @ full @ M
        vector += M.T @ full @ c.mean
        if n:  # the first one's prior on the drift is the chain's own
            P, rows = np.linalg.inv(c.prior_covariance), np.r_[0:4, len(c.mean) - 3 : len(c.mean)]
            information -= M[rows].T @ P @ M[rows]
            vector -= M[rows].T @ P @ c.prior_mean
    covariance = np.linalg.inv(information)
    return covariance @ vector, covariance, keys, nodes


def test_chained_composites_say_what_one_over_the_whole_chain_says():
    """Were anything counted twice, the fused sigmas would be too small; were it lost, too large.

    Without drawn noise every part is linearised at the truth: what remains is the bend of ranges in theta, under 1 %.
    """
    world = replace(CALM, targets=corridor(5, 8.0, z=-2.0), pitch=0.02, noise=0.0, drift=(0.0, 0.0, 0.0))
    (whole,) = _composites(world, 40, 1002, WHOLE)
    parts = _composites(world, 40, 1002, CompositeParameters(pings=10, wait_pings=0, window=30))
    assert len(parts) >= 3
    assert [c.first for c in parts] == [True] + [False] * (len(parts) - 1)
    mean, covariance, keys, nodes = _fuse(parts)
    assert sorted(f.key for f in whole.features) == keys
    assert sum(f.detections for c in parts for f in c.features) == sum(f.detections for f in whole.features)
    order = [keys.index(f.key) for f in whole.features]
    at = np.r_[2:6, 6 * nodes - 6 : 6 * nodes, [6 * nodes + 3 * k + i for k in order for i in range(3)], -3:0]
    sigma, expected = np.sqrt(np.diag(covariance))[at], np.sqrt(np.diag(whole.covariance))
    np.testing.assert_allclose(sigma, expected, rtol=0.01)
    assert np.abs((mean[at] - whole.mean) / expected).max() < 0.02


def test_where_nothing_was_seen_the_composite_is_the_motion_alone():
    world = replace(CALM, targets=np.zeros((0, 3)))
    (c,) = _composites(world, 20, 1003, WHOLE)
    assert c.features == ()
    run = simulate(world, 20, 1003)
    travelled = run.poses[-1][1][0] - run.poses[0][1][0]
    sigma = np.sqrt(c.covariance[4, 4])
    # along x: 19 steps of 1 cm, and the drift's prior of 5 cm/s over 19 s
    assert sigma == pytest.approx(np.hypot(np.sqrt(19) * 0.01, 19 * np.hypot(0.05, 0.0005)), rel=0.05)
    assert abs(c.mean[4] - travelled) < 3 * sigma
    np.testing.assert_allclose(c.mean[-3:], 0.0, atol=0.01)


def test_the_stated_prior_is_the_marginal_of_the_part_before():
    parts = _composites(CALM, 40, 1004, CompositeParameters(pings=10, wait_pings=0, window=30))
    for before, after in pairwise(parts):
        assert before.stamp_ns == after.start_ns
        np.testing.assert_array_equal(after.prior_mean[:4], before.mean[6:10])
        np.testing.assert_allclose(after.prior_covariance[:4, :4], before.covariance[6:10, 6:10], rtol=1e-12)


def test_covariances_are_symmetric_and_positive():
    for c in _composites(World(corridor(), clutter=2.0), 80, 1005, CompositeParameters(), FeatureParameters()):
        assert np.isfinite(c.mean).all() and np.array_equal(c.covariance, c.covariance.T)
        scale = 1.0 / np.sqrt(np.diag(c.covariance))
        assert np.linalg.eigvalsh(c.covariance * np.outer(scale, scale))[0] > 0.0
