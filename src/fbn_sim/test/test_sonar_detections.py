"""Sonar: geometry against an independent computation; who is seen depends on range, place in the lobe and luck."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from sim_cases import circling, flight, short_mission

from fbn_common.records import SonarDetections
from fbn_common.sonar import SonarArray
from fbn_common.types import Array
from fbn_sim.motion import interpolate
from fbn_sim.sensors.clutter import Clutter, Scatterers
from fbn_sim.sensors.sonar import Sonar, echoes, excess, merged, sight, sonar_records

ARRAY = SonarArray()
ANGLE = st.floats(-0.6, 0.6)
NOISELESS = Clutter(noise=0.0)


def things(places: Array) -> Scatterers:
    """Reflectors at these places (n, 3), alike from all sides."""
    n = len(places)
    always, zero = np.tile([-1.0, 1e9], (n, 1)), np.zeros(n)
    return Scatterers(n, places, np.zeros((n, 3)), always, zero, zero, zero, zero)


@settings(max_examples=60, deadline=None)
@given(
    rpy=st.tuples(ANGLE, ANGLE, st.floats(-3.1, 3.1)),
    mount=st.tuples(ANGLE, ANGLE, ANGLE),
    offset=st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-5, 5)).map(np.array),
)
def test_at_rest_the_geometry_is_that_of_the_frames(
    rpy: tuple[float, float, float], mount: tuple[float, float, float], offset: Array
) -> None:
    array = SonarArray(mount_rpy=mount)
    turn = Rotation.from_euler("xyz", rpy)
    base = turn.inv().apply(offset) - np.array(array.mount_xyz)
    assume(np.linalg.norm(base) > 1.0)
    look, up, left = (Rotation.from_euler("xyz", mount).apply(e) for e in ([1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]))
    r, phi, theta = sight(offset, turn.as_matrix(), np.zeros(6), array.rotation_base_array, array.position_base, 1500.0)
    assert r == pytest.approx(np.linalg.norm(base))
    assert np.cos(phi) == pytest.approx(base @ left / r, abs=1e-9)  # the axis lies to the left
    assert np.sin(phi) * np.cos(theta) == pytest.approx(base @ look / r, abs=1e-9)
    assert np.sin(phi) * np.sin(theta) == pytest.approx(-(base @ up) / r, abs=1e-9)  # positive is down


def test_the_range_is_half_the_way_of_a_sound_that_meets_a_moving_vehicle() -> None:
    speed, c, ahead = 3.0, 1500.0, 30.0
    array = SonarArray(mount_xyz=(0.0, 0.0, 0.0))
    velocity = np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])
    arrives = brentq(lambda t: ahead + (ahead - speed * t) - c * t, 0.0, 1.0)
    r, _, _ = sight(np.array([ahead, 0.0, 0.0]), np.eye(3), velocity, array.rotation_base_array, np.zeros(3), c)
    # the linearisation's error: (v / c)^2 r = 1.2e-4 m
    assert r == pytest.approx(c * arrives / 2.0, abs=2e-4)


def test_on_the_axis_of_the_lobe_the_echo_falls_as_spreading_and_absorption_say() -> None:
    sonar = Sonar()
    seen = np.array([[0, 0, 10.0, np.pi / 2, 0.0, 0.0], [0, 0, 40.0, np.pi / 2, 0.0, 0.0]])
    near, far = excess(dataclasses.replace(sonar, reverberation_limit=1e9), ARRAY, seen, things(np.zeros((1, 3))))
    assert near == pytest.approx(sonar.level)
    assert near - far == pytest.approx(40.0 * np.log10(4.0) + 2.0 * sonar.absorption * 30.0)


def rate_of_detection(place: tuple[float, float, float]) -> float:
    """Part of 600 pings that detect a reflector at this place before a vehicle that stands at the origin."""
    sonar = Sonar(arrays={"a": ARRAY}, clutter=NOISELESS, misalignment=0.0)
    motion = circling(0.0, speed=0.0, rate=0.0, seconds=600.0)
    records = [e.record for e in sonar_records(sonar, things(np.array([place])), flight(motion))]
    return float(np.mean([len(r.detections) for r in records if isinstance(r, SonarDetections)]))


def test_detection_falls_with_range_and_outside_the_lobe() -> None:
    at_15, at_30, at_38 = (rate_of_detection((x, 0.0, 0.0)) for x in (15.0, 30.0, 38.0))
    assert at_15 == pytest.approx(0.85, abs=0.06)  # what the detector keeps of strong echoes; 600 pings: 1.5 % each
    assert at_15 > at_30 > at_38 > 0.2
    assert rate_of_detection((15.0, 0.0, -4.5)) < 0.1  # 16.7 deg down: the lobe ends at 10
    assert rate_of_detection((15.0, 9.0, 0.0)) == 0.0  # 31 deg to the side: the sector ends at 22.5
    assert rate_of_detection((3.0, 0.0, 0.0)) == 0.0  # nearer than the least range


def test_noise_quantisation_and_stated_sigmas_fit_together() -> None:
    sonar = Sonar(arrays={"a": ARRAY}, clutter=NOISELESS, misalignment=0.0, sound_speed_error=0.0, target_size=0.0)
    motion = circling(0.0, speed=0.0, rate=0.0, seconds=1200.0)
    records = [e.record for e in sonar_records(sonar, things(np.array([[20.6, 0.0, 0.0]])), flight(motion))]
    found = [d for r in records if isinstance(r, SonarDetections) for d in r.detections]
    ranges, bearings = np.array([d.range for d in found]), np.array([d.bearing for d in found])
    assert ranges.mean() == pytest.approx(20.0, abs=0.005)
    assert ranges.std() == pytest.approx(np.hypot(sonar.range_noise, sonar.range_step / np.sqrt(12.0)), rel=0.1)
    assert bearings.std() == pytest.approx(found[0].bearing_sigma, rel=0.1)
    steps = (bearings - ARRAY.bearing_min) / sonar.bearing_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_near_echoes_melt_into_the_stronger_one() -> None:
    echo = np.array([[20.0, 1.5, 10.0], [20.1, 1.51, 4.0], [20.1, 1.6, 4.0]])
    out = merged(echo, 0.25, 0.03)
    assert len(out) == 2
    weights = 10.0 ** (np.array([10.0, 4.0]) / 10.0)
    assert out[0][0] == pytest.approx(np.average([20.0, 20.1], weights=weights))
    assert out[0][2] == 10.0


def test_every_ping_of_every_array_is_told_also_when_nothing_was_seen() -> None:
    sonar = Sonar(arrays={"a": ARRAY, "b": ARRAY}, clutter=NOISELESS)
    motion = circling(3.0, seconds=60.0)
    records = [e.record for e in sonar_records(sonar, things(np.empty((0, 3))), flight(motion))]
    assert all(isinstance(r, SonarDetections) and r.detections == () for r in records)
    assert len(records) == pytest.approx(2 * 58, abs=6)  # but for lost messages


def test_some_clutter_stays_where_it_is_and_some_swims() -> None:
    truth = short_mission().truth
    clutter = slice(truth.scatterers.features, None)
    drift = np.linalg.norm(truth.scatterers.drift[clutter], axis=1)
    forever = truth.scatterers.life[clutter, 1] > 1e8
    assert (drift[forever] == 0.0).all()
    assert forever.sum() > 3
    assert (drift[~forever] > 0.0).all()


def test_the_missions_detections_are_where_the_features_are() -> None:
    simulation = short_mission()
    truth, sonar = simulation.truth, simulation.scenario.sensors.sonar
    hits, total = 0, 0
    for name, array in sonar.arrays.items():
        records = [e.record for e in simulation.entries if getattr(e.record, "frame_id", "") == name]
        stamps = np.array([r.stamp_ns for r in records])
        pings = interpolate(truth.motion, (stamps - truth.start_ns) / 1e9)
        own = things(truth.features.positions)
        seen = echoes(pings, array, array.rotation_base_array, sonar.sound_speed, own)
        inside = seen[(np.abs(seen[:, 4]) < array.lobe_width / 2.0) & (seen[:, 2] < 25.0)]
        for row in inside:
            record = records[int(row[0])]
            assert isinstance(record, SonarDetections)
            total += 1
            hits += any(abs(d.range - row[2]) < 0.4 and abs(d.bearing - row[3]) < 0.08 for d in record.detections)
    assert total > 20
    assert hits / total > 0.6
