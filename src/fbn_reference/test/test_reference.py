"""The reference filter: the GPS rule, refusals, ranges, its service, parameters, faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fbn_common.estimator import Output
from fbn_common.geodesy import geodetic_from_enu
from fbn_common.lie import matrix_from_quaternion, matrix_from_rpy, quaternion_from_matrix
from fbn_common.motion_ekf.layout import DEVIATION, WATER, X_DEVIATION, X_PARAMETERS, X_STEADY
from fbn_common.motion_ekf.measure import deviation_waves
from fbn_common.motion_ekf.parameters import CompassParameters, SurfaceParameters
from fbn_common.motion_ekf.propagate import rotation_of
from fbn_common.records import (
    BeaconRange,
    Datum,
    Imu,
    Innovation,
    NavSatFix,
    Odometry,
    Record,
    ReferenceFix,
    VehicleParameters,
    Verdict,
)
from fbn_common.types import Array
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import DATUM, START_NS, Arrivals, Twin, on_time, sail
from fbn_reference.estimator import Reference
from fbn_reference.parameters import Beacon, GpsParameters, LblParameters, MapParameters, ReferenceParameters
from fbn_reference.service import Gain

Sailed = Callable[..., tuple[list[Output], Reference]]
AT_DATUM = MapParameters(datum_given=True, datum=DATUM)


def answers(outputs: list[Output], sensor: str) -> list[Innovation]:
    mine = [o for o in outputs if o.topic == "reference/innovations"]
    return [o.record for o in mine if isinstance(o.record, Innovation) and o.record.sensor == sensor]


def lines(outputs: list[Output]) -> list[Odometry]:
    return [o.record for o in outputs if o.topic == "reference/odometry" and isinstance(o.record, Odometry)]


def fixes(twin: Twin, every_s: float = 1.0, sigma: float = 1.9, error: tuple[float, float] = (0.0, 0.0)) -> Arrivals:
    """The voyage with fixes all the way instead of its own, all off by the same."""
    out = [a for a in on_time(twin) if a[1] != "gps/fix"]
    for stamp in range(twin.stamp_ns[0] + 2_000_000_000, twin.stamp_ns[-1], round(every_s * 1e9)):
        out.append((stamp, "gps/fix", fix(twin, stamp // 10_000_000 * 10_000_000, sigma, error)))
    return sorted(out, key=lambda a: a[0])


def fix(twin: Twin, stamp: int, sigma: float, error: tuple[float, float]) -> NavSatFix:
    k = twin.index(stamp)
    place = twin.position[k] + twin.rotation[k] @ np.array([-0.3, 0.0, 0.35])
    g = geodetic_from_enu(np.array([place[0] + error[0], place[1] + error[1], 0.0]), DATUM)
    return NavSatFix(stamp, "gps", 0, g.latitude, g.longitude, 0.0, np.diag([sigma**2, sigma**2, 9.0]), 2)


def test_no_number_of_fixes_makes_the_position_much_better_than_one(sailed: Sailed, surfaced: Twin) -> None:
    sigma = 1.9
    outputs, _ = sailed(fixes(surfaced, 0.2, sigma))
    areas = [np.sqrt(np.linalg.det(line.pose_covariance[:2, :2])) for line in lines(outputs)]
    # the correlated part, 1.8 of 1.9 m, can never be averaged away
    assert min(areas) > 0.8 * sigma**2


def test_a_fix_no_better_than_the_filter_is_refused_by_the_rule(sailed: Sailed, surfaced: Twin) -> None:
    said = answers(sailed(fixes(surfaced, 0.2))[0], "gps")
    refused = [a for a in said if a.reason == "no better than the filter's own position"]
    assert len(refused) > 0.5 * len(said)
    assert {a.verdict for a in refused} == {Verdict.REFUSED}


def test_a_common_error_of_all_fixes_stays_within_three_sigma(sailed: Sailed, surfaced: Twin) -> None:
    outputs, _ = sailed(fixes(surfaced, 1.0, 1.9, (2.5, -2.0)), ReferenceParameters(map=AT_DATUM))
    last = lines(outputs)[-1]
    e = last.pose.position[:2] - surfaced.position[surfaced.index(last.stamp_ns), :2]
    assert e @ np.linalg.solve(last.pose_covariance[:2, :2], e) < 9.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"status": -1}, "no fix (status -1)"),
        ({"latitude": np.nan}, "not finite"),
        ({"latitude": 123.0}, "no place on earth"),
        ({"position_covariance_type": 0}, "covariance unknown"),
        ({"position_covariance": np.zeros((3, 3))}, "covariance unknown"),
        ({"position_covariance": np.full((3, 3), np.nan)}, "not finite"),
        ({"position_covariance": np.diag([1e6, 1e6, 1.0])}, "standard deviation over"),
        ({"position_covariance": np.array([[1.0, 5.0, 0], [5.0, 1.0, 0], [0, 0, 1.0]])}, "not positive semidefinite"),
    ],
)
def test_a_bad_fix_is_refused_with_its_reason(change: dict[str, object], reason: str) -> None:
    reference = Reference(ReferenceParameters())
    good = NavSatFix(START_NS, "gps", 0, 42.0, -71.0, 0.0, np.diag([4.0, 4.0, 9.0]), 2)
    reference.put("gps/fix", replace(good, **change))  # type: ignore[arg-type]
    (said,) = answers(reference.advance(START_NS), "gps")
    assert said.verdict is Verdict.REFUSED
    assert reason in said.reason
    assert reference.datum is None


def test_a_fix_under_water_is_refused(sailed: Sailed) -> None:
    deep = sail(PredictParameters(), 20.0, 1004, depth=5.0)
    outputs, _ = sailed(fixes(deep), ReferenceParameters(map=AT_DATUM))
    assert {a.reason for a in answers(outputs, "gps")[3:]} == {"a fix under water"}


def test_the_first_good_fix_makes_the_datum_once(sailed: Sailed, surfaced: Twin) -> None:
    outputs, _ = sailed([a for a in on_time(surfaced) if a[0] < START_NS + 10e9])
    datums = [o.record for o in outputs if isinstance(o.record, Datum)]
    first = next(r for _, n, r in on_time(surfaced) if isinstance(r, NavSatFix))
    assert len(datums) == 1
    assert (datums[0].latitude, datums[0].longitude) == (first.latitude, first.longitude)


def test_before_the_first_fix_position_is_not_claimed(sailed: Sailed, surfaced: Twin) -> None:
    dark = [a for a in on_time(surfaced) if a[1] != "gps/fix" and a[0] < START_NS + 10e9]
    outputs, _ = sailed(dark)
    assert not lines(outputs)
    assert not [o for o in outputs if isinstance(o.record, ReferenceFix)]
    outputs, _ = sailed(dark, ReferenceParameters(map=AT_DATUM))
    assert all(line.pose_covariance[0, 0] >= 0.99e6 for line in lines(outputs))


def test_multipath_for_seconds_is_gated(sailed: Sailed, surfaced: Twin) -> None:
    arrivals = fixes(surfaced)
    jumped = [
        (t, n, fix(surfaced, r.stamp_ns, 1.9, (25.0, 0.0)) if n == "gps/fix" and 40e9 < t - START_NS < 46e9 else r)
        for t, n, r in arrivals
    ]
    outputs, _ = sailed(jumped, ReferenceParameters(map=AT_DATUM))
    last = lines(outputs)[-1]
    assert np.linalg.norm(last.pose.position[:2] - surfaced.position[surfaced.index(last.stamp_ns), :2]) < 4.0


def test_first_fixes_that_were_off_by_a_jump_are_not_taken_for_a_current(sailed: Sailed) -> None:
    """The gate, shut at first to the good fixes, grows by what is not known of the water until it holds the jump."""
    twin = sail(PredictParameters(), 60.0, 0, depth=0.7)
    jumped = [
        (t, n, fix(twin, r.stamp_ns, 1.9, (12.0, 4.0)) if isinstance(r, NavSatFix) and t < START_NS + 8e9 else r)
        for t, n, r in fixes(twin)
    ]
    outputs, reference = sailed(jumped, ReferenceParameters(map=AT_DATUM))
    assert [a.reason for a in answers(outputs, "gps")].count("gate reset after consistent outliers") == 1
    water = reference.ekf.state.x[X_PARAMETERS + 12 : X_PARAMETERS + 14] - twin.parameters[12:14]
    assert (
        np.linalg.norm(water) < 0.3
    )  # two sigmas of what was known of the water before; 0.4 if the jump had taught it
    last = lines(outputs)[-1]
    assert np.linalg.norm(last.pose.position[:2] - twin.position[twin.index(last.stamp_ns), :2]) < 4.0


def test_current_is_estimated_from_fixes(sailed: Sailed) -> None:
    # Fixes without error, so the filter is more careful than it need be: only the upper bound is chi-square's.
    # The twin's water has no top layer, and at one depth nothing could tell it from the water below.
    parameters, nees = PredictParameters(), []
    uniform = ReferenceParameters(surface=SurfaceParameters(layer=0.0))
    for seed in range(6):
        twin = sail(parameters, 240.0, seed, depth=0.7)
        _, reference = sailed(fixes(twin), uniform)
        e = reference.ekf.state.x[X_PARAMETERS + 12 : X_PARAMETERS + 14] - twin.parameters[12:14]
        nees.append(e @ np.linalg.solve(reference.ekf.state.covariance[WATER : WATER + 2, WATER : WATER + 2], e))
        assert np.linalg.norm(e) < 0.06  # 2 m over 200 s, 0.01; 3 % of speed, 0.02; 1.5 deg across, 0.02: 2 sigma
    assert np.mean(nees) < 5.5  # 99.9 % of chi-square with 12 degrees of freedom, over 6


def test_fixes_tell_how_far_the_compass_deviates(sailed: Sailed) -> None:
    """Legs in eight directions with good fixes; a compass off by 0.04 rad on every heading, and no error else."""
    twin = sail(PredictParameters(), 480.0, 1002, depth=0.9, noisy=False)
    turned = [(t, n, _turned(r, 0.04) if isinstance(r, Imu) else r) for t, n, r in fixes(twin, sigma=1.0)]
    good = ReferenceParameters(
        gps=GpsParameters(rule=False, white=1.0),
        surface=SurfaceParameters(layer=0.0),
        compass=CompassParameters(hard_iron=0.0, soft_iron=0.0, time_constant=1e5),
    )
    state = sailed(turned, good)[1].ekf.state
    waves, own = deviation_waves(rotation_of(state.x)), slice(DEVIATION, DEVIATION + 5)
    said, sigma = waves @ state.x[X_DEVIATION:X_STEADY], np.sqrt(waves @ state.covariance[own, own] @ waves)
    # surge of 0.08 m/s over 1 s moves by 0.9 m in a leg's 60 s: 0.02 rad of 44 m, 0.007 in the mean of eight; and water
    assert sigma < 0.5 * good.compass.deviation
    assert abs(said - 0.04) < 2.6 * sigma  # 99 %


def _turned(record: Imu, angle: float) -> Imu:
    r = matrix_from_rpy(np.array([0.0, 0.0, angle])) @ matrix_from_quaternion(record.orientation)
    return replace(record, orientation=quaternion_from_matrix(r))


def test_parameters_are_published_each_second_once_position_is_known(sailed: Sailed, surfaced: Twin) -> None:
    outputs, _ = sailed(fixes(surfaced))
    stamps = [o.record.stamp_ns for o in outputs if o.topic == "reference/parameters"]
    records = [o.record for o in outputs if isinstance(o.record, VehicleParameters)]
    assert len(stamps) > 90
    assert all(b - a >= 1_000_000_000 for a, b in pairwise(stamps))
    assert all(np.linalg.eigvalsh(r.covariance)[0] >= 0.0 for r in records)


# --- ranges ----------------------------------------------------------------------------------------------


def lbl(beacons: dict[str, Beacon]) -> ReferenceParameters:
    return ReferenceParameters(lbl=LblParameters(beacons=beacons), map=replace(AT_DATUM, start_sigma=20.0))


def ranges(twin: Twin, beacons: dict[str, Beacon], lies: dict[str, float], delay_s: float = 0.4) -> Arrivals:
    """The voyage without GPS but with a range each second, the beacons in turn, stamped at reception."""
    rng, names = np.random.default_rng(1), list(beacons)
    out = [a for a in on_time(twin) if a[1] != "gps/fix"]
    for i, middle in enumerate(range(START_NS + 3_000_000_000, twin.stamp_ns[-1] - 10**9, 10**9)):
        b = beacons[names[i % len(names)]]
        distance = np.linalg.norm(twin.position[twin.index(middle)] - np.array([b.x, b.y, b.z]))
        value = float(distance + lies.get(names[i % len(names)], 0.0) + 0.3 * rng.standard_normal())
        stamp = middle + round(delay_s / 2 * 1e9)
        record: Record = BeaconRange(stamp, "base_link", names[i % len(names)], value, 0.09, delay_s)
        out.append((stamp + 30_000_000, "lbl/range", record))
    return sorted(out, key=lambda a: a[0])


BEACONS = {"a": Beacon(100.0, 80.0, -5.0), "b": Beacon(-90.0, 100.0, -5.0), "c": Beacon(20.0, -120.0, -5.0)}


def final_error(outputs: list[Output], twin: Twin) -> Array:
    last = lines(outputs)[-1]
    return np.asarray(last.pose.position[:2] - twin.position[twin.index(last.stamp_ns), :2])


def test_ranges_to_three_beacons_hold_the_position(sailed: Sailed) -> None:
    twin = sail(PredictParameters(), 90.0, 1005)
    outputs, _ = sailed(ranges(twin, BEACONS, {}), lbl(BEACONS))
    assert np.linalg.norm(final_error(outputs, twin)) < 1.5  # ranges of 0.6 m, with the survey


def test_a_lying_beacon_is_dropped_and_named(sailed: Sailed) -> None:
    twin = sail(PredictParameters(), 90.0, 1005)
    honest = [a for a in ranges(twin, BEACONS, {}) if a[0] < START_NS + 30e9]
    lying = [a for a in ranges(twin, BEACONS, {"b": 40.0}) if a[0] >= START_NS + 30e9]
    outputs, _ = sailed(honest + lying, lbl(BEACONS))
    assert any(a.reason == "this beacon disagreed too often" for a in answers(outputs, "lbl.b"))
    assert all(a.verdict is Verdict.USED for a in answers(outputs, "lbl.a")[-10:])
    assert np.linalg.norm(final_error(outputs, twin)) < 2.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"beacon_id": "x"}, "unknown beacon 'x'"), ({"range": np.nan}, "not finite"), ({"range": -3.0}, "out of bounds")],
)
def test_a_bad_range_is_refused_with_its_reason(change: dict[str, object], reason: str) -> None:
    reference = Reference(lbl(BEACONS))
    reference.put("lbl/range", replace(BeaconRange(START_NS, "", "a", 50.0, 0.1, 0.1), **change))  # type: ignore[arg-type]
    (said,) = answers(reference.advance(START_NS), "lbl")
    assert reason in said.reason


# --- service ---------------------------------------------------------------------------------------------


def test_fixes_of_the_service_rebuild_the_filter_and_count_nothing_twice() -> None:
    """Who holds the predicted position and takes in the fix arrives at the filter's position and covariance."""
    rng = np.random.default_rng(3)
    mean, covariance = np.array([4.0, -3.0]), np.diag([9.0, 4.0])
    gain, outside, outside_covariance = Gain(mean, covariance), mean.copy(), covariance.copy()
    for _ in range(5):
        for _ in range(3):
            shift, growth = rng.standard_normal(2), np.diag(rng.uniform(0.0, 3.0, 2))
            before_mean, before = mean + shift, covariance + growth
            h = rng.standard_normal((1, 2))
            information = np.linalg.inv(before) + h.T @ h
            covariance = np.linalg.inv(information)
            mean = covariance @ (np.linalg.inv(before) @ before_mean + h[0] * rng.standard_normal())
            gain.add(packed(before_mean, before), packed(mean, covariance))
            outside, outside_covariance = outside + shift, outside_covariance + growth
        z, r = gain.collect()
        k = outside_covariance @ np.linalg.inv(outside_covariance + r)
        outside, outside_covariance = outside + k @ (z - outside), outside_covariance - k @ outside_covariance
        np.testing.assert_allclose(outside_covariance, covariance, atol=1e-6)
        np.testing.assert_allclose(outside, mean, atol=1e-6)


def packed(mean: Array, covariance: Array) -> Array:
    return np.array([*mean, covariance[0, 0], covariance[0, 1], covariance[1, 1]])


def test_the_service_speaks_only_when_position_was_learnt(sailed: Sailed, surfaced: Twin) -> None:
    cut = [a for a in fixes(surfaced) if a[1] != "gps/fix" or a[0] < START_NS + 30e9]
    outputs, _ = sailed(cut)
    stamps = [o.record.stamp_ns for o in outputs if isinstance(o.record, ReferenceFix)]
    assert stamps
    assert max(stamps) < START_NS + 30e9


def test_gps_can_be_switched_off_by_parameter(sailed: Sailed, surfaced: Twin) -> None:
    arrivals = [a for a in fixes(surfaced) if a[0] < START_NS + 10e9]
    outputs, _ = sailed(arrivals, ReferenceParameters(gps=GpsParameters(use=False)))
    assert {a.reason for a in answers(outputs, "gps")} == {"switched off by parameter"}


def test_without_position_the_water_stays_as_it_was_believed(sailed: Sailed) -> None:
    """Compass and depth see the water only through the model's lateral forces: what they say of it is model error."""
    _, reference = sailed([a for a in on_time(sail(PredictParameters(), 60.0, 1006)) if a[1] != "gps/fix"])
    prior = PredictParameters().doubt.water[0] ** 2
    water = slice(WATER, WATER + 2)
    assert np.array_equal(reference.ekf.state.x[X_PARAMETERS + 12 : X_PARAMETERS + 14], np.zeros(2))
    assert np.diagonal(reference.ekf.state.covariance[water, water]).min() >= prior
