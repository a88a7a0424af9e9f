"""The kernels of the motion filters: Jacobians, splitting of steps, positive definiteness, taking over covariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbn_common.lie import matrix_from_rpy, so3_log
from fbn_common.motion_ekf.adopt import adopt_covariance, gained_information, joint_covariance, usable_parameters
from fbn_common.motion_ekf.covariance import wander
from fbn_common.motion_ekf.layout import (
    DEVIATION,
    ESTIMATED_REFERENCE,
    GRID_NS,
    OWN,
    SIZE_REFERENCE,
    SNAPSHOT_NS,
    STEADY,
    WATER,
    X_DEVIATION,
    X_PARAMETERS,
    X_SIZE,
    X_STEADY,
    X_VELOCITY,
    Config,
    Kind,
)
from fbn_common.motion_ekf.measure import (
    COLUMNS,
    apply_error,
    cholesky,
    correct,
    deviation_waves,
    innovation_covariance,
    model,
    project,
    whiten,
)
from fbn_common.motion_ekf.monitor import Watch
from fbn_common.motion_ekf.parameters import CompassParameters, DepthParameters, SurfaceParameters, considered
from fbn_common.motion_ekf.propagate import propagate, rotation_of, set_rotation
from fbn_common.motion_ekf.start import first_state
from fbn_common.motion_ekf.timeline import MotionLog
from fbn_common.motion_ekf.warm_up import standstill
from fbn_common.records import VehicleParameters, Verdict
from fbn_common.types import Array

N = SIZE_REFERENCE
TAU = np.array([300.0] * 5 + [np.inf] * 2 + [300.0] * 8)
CONFIG = Config(
    ESTIMATED_REFERENCE, np.tile([0, ESTIMATED_REFERENCE], (len(Kind), 1)), SNAPSHOT_NS, np.full(15, 1e-6),
    np.full(15, 1e3), 1e-6, 0.04, 300.0, TAU, np.full(15, 0.01), 1.18, 0.0, 2.0, 0.2, 0.7, 0.0,
    np.full((4, len(Kind)), 50.0), np.full(len(Kind), 1e18), 0.3 * np.ones((len(Kind), 3)), 0.1, 3.0, 1.0, True, 60.0,
)  # fmt: skip
floats = st.lists(st.floats(-1.0, 1.0), min_size=42, max_size=42).map(np.array)
DATA = {
    Kind.COMPASS: np.concatenate((matrix_from_rpy(np.array([0.1, -0.1, 0.7])).ravel(), 0.01 * np.eye(3).ravel())),
    Kind.DEPTH: np.array([-3.0, 0.01]),
    Kind.CLIMB: np.array([0.0, 0.01, 0.1, 0.5, 0.1]),  # tilt's effect on the altitude itself is left out, see below
    Kind.POSITION: np.array([3.0, -2.0, 4.0, 0.5, 3.0]),
    Kind.RANGE: np.array([30.0, 20.0, -5.0, 33.0, 0.5, 0.0, 0.0, 0.0]),
}


def state(u: Array) -> Array:
    x = np.zeros(X_SIZE)
    x[:3] = 5.0 * u[:3]
    set_rotation(x, matrix_from_rpy(u[3:6]))
    x[X_VELOCITY : X_VELOCITY + 6] = u[6:12]
    x[X_PARAMETERS:X_DEVIATION] = 0.5 + 0.2 * u[12:27]
    x[X_DEVIATION:] = 0.01 * u[27:36]
    return x


def covariance(seed: int) -> Array:
    a = np.random.default_rng(seed).standard_normal((N, 2 * N))
    p = 0.01 * a @ a.T / N
    return np.asarray(0.5 * (p + p.T))


def innovation(kind: Kind, x: Array, data: Array | None = None) -> tuple[Array, Array, Array]:
    """Innovation (m,), noise (m, m), Jacobian (m, N) of a measurement."""
    nu, noise, h, columns = np.zeros(3), np.zeros((3, 3)), np.zeros((3, COLUMNS)), np.zeros(COLUMNS, np.int64)
    row = np.array([0, 0, 0, 0, 0, 0, 5.0, 0.0])
    m, k = model(int(kind), x, DATA[kind] if data is None else data, row, 1.0, CONFIG, nu, noise, columns, h)
    full = np.zeros((m, N))
    for c in range(k):
        full[:, columns[c]] += h[:m, c]
    return nu[:m].copy(), noise[:m, :m].copy(), full


@pytest.mark.parametrize("kind", list(DATA))
@given(floats)
def test_measurement_jacobians_equal_numerical_derivatives(kind: Kind, u: Array) -> None:
    x = state(u)
    if kind is Kind.COMPASS:  # near the measured attitude, where the filter works: error 0.5 of the angle between
        x[X_DEVIATION:] = 0.0
        set_rotation(x, matrix_from_rpy(np.array([0.1, -0.1, 0.7]) + 1e-4 * u[3:6]))
    _, _, h = innovation(kind, x)  # of CLIMB without the tilt of the beam: what is constant of it cancels with the base
    step, numeric = 1e-6, np.zeros((len(h), ESTIMATED_REFERENCE))
    for j in range(ESTIMATED_REFERENCE):
        ends = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            dx = np.zeros(ESTIMATED_REFERENCE)
            dx[j] = sign * step
            apply_error(moved, dx)
            ends.append(innovation(kind, moved)[0])
        numeric[:, j] = -(ends[0] - ends[1]) / (2.0 * step)  # the innovation is the measurement less the prediction
    tolerance = 2e-4 if kind is Kind.COMPASS else 1e-6
    np.testing.assert_allclose(h[:, :ESTIMATED_REFERENCE], numeric, atol=tolerance)


@given(floats)
def test_a_range_linearised_elsewhere_is_the_tangent_of_the_range_there(u: Array) -> None:
    there, here, at = state(u), state(u), DATA[Kind.RANGE].copy()
    here[:2] += 50.0 * u[30:32]
    lever = rotation_of(there) @ CONFIG.lever[Kind.RANGE]
    at[5:] = 1.0, *(there[:2] + lever[:2])
    exact, _, slope = innovation(Kind.RANGE, there)
    tangent, _, same = innovation(Kind.RANGE, here, at)
    np.testing.assert_allclose(same[:, :2], slope[:, :2], atol=1e-12)
    np.testing.assert_allclose(tangent, exact - slope[:, :2] @ (here - there)[:2], atol=1e-10)


def motions(u: Array) -> MotionLog:
    """One step of a made-up vehicle whose dynamics are linear."""
    rng = np.random.default_rng(int(1e6 * abs(u[0])) + 1)
    log = MotionLog()
    log.put(standstill(0))
    k = (GRID_NS // GRID_NS) % len(log.rows.stamp)
    rows = log.rows
    rows.mean[k] = 0.01 * rng.standard_normal(18)
    rows.mean[k, 6:] = 0.3 * rng.standard_normal(12)
    rows.attitude[k] = matrix_from_rpy(u[27:30]).ravel()
    rows.parameters[k] = 0.5 + 0.2 * u[12:27]
    jacobian = 0.01 * rng.standard_normal((12, 24))
    jacobian[6:, 3:9] += np.eye(6)
    rows.jacobian[k] = jacobian
    a = 1e-3 * rng.standard_normal((12, 12))
    rows.noise[k] = a @ a.T
    return log


def error(a: Array, b: Array) -> Array:
    """``b (-) a`` (27,)."""
    turn = so3_log(np.ascontiguousarray(rotation_of(a).T @ rotation_of(b)))
    return np.concatenate((b[:3] - a[:3], turn, b[X_VELOCITY:] - a[X_VELOCITY:]))


@given(floats, st.floats(1e-5, 1.0 - 1e-5))
def test_a_step_taken_in_two_parts_is_the_whole_step(u: Array, a: float) -> None:
    log = motions(u)
    log.rows.mean[1, 12:18] = log.rows.mean[1, 6:12] + 0.005 * u[30:36]  # a hundredth of a second at 0.5 m/s^2
    log.rows.mean[1, 3:6] = 0.005 * u[33:36]
    log.rows.jacobian[1] = 0.0
    log.rows.jacobian[1, 6:, 3:9] = 0.98 * np.eye(6)
    log.rows.jacobian[1, :6, 3:9] = 0.01 * np.eye(6)
    start, whole, parts, p, q = state(u), state(u), state(u), covariance(3), covariance(3)
    propagate(whole, p, log.rows, 1, 0.0, 1.0, 0.01, CONFIG)
    propagate(parts, q, log.rows, 1, 0.0, a, a * 0.01, CONFIG)
    propagate(parts, q, log.rows, 1, a, 1.0, (1 - a) * 0.01, CONFIG)
    # second order of the step: its second part is turned by the first's rotation, and the velocity's offset decays
    travel, turn = np.linalg.norm(error(start, whole)[:6].reshape(2, 3), axis=1)
    offset = np.linalg.norm(start[X_VELOCITY : X_VELOCITY + 6] - log.rows.mean[1, 6:12])
    np.testing.assert_allclose(
        error(whole, parts)[:6], 0.0, atol=a * (1 - a) * (travel * turn + 0.01 * 0.02 * offset) + 1e-12
    )
    np.testing.assert_allclose(q, p, atol=3e-4 * np.abs(p).max())


@given(floats, st.integers(0, 1000), st.sampled_from(list(DATA)), st.sampled_from([(0, 27), (2, 15)]))
def test_an_update_keeps_covariance_positive_definite_and_what_is_considered_untouched(
    u: Array, seed: int, kind: Kind, estimated: tuple[int, int]
) -> None:
    x, p = state(u), covariance(seed)
    before = p.copy()
    nu, noise, h = innovation(kind, x)
    m, columns = len(nu), np.arange(N)
    hp = project(p, columns, h, m, N)
    factor = innovation_covariance(hp, columns, h, noise, m, N)
    assert cholesky(factor)
    white = nu[:, None].copy()
    whiten(factor, white)
    whiten(factor, hp)
    correct(x, p, hp, white[:, 0].copy(), *estimated)
    first, last = estimated
    rest = [*range(first), *range(last, N)]
    assert np.array_equal(p, p.T)
    assert np.linalg.eigvalsh(p)[0] > 0.0
    assert np.array_equal(p[np.ix_(rest, rest)], before[np.ix_(rest, rest)])
    optimal = before - before @ h.T @ np.linalg.solve(h @ before @ h.T + noise, h @ before)
    inside = slice(first, last)
    np.testing.assert_allclose(p[inside, :], optimal[inside, :], atol=1e-12)


@given(st.integers(0, 10_000))
def test_adopted_covariances_leave_the_whole_positive_definite(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, a = covariance(seed), rng.standard_normal((12, 12))
    new = a @ np.diag(10.0 ** rng.uniform(-6, 2, 12)) @ a.T + 1e-9 * np.eye(12)
    adopt_covariance(p, slice(15, 27), new)
    np.testing.assert_allclose(p[15:27, 15:27], new, rtol=1e-12)
    d = 1.0 / np.sqrt(np.diagonal(p))
    assert np.linalg.eigvalsh(p * np.outer(d, d))[0] > -1e-10  # correlations; rounding of 12 decades


def test_followers_learn_as_by_a_measurement_of_what_is_adopted() -> None:
    p, states = covariance(2), slice(15, 34)
    h = np.random.default_rng(5).standard_normal((4, 19))
    prior = p[states, states].copy()
    posterior = np.linalg.inv(np.linalg.inv(prior) + 50.0 * h.T @ h)
    gain = p[:, states] @ np.linalg.inv(prior)
    expected = p - gain @ (prior - posterior) @ gain.T
    partly = p.copy()
    adopt_covariance(p, states, posterior, slice(0, 15))
    np.testing.assert_allclose(p[:34, :34], expected[:34, :34], atol=1e-10)
    adopt_covariance(partly, states, posterior, slice(3, 6))
    np.testing.assert_allclose(partly[3:6], expected[3:6], atol=1e-10)
    assert np.linalg.eigvalsh(partly - expected)[0] > -1e-10  # careful wherever nothing follows


def test_adopting_the_same_covariance_changes_nothing() -> None:
    p = covariance(1)
    before = p.copy()
    adopt_covariance(p, slice(15, 27), before[15:27, 15:27])
    np.testing.assert_allclose(p, before, atol=1e-14)


@given(st.integers(0, 10_000))
def test_information_gained_and_information_held_make_what_is_known(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before = covariance(seed)[:4, :4]
    h = rng.standard_normal((2, 4))
    after = np.linalg.inv(np.linalg.inv(before) + h.T @ h)
    np.testing.assert_allclose(
        gained_information(before, after), h.T @ h, atol=1e-9 * np.linalg.norm(np.linalg.inv(before))
    )


def test_a_watch_names_what_is_wrong_with_a_stream() -> None:
    watch = Watch(frozen_after=3, dead_after_s=1.0)
    bounds = (0, 10_000_000_000)
    assert watch.complaint(0) == "no data yet"
    assert watch.objection(1, b"a", bounds) is None
    assert watch.objection(1, b"a", bounds) == (Verdict.REFUSED, "duplicate")
    assert watch.objection(-1, b"a", bounds)[0] is Verdict.LATE  # type: ignore[index]
    assert "ahead of the clock" in watch.objection(20_000_000_000, b"a", bounds)[1]  # type: ignore[index]
    assert [watch.objection(s, b"a", bounds) is None for s in (2, 3, 4)] == [True, True, False]
    assert watch.complaint(4) == "frozen: 4 equal values in a row"
    assert watch.objection(5, b"b", bounds) is None
    assert watch.complaint(3_000_000_005) == "no data for 3.0 s"


def test_what_iron_does_to_the_compass_comes_back_with_the_heading_and_not_before() -> None:
    """Hard iron turns once, soft iron twice a circle: opposite headings share only the constant and the soft part."""
    waves = [
        deviation_waves(matrix_from_rpy(np.array([0.1, -0.2, yaw]))) for yaw in (0.3, 0.3 + np.pi, 0.3 + 2.0 * np.pi)
    ]
    np.testing.assert_allclose(waves[0], waves[2], atol=1e-12)
    np.testing.assert_allclose(waves[1], waves[0] * np.array([1.0, -1.0, -1.0, 1.0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(waves[0][1:3], [np.sin(0.3), np.cos(0.3)], atol=1e-12)


def test_deviation_has_its_whole_variance_at_every_heading() -> None:
    compass = CompassParameters()
    _, variance = considered(compass, DepthParameters(), SurfaceParameters())
    for yaw in np.linspace(-3.0, 3.0, 7):
        waves = deviation_waves(matrix_from_rpy(np.array([0.0, 0.0, yaw])))
        assert waves**2 @ variance[DEVIATION - OWN : STEADY - OWN] == pytest.approx(compass.deviation**2)


def test_a_deviating_compass_is_turned_about_the_vertical_by_each_of_its_coefficients() -> None:
    """Against a compass that really deviates: the innovation is what the Jacobian says, to second order of 1e-4 rad."""
    r = matrix_from_rpy(np.array([0.1, -0.1, 0.7]))
    for i, wave in enumerate(deviation_waves(r)):
        x, size = state(np.zeros(42)), 1e-4
        set_rotation(x, r)
        DATA[Kind.COMPASS][:9] = (matrix_from_rpy(np.array([0.0, 0.0, size * wave])) @ r).ravel()
        nu, _, h = innovation(Kind.COMPASS, x)
        DATA[Kind.COMPASS][:9] = r.ravel()
        np.testing.assert_allclose(nu, size * h[:, DEVIATION + i], atol=1e-8)


def test_the_steady_waters_walk_grows_with_the_waters_own_speed() -> None:
    """Over one step without motion: the floor and the share of the mean square, P's own part in it as well."""
    motions = MotionLog()
    motions.put(standstill(0))
    for speed in (0.0, 0.3):
        x, p = state(np.zeros(42)), 1e-4 * np.eye(N)
        x[X_STEADY] = speed
        propagate(x, p, motions.rows, 1, 0.0, 1.0, 0.01, CONFIG)
        square = 0.5 * speed**2 + 1e-4
        expected = 0.01 * (1e-6 + CONFIG.water_share * square)
        assert p[STEADY + 1, STEADY + 1] - 1e-4 == pytest.approx(expected, rel=1e-6)
        reverted = 1e-4 * 0.01 / 300.0  # of the water to its steady part
        assert p[WATER + 1, STEADY + 1] - reverted == pytest.approx(expected, rel=1e-3)  # the water goes along


def test_water_left_alone_comes_to_wander_about_its_steady_part_however_long_the_steps() -> None:
    """Closed form: after time t the offset has shrunk by exp(-t/tau), and its variance goes to the stationary one."""
    config = CONFIG._replace(walk=np.zeros(15), water_share=0.0)
    speed, ends = 0.3, []
    for steps in (1, 600):
        x, p = state(np.zeros(42)), 1e-12 * np.eye(N)
        x[X_STEADY], x[X_PARAMETERS + 12], x[X_PARAMETERS + 13] = speed, speed + 0.1, -0.2
        for _ in range(steps):
            wander(x, p, 600.0 / steps, config)
        ends.append((x, p))
    (x, p), (stepped, p_stepped) = ends
    left = np.exp(-600.0 / config.wander_time)
    np.testing.assert_allclose(x[X_PARAMETERS + 12 : X_DEVIATION - 1], [speed + 0.1 * left, -0.2 * left], rtol=1e-12)
    stationary = config.wander * 0.5 * speed**2
    assert p[WATER, WATER] == pytest.approx(stationary * (1.0 - left**2), rel=1e-6)
    np.testing.assert_allclose(stepped, x, rtol=1e-12)
    np.testing.assert_allclose(p_stepped, p, rtol=1e-9, atol=1e-18)


def test_wandering_is_the_transition_of_a_gauss_markov_process_about_another_state() -> None:
    p, config = covariance(5), CONFIG._replace(walk=np.zeros(15), water_share=0.0, wander=0.0)
    f, k = np.eye(N), np.exp(-40.0 / CONFIG.wander_time)
    for i in range(2):
        f[WATER + i, WATER + i], f[WATER + i, STEADY + i] = k, 1.0 - k
    expected = f @ p @ f.T
    wander(state(np.zeros(42)), p, 40.0, config)
    np.testing.assert_allclose(p, expected, atol=1e-15)


def test_water_of_the_prior_is_steady_but_for_its_wandering() -> None:
    """What is known of the steady part, and the variance by which the water wanders about it, make up the prior."""
    compass = np.concatenate((np.eye(3).ravel(), 0.01 * np.eye(3).ravel()))
    prior = VehicleParameters(0, "map", np.arange(15.0), covariance(3)[:15, :15].copy())
    p = first_state(0, compass, None, prior, np.zeros(6), 1.0, np.ones(15), 0.04, 5).covariance
    known = p[WATER : WATER + 2, WATER : WATER + 2]
    steady = p[STEADY : STEADY + 2, STEADY : STEADY + 2]
    about = known + steady - 2.0 * p[WATER : WATER + 2, STEADY : STEADY + 2]
    np.testing.assert_allclose(known, prior.covariance[12:14, 12:14], atol=1e-11)
    np.testing.assert_allclose(about, 0.04 * steady, atol=1e-12)


def test_parameters_with_what_is_further_known_are_one_gaussian_and_without_the_old_fifteen() -> None:
    c = covariance(3)[:24, :24]
    known = VehicleParameters(0, "map", np.ones(15), c[:15, :15].copy(), np.zeros(9), c[15:].copy())
    np.testing.assert_array_equal(joint_covariance(known), c)
    bare = VehicleParameters(0, "map", np.ones(15), c[:15, :15].copy())
    np.testing.assert_array_equal(joint_covariance(bare), c[:15, :15])
    assert usable_parameters(known)
    assert usable_parameters(bare)
    for spoilt in (np.full(9, np.nan), np.zeros(9)):
        wrong = VehicleParameters(0, "map", np.ones(15), c[:15, :15].copy(), spoilt, -c[15:])
        assert not usable_parameters(wrong)
