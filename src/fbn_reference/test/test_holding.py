"""Ranges in the filter while the position is uncertain: who is believed, and what is said of the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fbn_common.estimator import Level, Output
from fbn_common.parameters import ParameterError
from fbn_common.records import BeaconRange, Innovation, Odometry, Record, ReferenceFix, Verdict
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import DATUM, START_NS, Arrivals, Twin, on_time, sail
from fbn_reference.estimator import Reference
from fbn_reference.holding import Refusal
from fbn_reference.parameters import Beacon, LblParameters, MapParameters, ReferenceParameters

Sailed = Callable[..., tuple[list[Output], Reference]]
BEACONS = {
    "a": Beacon(100.0, 80.0, -5.0),
    "b": Beacon(-90.0, 100.0, -5.0),
    "c": Beacon(20.0, -120.0, -5.0),
    "d": Beacon(-80.0, -60.0, -5.0),
}
FAR = {"a": Beacon(40.0, 0.0, -5.0), "d": Beacon(-40.0, 0.0, -5.0)}
OFF = (12.0, -16.0)  # m, of the start: 20 m, as is stated


@pytest.fixture(scope="module")
def twin() -> Twin:
    return sail(PredictParameters(), 25.0, 1010)


def parameters(beacons: dict[str, Beacon], sigma: float = 20.0, hold: float = 5.0) -> ReferenceParameters:
    start = MapParameters(datum_given=True, datum=DATUM, start_x=OFF[0], start_y=OFF[1], start_sigma=sigma)
    return ReferenceParameters(lbl=LblParameters(beacons=beacons, hold=hold), map=start)


def ranges(twin: Twin, beacons: dict[str, Beacon], lies: dict[str, float], late_s: float = 0.0) -> Arrivals:
    """A range each 0.3 s from 3 s on, the beacons in turn in the order given, without GPS."""
    rng, names = np.random.default_rng(2), list(beacons)
    out = [a for a in on_time(twin) if a[1] != "gps/fix"]
    for i, stamp in enumerate(range(START_NS + 3_000_000_000, twin.stamp_ns[-1] - 10**9, 300_000_000)):
        name, k = names[i % len(names)], twin.index(stamp)
        b = beacons[name]
        distance = float(np.linalg.norm(twin.position[k] - np.array([b.x, b.y, b.z])))
        value = distance + lies.get(name, 0.0) + 0.3 * float(rng.standard_normal())
        record: Record = BeaconRange(stamp, "base_link", name, value, 0.09, 0.0)
        out.append((stamp + round(late_s * 1e9 * float(rng.uniform())), "lbl/range", record))
    return sorted(out, key=lambda a: a[0])


def answers(outputs: list[Output], name: str) -> list[Innovation]:
    return [o.record for o in outputs if isinstance(o.record, Innovation) and o.record.sensor == f"lbl.{name}"]


def last(outputs: list[Output]) -> Odometry:
    return [o.record for o in outputs if o.topic == "reference/odometry" and isinstance(o.record, Odometry)][-1]


def error(outputs: list[Output], twin: Twin) -> float:
    line = last(outputs)
    return float(np.linalg.norm(line.pose.position[:2] - twin.position[twin.index(line.stamp_ns), :2]))


@pytest.mark.parametrize("liar", BEACONS)
def test_a_liar_among_four_is_found_out_whenever_it_is_heard(sailed: Sailed, twin: Twin, liar: str) -> None:
    outputs, _ = sailed(ranges(twin, BEACONS, {liar: 30.0}), parameters(BEACONS))
    mine = answers(outputs, liar)
    assert not [a for a in mine if a.verdict is Verdict.USED]
    assert mine[0].reason == Refusal.OUTVOTED
    for honest in set(BEACONS) - {liar}:
        said = answers(outputs, honest)
        assert {a.verdict for a in said} == {Verdict.USED}
    assert error(outputs, twin) < 1.5  # ranges of 0.6 m, with the survey, by three beacons all round


def test_without_waiting_the_liar_heard_first_is_believed(sailed: Sailed, twin: Twin) -> None:
    outputs, _ = sailed(ranges(twin, BEACONS, {"a": 30.0}), parameters(BEACONS, hold=0.0))
    assert answers(outputs, "a")[0].verdict is Verdict.USED
    assert answers(outputs, "a")[0].stamp_ns == START_NS + 3_000_000_000


def test_of_two_that_contradict_none_is_used_and_health_names_them(sailed: Sailed, twin: Twin) -> None:
    outputs, reference = sailed(ranges(twin, FAR, {"a": -30.0, "d": -30.0}), parameters(FAR))
    said = [*answers(outputs, "a"), *answers(outputs, "d")]
    assert {a.verdict for a in said} == {Verdict.REFUSED}
    assert {a.reason for a in said} == {Refusal.UNDECIDED}
    health = reference.health()
    assert health.level is Level.WARN
    assert "lbl: a, d not believed" in health.message
    assert np.sqrt(last(outputs).pose_covariance[0, 0]) > 19.9


def test_one_beacon_alone_is_believed_after_the_wait(sailed: Sailed, twin: Twin) -> None:
    outputs, _ = sailed(ranges(twin, {"b": BEACONS["b"]}, {}), parameters(BEACONS))
    assert {a.verdict for a in answers(outputs, "b")} == {Verdict.USED}
    along = np.array([-90.0, 100.0]) / np.hypot(90.0, 100.0)
    assert along @ last(outputs).pose_covariance[:2, :2] @ along < 1.0


def test_ranges_that_arrive_late_give_the_same_position(sailed: Sailed, twin: Twin) -> None:
    """The same motions, ranges late by up to 1 s: the window, of three replies from each beacon, is the same."""
    outputs, _ = sailed(ranges(twin, BEACONS, {"c": 30.0}), parameters(BEACONS))
    motions = [(o.record.stamp_ns, o.topic, o.record) for o in outputs if o.topic.startswith("predict/")]
    found = []
    for late_s in (0.0, 1.0):
        reference, arrivals = Reference(parameters(BEACONS)), ranges(twin, BEACONS, {"c": 30.0}, late_s)
        log, i = sorted([*motions, *arrivals], key=lambda a: a[0]), 0
        for now in range(START_NS, twin.stamp_ns[-1] + 200_000_000, 200_000_000):
            while i < len(log) and log[i][0] <= now:
                reference.put(log[i][1], log[i][2])
                i += 1
            reference.advance(now)
        found.append(reference.ekf.state.x)
    assert abs(found[0][0] - twin.position[-1, 0]) < 2.0
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)


def test_every_range_is_answered_once(sailed: Sailed, twin: Twin) -> None:
    arrivals = ranges(twin, BEACONS, {"c": 30.0})
    outputs, _ = sailed(arrivals, parameters(BEACONS))
    heard = [r.stamp_ns for _, topic, r in arrivals if topic == "lbl/range"]
    assert sorted(a.stamp_ns for n in BEACONS for a in answers(outputs, n)) == sorted(heard)


def test_what_waited_reaches_the_reference_service(sailed: Sailed, twin: Twin) -> None:
    outputs, _ = sailed(ranges(twin, BEACONS, {}), parameters(BEACONS))
    first = next(o.record for o in outputs if isinstance(o.record, ReferenceFix))
    # of the first window's 12 ranges of 0.58 m: 0.58 / sqrt(12 / 2) = 0.24 m, and what is left of motion
    assert np.sqrt(np.linalg.eigvalsh(first.covariance)[-1]) < 0.5


def test_a_certain_position_lets_the_gate_judge_at_once(sailed: Sailed, twin: Twin) -> None:
    sure = parameters({"a": BEACONS["a"]}, sigma=1.0)
    outputs, _ = sailed(
        ranges(twin, {"a": BEACONS["a"]}, {"a": 30.0}), replace(sure, map=replace(sure.map, start_x=0.0, start_y=0.0))
    )
    assert answers(outputs, "a")[0].verdict is Verdict.GATED


def test_waiting_longer_than_the_history_is_refused_by_name() -> None:
    with pytest.raises(ParameterError, match=r"lbl\.hold"):
        parameters(BEACONS, hold=5.5)


def test_a_frozen_beacon_is_named_and_what_it_repeated_is_taken_back(sailed: Sailed, twin: Twin) -> None:
    """After the naming the filter is where it would be had the beacon fallen silent."""
    held = START_NS + 12_000_000_000
    found = []
    for silent in (False, True):
        arrivals = ranges(twin, BEACONS, {})
        mine = [r for _, _, r in arrivals if isinstance(r, BeaconRange) and r.beacon_id == "b"]
        value = [r.range for r in mine if r.stamp_ns < held][-1]
        spoilt: Arrivals = []
        for at, topic, r in arrivals:
            if not (isinstance(r, BeaconRange) and r.beacon_id == "b" and r.stamp_ns >= held):
                spoilt.append((at, topic, r))
            elif not silent:
                spoilt.append((at, topic, replace(r, range=value)))
        found.append(sailed(spoilt, parameters(BEACONS))[0])
    frozen = [a for a in answers(found[0], "b") if a.reason.startswith("frozen")]
    assert frozen[0].reason == "frozen: 5 equal values in a row"
    assert frozen[0].stamp_ns - held < 6_000_000_000  # the fourth repeat at 1.2 s, and a step
    # predict's motions differ a little where the repeats moved the parameters: 1 mm/s for some seconds
    np.testing.assert_allclose(last(found[0]).pose.position, last(found[1]).pose.position, atol=0.02)
