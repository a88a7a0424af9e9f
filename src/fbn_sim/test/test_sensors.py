"""The sensors' errors have the sizes, the correlations and the gaps that their parameters say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sim_cases import START_NS, circling, flight

from fbn_common.geodesy import GeodeticPoint, enu_from_geodetic
from fbn_common.lie import matrix_from_quaternion, rpy_from_matrix, wrap
from fbn_common.records import BeaconRange, FluidPressure, Imu, NavSatFix, Range
from fbn_common.types import NS, Array
from fbn_sim.motion import interpolate
from fbn_sim.sensors.compass import Compass, compass_records, draw_deviation, draw_drift
from fbn_sim.sensors.depth import Altimeter, Pressure, altitude_records, pressure_records
from fbn_sim.sensors.position import Beacon, Gps, Lbl, draw_gps_error, gps_records, lbl_records
from fbn_sim.sensors.sample import Entry, Timing, angles, quaternions, rotations

DATUM = GeodeticPoint(42.0, -71.0, 0.0)
NO_ARM = np.zeros(3)


def times(entries: list[Entry]) -> Array:
    return np.array([(e.record.stamp_ns - START_NS) / NS for e in entries])


def yaw_errors(compass: Compass, seed: int) -> tuple[Array, Array]:
    """True yaw and error of the measured one, on circles."""
    motion = circling(3.0)
    deviation = draw_deviation(compass, seed)
    entries = compass_records(compass, deviation, draw_drift(compass, 1300, seed), flight(motion, seed))
    true = angles(rotations(interpolate(motion, times(entries)).orientation))[:, 2]
    given = [
        rpy_from_matrix(matrix_from_quaternion(e.record.orientation))[2] for e in entries if isinstance(e.record, Imu)
    ]
    return true, np.array([wrap(g - t) for g, t in zip(given, true, strict=True)])


def test_compass_deviation_turns_with_heading_and_has_the_amplitude_drawn() -> None:
    compass = Compass(drift_sigma=0.0, hard_iron_min=0.03, hard_iron_max=0.03, soft_iron_min=0.01, soft_iron_max=0.01)
    yaw, error = yaw_errors(compass, 5)
    basis = np.column_stack([np.ones_like(yaw), np.sin(yaw), np.cos(yaw), np.sin(2 * yaw), np.cos(2 * yaw)])
    fit = np.linalg.lstsq(basis, error, rcond=None)[0]
    # 12,000 samples of 0.0087 rad: each coefficient to sqrt(2 / 12,000) 0.0087 = 1e-4; turning at 0.016 m/s^2 tilts
    # the vertical by 0.0016 rad, of which the dipping field makes 0.004 rad, with heading
    assert np.hypot(fit[1], fit[2]) == pytest.approx(0.03, abs=0.005)
    assert np.hypot(fit[3], fit[4]) == pytest.approx(0.01, abs=0.001)
    assert (error - basis @ fit).std() == pytest.approx(compass.yaw_noise, rel=0.05)


def test_what_the_compass_says_of_its_accuracy_is_honest() -> None:
    compass = Compass()
    errors = np.concatenate([yaw_errors(compass, seed)[1] for seed in range(12)])
    assert 0.6 < np.sqrt(np.mean(errors**2)) / compass.stated_yaw_sigma < 1.2


def test_rates_and_accelerations_are_marked_as_absent() -> None:
    compass = Compass()
    entry = compass_records(compass, np.zeros(5), np.zeros(1300), flight(circling(3.0, seconds=10.0)))[0]
    assert isinstance(entry.record, Imu)
    assert entry.record.angular_velocity_covariance[0, 0] == entry.record.linear_acceleration_covariance[0, 0] == -1.0


def test_angles_and_quaternions_undo_each_other() -> None:
    rpy = np.random.default_rng(1).uniform([-3.0, -1.5, -3.0], [3.0, 1.5, 3.0], (200, 3))
    np.testing.assert_allclose(angles(rotations(quaternions(rpy))), rpy, atol=1e-9)
    matrices = np.array([matrix_from_quaternion(q) for q in quaternions(rpy)])
    np.testing.assert_allclose(rotations(quaternions(rpy)), matrices, atol=1e-12)


def test_pressure_is_that_of_the_water_column() -> None:
    sensor = Pressure(drift_sigma=0.0, atmosphere_sigma=0.0)
    entries = pressure_records(sensor, 1000.0, flight(circling(3.0)))
    values = np.array([e.record.fluid_pressure for e in entries if isinstance(e.record, FluidPressure)])
    expected = 101_325.0 + 1000.0 * 9.80665 * 3.0
    assert values.mean() == pytest.approx(expected, abs=4.0 * 80.0 / np.sqrt(len(values)))
    assert values.std() == pytest.approx(80.0, rel=0.05)
    assert not np.any(np.abs(values / sensor.step - np.round(values / sensor.step)) > 1e-9)


def test_the_altimeter_measures_the_height_and_drops_out_as_often_as_it_should() -> None:
    sensor = Altimeter()
    ranges = np.array(
        [e.record.range for e in altitude_records(sensor, flight(circling(3.0))) if isinstance(e.record, Range)]
    )
    n = len(ranges)
    assert (ranges == 0.0).mean() == pytest.approx(sensor.no_bottom, abs=4.0 * np.sqrt(0.03 / n))
    assert np.median(ranges[ranges > 0.0]) == pytest.approx(2.0, abs=4.0 * 0.005 * 2.0)
    assert (ranges > 0.0).sum() > (ranges > 1.8).sum()  # something nearer, now and then


def fixes(gps: Gps, depth: float, seed: int) -> tuple[Array, Array, list[NavSatFix]]:
    """Times, errors (n, 3) [m] and records of the fixes on a circle."""
    motion = circling(depth)
    error = draw_gps_error(gps, 1300, seed)
    found = gps_records(gps, error, NO_ARM, DATUM, flight(motion, seed))
    good = [e for e in found if isinstance(e.record, NavSatFix) and e.record.status >= 0]
    at = interpolate(motion, times(good)).position
    records = [e.record for e in good if isinstance(e.record, NavSatFix)]
    enu = np.array([enu_from_geodetic(r.latitude, r.longitude, r.altitude, DATUM) for r in records]).reshape(-1, 3)
    return times(good), enu - at, records


def test_there_is_no_fix_under_water_and_its_position_is_no_news() -> None:
    entries = gps_records(Gps(), draw_gps_error(Gps(), 1300, 1), NO_ARM, DATUM, flight(circling(3.0)))
    records = [e.record for e in entries if isinstance(e.record, NavSatFix)]
    assert len(records) > 1000
    assert all(r.status == -1 for r in records)
    assert len({r.latitude for r in records}) == 1


def test_the_first_fix_takes_its_time() -> None:
    gps = Gps(splash=0.0)
    for seed in range(5):
        first = fixes(gps, 0.0, seed)[0][0]
        assert gps.to_first_fix_min <= first <= gps.to_first_fix_max + 3.0  # and up to two periods of sampling


def test_gps_errors_stay_for_minutes() -> None:
    gps = Gps(multipath_rate=1e-9, first_sigma=0.0, splash=0.0)
    products, squares = [], []
    for seed in range(60):
        _, error, _ = fixes(gps, 0.0, seed)
        near, far = error[:-240, :2], error[240:, :2]
        products.append((near * far).mean())
        squares.append((error[:, :2] ** 2).mean())
    # 60 runs of 1,200 s hold about 60 * 2 * 2.5 independent samples: 6 %
    assert np.mean(squares) == pytest.approx(gps.slow_sigma**2 + gps.white_sigma**2, rel=0.25)
    assert np.mean(products) / gps.slow_sigma**2 == pytest.approx(np.exp(-1.0), abs=0.17)


def test_what_gps_says_of_its_accuracy_is_honest_but_for_multipath() -> None:
    normalised, far = [], 0
    for seed in range(40):
        _, error, records = fixes(Gps(), 0.0, seed)
        sigma = np.array([np.sqrt(r.position_covariance[0, 0]) for r in records])
        ratio = error[:, :2] / sigma[:, None]
        inside = np.abs(ratio).max(axis=1) < 3.0
        normalised.append((ratio[inside] ** 2).mean())
        far += int((~inside).sum())
    assert 0.6 < np.mean(normalised) < 1.2
    assert far > 0


def test_a_range_belongs_to_the_middle_of_its_travel() -> None:
    lbl = Lbl(noise=0.0, scale_sigma=0.0, missing=0.0, multipath=0.0, beacons={"a": Beacon((300.0, 200.0, -3.0))})
    motion = circling(3.0, speed=2.0, rate=0.0, seconds=200.0)
    entries = lbl_records(lbl, flight(motion))
    records = [e.record for e in entries if isinstance(e.record, BeaconRange)]
    middle = times(entries) - np.array([r.travel_delay for r in records]) / 2.0
    true = np.linalg.norm(interpolate(motion, middle).position - [300.0, 200.0, -3.0], axis=1)
    # half the difference of two ways 0.5 s apart, less the straight line's: below (2 m/s 0.25 s)^2 / (2 * 200 m)
    np.testing.assert_allclose([r.range for r in records], true, atol=2e-3)


def test_replies_go_missing_and_come_by_longer_ways() -> None:
    lbl = Lbl(
        timing=Timing(2.0), beacons={"a": Beacon((300.0, 200.0, -3.0)), "b": Beacon((-300.0, 0.0, -3.0), lie=20.0)}
    )
    motion = circling(3.0)
    entries = lbl_records(lbl, flight(motion))
    assert len(entries) == pytest.approx(2400 * 0.85, rel=0.05)
    a = [e for e in entries if isinstance(e.record, BeaconRange) and e.record.beacon_id == "a"]
    true = np.linalg.norm(interpolate(motion, times(a)).position - [300.0, 200.0, -3.0], axis=1)
    excess = np.array([e.record.range for e in a if isinstance(e.record, BeaconRange)]) - true
    assert (excess > 4.0).mean() == pytest.approx(lbl.multipath * np.exp(-4.0 / 12.0), abs=0.025)


def test_a_line_delivers_in_order_and_no_sooner_than_it_can() -> None:
    sensor = dataclasses.replace(Pressure(), timing=Timing(50.0, latency=0.02, jitter=0.1, drop=0.0))
    entries = pressure_records(sensor, 1000.0, flight(circling(3.0, seconds=60.0)))
    logged = [e.log_time_ns for e in entries]
    assert logged == sorted(logged)
    assert min(e.log_time_ns - e.record.stamp_ns for e in entries) >= 0.02 * NS


def test_messages_are_lost_as_often_as_they_should_be() -> None:
    sensor = dataclasses.replace(Pressure(), timing=Timing(10.0, drop=0.1))
    n = len(pressure_records(sensor, 1000.0, flight(circling(3.0))))
    assert n == pytest.approx(0.9 * 12_000, abs=4.0 * np.sqrt(0.09 * 12_000))


def test_a_sensor_of_rate_zero_is_not_fitted() -> None:
    sensor = dataclasses.replace(Pressure(), timing=Timing(0.0))
    assert pressure_records(sensor, 1000.0, flight(circling(3.0, seconds=60.0))) == []
