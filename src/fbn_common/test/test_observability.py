"""N1 to N8 against the published case, the definition of each, and a wave solved another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from fbn_common.observability import GRAVITY, Motion, Wave, numbers, thresholds
from fbn_common.parameters import ParameterError

CARIBOU = Motion(1.5, np.deg2rad(10.0), 0.1, 3.0, 0.1, 0.7, 10.0, -10.0, Wave(0.5, 8.0, 20.0))


def test_the_published_case_has_the_published_numbers() -> None:
    """N3 is printed there as 0.22; its own formula gives 1.5 * 0.1745 / (2 * 9 * 0.1) = 0.145."""
    n = numbers(CARIBOU)
    assert n[:2] == pytest.approx((5.0, 0.125))
    assert n[2] == pytest.approx(0.145, abs=5e-4)
    assert n[3:6] == pytest.approx((0.0556, 0.35, 0.407), abs=5e-4)


def test_each_number_is_the_change_from_ping_to_ping_over_the_wavelength() -> None:
    """Range to a point ahead, at broadside, in a turn and under acceleration, by the exact geometry of one ping."""
    m = replace(CARIBOU, ping_rate=20.0)  # a short ping: what is left out is of higher order
    dt, r, n = 1.0 / m.ping_rate, m.range_min, numbers(m)
    ahead = r - (r - m.speed * dt)
    passing = np.hypot(r, m.speed * dt) - r  # at broadside: V^2 t^2 / 2r
    assert n[0] == pytest.approx(ahead / m.wavelength)
    assert n[1] == pytest.approx(passing / m.wavelength, rel=1e-3)  # next order: (V t / r)^2 / 4 = 1e-5
    radius = m.speed / m.turn_rate  # far target at broadside: the sagitta of the turning circle
    assert n[2] == pytest.approx(radius * (1.0 - np.cos(m.turn_rate * dt)) / m.wavelength, rel=1e-4)
    assert n[3] == pytest.approx(0.5 * m.acceleration * dt**2 / m.wavelength)
    beam = m.wavelength / m.aperture
    assert n[4] == pytest.approx(np.arctan(m.speed * dt / r) / beam, rel=1e-4)
    assert n[5] == pytest.approx(m.turn_rate * dt / beam)


@given(st.floats(1.0, 15.0), st.floats(0.5, 300.0))
def test_the_wave_number_solves_the_dispersion_relation(period: float, depth: float) -> None:
    wave = Wave(1.0, period, depth)
    deep = wave.frequency**2 / GRAVITY
    exact = brentq(lambda K: K * np.tanh(K * depth) - deep, 1e-6, 10.0 * deep + 10.0 / depth, xtol=1e-14)
    assert wave.number == pytest.approx(exact, rel=1e-9)


def test_waves_move_the_water_as_linear_theory_says() -> None:
    wave = Wave(0.5, 8.0, 20.0)
    K, h, z = wave.number, 20.0, -10.0
    given = GRAVITY * 0.5 * K / wave.frequency * np.cosh(K * (z + h)) / np.cosh(K * h)
    assert wave.shallow_speed(z) == pytest.approx(given)
    deep = Wave(0.5, 4.0, 500.0)  # 25 m long: the bed is of no account
    assert deep.shallow_speed(-3.0) == pytest.approx(deep.deep_speed(-3.0), rel=1e-6)
    assert numbers(CARIBOU)[7] == pytest.approx(given / (0.1 * 3.0))


def test_the_depth_of_an_ocean_is_no_overflow() -> None:
    assert np.isfinite(Wave(1.0, 1.0, 11_000.0).shallow_speed(-5_000.0))


def test_a_detectors_thresholds_are_its_sigmas_in_wavelengths_and_beams() -> None:
    t = thresholds(0.05, 0.0175, 0.1, 0.7)
    assert t[0] == t[3] == t[7] == pytest.approx(0.5)
    assert t[4] == t[5] == pytest.approx(0.0175 * 0.7 / 0.1)
    assert thresholds(0.025, 0.25 * 0.1 / 0.7, 0.1, 0.7) == pytest.approx((0.25,) * 8)  # the published resolution


@pytest.mark.parametrize("wrong", [{"ping_rate": 0.0}, {"speed": -1.0}, {"height": 1.0}, {"height": -21.0}])
def test_what_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        replace(CARIBOU, **wrong)
