"""What the filters do by the batch is what they would do one by one: motions taken in, odometry made, P propagated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fbn_common.lie import matrix_from_rpy, quaternion_from_matrix
from fbn_common.motion_ekf.covariance import new_covariance_scratch, push
from fbn_common.motion_ekf.layout import (
    GRID_NS,
    ROTATION,
    SENSOR_SIZE,
    SIZE_REFERENCE,
    SNAPSHOT_NS,
    VELOCITY,
    X_ROTATION,
    X_SIZE,
    X_VELOCITY,
    Snapshots,
)
from fbn_common.motion_ekf.monitor import all_finite
from fbn_common.motion_ekf.output import odometry
from fbn_common.motion_ekf.timeline import MotionLog
from fbn_common.motion_ekf.warm_up import standstill
from fbn_common.records import PredictedMotion
from fbn_common.types import Array

RNG = np.random.default_rng(3)


def motion(k: int) -> PredictedMotion:
    """The k-th step of nothing in particular, every part of it different."""
    still = standstill(k * GRID_NS)
    parts = (
        "increment", "rotation", "velocity_start", "velocity_end", "parameters", "jacobian_velocity",
        "jacobian_attitude", "jacobian_parameters", "noise",
    )  # fmt: skip
    drawn = {name: RNG.standard_normal(getattr(still, name).shape) for name in parts}
    turned = quaternion_from_matrix(matrix_from_rpy(RNG.uniform(-1.0, 1.0, 3)))
    return replace(still, attitude_start=turned, **drawn)


def test_motions_taken_together_are_those_taken_one_by_one() -> None:
    motions, together, alone = [motion(k) for k in range(7)], MotionLog(), MotionLog()
    assert together.put(*motions) == ([""] * 7, -1)
    for m in motions:
        alone.put(m)
    for a, b in zip(together.rows, alone.rows, strict=True):
        np.testing.assert_array_equal(a, b)
    assert (together.first_ns, together.newest_ns) == (alone.first_ns, alone.newest_ns) == (0, 7 * GRID_NS)


def test_each_part_of_a_motion_lands_where_the_kernels_look_for_it() -> None:
    m, log = motion(4), MotionLog()
    log.put(m)
    rows, k = log.rows, 5
    np.testing.assert_array_equal(
        rows.mean[k], np.concatenate((m.increment, m.rotation, m.velocity_start, m.velocity_end))
    )
    by = (m.jacobian_attitude, m.jacobian_velocity, m.jacobian_parameters)
    np.testing.assert_array_equal(rows.jacobian[k], np.concatenate(by, axis=1))
    np.testing.assert_array_equal(rows.noise[k], m.noise)
    np.testing.assert_array_equal(rows.parameters[k], m.parameters)
    quaternion = quaternion_from_matrix(np.ascontiguousarray(rows.attitude[k].reshape(3, 3)))
    np.testing.assert_allclose(quaternion, m.attitude_start * np.sign(m.attitude_start[3]), atol=1e-14)


def test_a_motion_that_cannot_be_used_keeps_none_of_the_others_out() -> None:
    good, log = [motion(k) for k in range(3)], MotionLog()
    broken = replace(motion(3), noise=np.full((12, 12), np.nan))
    shifted = replace(motion(4), start_ns=4 * GRID_NS + 1)
    errors, again_ns = log.put(good[0], broken, good[1], shifted, good[2])
    assert again_ns == -1
    assert [bool(e) for e in errors] == [False, True, False, True, False]
    assert errors[1] == "not finite" and "grid" in errors[3]
    assert [log.has(k * GRID_NS) for k in range(1, 6)] == [True, True, True, False, False]
    assert log.newest_ns == 3 * GRID_NS


def test_the_first_motion_that_takes_anothers_place_is_named() -> None:
    log = MotionLog()
    log.put(*(motion(k) for k in range(5)))
    unusable = replace(motion(1), noise=np.full((12, 12), np.nan))
    assert log.put(motion(6), unusable, motion(3), motion(2)).again_ns == 2 * GRID_NS
    assert log.put(motion(5)).again_ns == -1


def test_taking_nothing_changes_nothing() -> None:
    log = MotionLog()
    assert log.put() == ([], -1)
    assert log.newest_ns == -1


def snapshots(n: int) -> Snapshots:
    x, roots = np.zeros((n, X_SIZE)), RNG.standard_normal((n, SIZE_REFERENCE, SIZE_REFERENCE))
    for i in range(n):
        x[i] = RNG.standard_normal(X_SIZE)
        x[i, X_ROTATION : X_ROTATION + 9] = matrix_from_rpy(RNG.uniform(-1.0, 1.0, 3)).ravel()
    stamps = SNAPSHOT_NS * np.arange(n, dtype=np.int64)
    return Snapshots(stamps, x, roots @ roots.transpose(0, 2, 1), np.zeros((n, 1, SENSOR_SIZE)))


def test_odometry_turns_the_attitude_errors_covariance_into_fixed_axes() -> None:
    kept, rows = snapshots(5), [3, 4, 1]
    lines = odometry(kept, rows, "odom")
    assert [o.stamp_ns for o in lines] == [3 * SNAPSHOT_NS, 4 * SNAPSHOT_NS, SNAPSHOT_NS]
    for row, line in zip(rows, lines, strict=True):
        x, p = kept.x[row], kept.covariance[row]
        turn = np.eye(6)
        turn[ROTATION:, ROTATION:] = x[X_ROTATION : X_ROTATION + 9].reshape(3, 3)
        np.testing.assert_allclose(line.pose_covariance, turn @ p[:6, :6] @ turn.T, rtol=1e-12, atol=1e-12)
        velocity = slice(VELOCITY, VELOCITY + 6)
        np.testing.assert_array_equal(line.twist_covariance, p[velocity, velocity])
        np.testing.assert_array_equal(line.pose.position, x[:3])
        np.testing.assert_array_equal(line.twist, x[X_VELOCITY : X_VELOCITY + 6])
    assert odometry(kept, [], "odom") == []


@pytest.mark.parametrize("near", [False, True])
def test_the_pushed_covariance_is_that_of_the_whole_transition_matrix(near: bool) -> None:
    n = SIZE_REFERENCE
    root, top, columns = RNG.standard_normal((n, n)), 0.1 * RNG.standard_normal((12, 24)), RNG.standard_normal((12, 3))
    before = root @ root.T
    whole, after, flat, room = np.eye(n), before.copy(), np.zeros((12, 3)), new_covariance_scratch(n)
    push(after, np.zeros((12, 24)), True, columns, room)  # nothing else moves: this shows where the columns belong
    surface = _columns_of(before, after, columns)
    whole[:12, ROTATION : ROTATION + 24] += top
    if near:
        whole[:12, surface] += columns
    after = before.copy()
    push(after, top, near, columns if near else flat, room)
    # products of sums of 40 terms of order 40: 1e-16 of each
    np.testing.assert_allclose(after, whole @ before @ whole.T, rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(after, after.T)


def _columns_of(before: Array, after: Array, columns: Array) -> Array:
    """Which three states ``columns`` took: the rows of P that explain what was added to the others' covariance."""
    added = after[:12, 12:] - before[:12, 12:]
    rows = np.linalg.lstsq(columns, added, rcond=None)[0]
    return np.array([int(np.argmin(np.abs(before[:, 12:] - row).sum(axis=1))) for row in rows])


def test_numbers_are_finite_even_where_their_squares_are_not() -> None:
    assert all_finite(np.full(3, 1e200), 1.0, np.eye(3))
    assert not all_finite(np.array([1.0, np.inf])) and not all_finite(np.array([[np.nan]])) and not all_finite(np.inf)
