"""The water's motion: waves by linear theory, currents that come from nowhere and go nowhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbn_common.types import Array
from fbn_sim.randomness import gauss_markov, generator
from fbn_sim.sea import GRAVITY, Sea, current, draw_sea, elevation, orbital, wave_number

SEA = Sea(current_speed_min=0.3, current_speed_max=0.3, wave_height=0.5, wave_period=3.0)
TABLE = draw_sea(SEA, 8.0, 600.0, 3)
PLACES = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-7.0, -0.2)).map(np.array)
H = 1e-5


@settings(max_examples=30, deadline=None)
@given(place=PLACES, t=st.floats(0.0, 500.0))
def test_waves_neither_make_nor_swallow_water_nor_turn_it(place: Array, t: float) -> None:
    def velocity(p: Array) -> Array:
        return orbital(TABLE, t, p)[0]

    gradient = np.stack([(velocity(place + H * e) - velocity(place - H * e)) / (2 * H) for e in np.eye(3)], axis=1)
    assert np.trace(gradient) == pytest.approx(0.0, abs=1e-7)  # rounding: 1e-15 / H = 1e-10
    np.testing.assert_allclose(gradient, gradient.T, atol=1e-7)


@settings(max_examples=30, deadline=None)
@given(place=PLACES, t=st.floats(1.0, 500.0))
def test_the_acceleration_is_that_of_a_particle(place: Array, t: float) -> None:
    velocity, acceleration = orbital(TABLE, t, place)
    later, earlier = orbital(TABLE, t + H, place + H * velocity)[0], orbital(TABLE, t - H, place - H * velocity)[0]
    np.testing.assert_allclose(acceleration, (later - earlier) / (2 * H), atol=1e-7)


def test_the_surface_moves_as_fast_as_the_water_there() -> None:
    place, t = np.array([3.0, -2.0, 0.0]), 12.0
    rate = (elevation(TABLE, t + H, place) - elevation(TABLE, t - H, place)) / (2 * H)
    assert orbital(TABLE, t, place)[0][2] == pytest.approx(rate, abs=1e-7)


def test_wave_numbers_satisfy_the_dispersion_relation() -> None:
    omega = np.array([0.5, 1.0, 3.0, 6.0])
    k = wave_number(omega, 5.0)
    np.testing.assert_allclose(GRAVITY * k * np.tanh(5.0 * k), omega**2, rtol=1e-12)


def test_the_significant_wave_height_is_that_asked_for() -> None:
    # the components keep 0.7 to 2 times the peak's frequency: about 0.9 of the variance, in 8 steps
    amplitude = TABLE.waves[:, 0]
    assert 4.0 * np.sqrt((amplitude**2).sum() / 2.0) == pytest.approx(SEA.wave_height, rel=0.1)


@settings(max_examples=30, deadline=None)
@given(place=PLACES, t=st.floats(0.0, 500.0))
def test_eddies_neither_make_nor_swallow_water(place: Array, t: float) -> None:
    east, north = H * np.eye(3)[0], H * np.eye(3)[1]
    along = (current(TABLE, t, place + east) - current(TABLE, t, place - east))[0]
    across = (current(TABLE, t, place + north) - current(TABLE, t, place - north))[1]
    assert (along + across) / (2 * H) == pytest.approx(0.0, abs=1e-7)


def test_the_current_is_slower_at_the_bed_and_of_the_size_asked_for() -> None:
    speeds = []
    for seed in range(40):
        table = draw_sea(SEA, 8.0, 600.0, seed)
        top, low = (np.linalg.norm(current(table, 300.0, np.array([0.0, 0.0, z]))) for z in (-4.0, -7.9))
        assert low < top
        speeds.append(top)
    # factor (1/2)^(1/7) = 0.906; variation and eddies of 15 % each, over 40 draws
    assert np.mean(speeds) == pytest.approx(0.3 * 0.906, rel=0.1)


def test_a_gauss_markov_process_has_its_variance_and_correlation_time() -> None:
    x = gauss_markov(generator(1, "test"), (400_000,), 1.0, 2.0, 50.0)
    # 400,000 s / (2 tau) = 4,000 independent samples: standard deviation to 1.1 %, correlation to 0.015
    assert x.std() == pytest.approx(2.0, rel=0.04)
    assert np.mean(x[:-50] * x[50:]) / x.var() == pytest.approx(np.exp(-1.0), abs=0.05)
