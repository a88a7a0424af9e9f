"""The dead-reckoning filter: order of arrival, small shifts, continuity, consistency, faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fbn_common.estimator import Level, Output
from fbn_common.graph import GRAPH
from fbn_common.lie import matrix_from_quaternion, so3_log
from fbn_common.records import Imu, Innovation, Odometry, Record, VehicleParameters, Verdict
from fbn_common.types import Array
from fbn_deadreck.estimator import Deadreck
from fbn_deadreck.parameters import DeadreckParameters
from fbn_predict.parameters import PredictParameters, prior
from fbn_predict.twin import START_NS, Arrivals, Twin, on_time, ping, sail

Late = Callable[[Twin, int, float], Arrivals]
Sailed = Callable[[Arrivals], tuple[list[Output], Deadreck]]


def odometry(outputs: list[Output]) -> list[Odometry]:
    return [o.record for o in outputs if isinstance(o.record, Odometry)]


def answers(outputs: list[Output], sensor: str) -> list[Innovation]:
    return [o.record for o in outputs if isinstance(o.record, Innovation) and o.record.sensor == sensor]


def difference(a: Odometry, b: Odometry) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    r = matrix_from_quaternion(a.pose.orientation).T @ matrix_from_quaternion(b.pose.orientation)
    return float(np.linalg.norm(a.pose.position - b.pose.position)), float(
        np.linalg.norm(so3_log(np.ascontiguousarray(r)))
    )


def test_it_never_takes_gps() -> None:
    assert not {"gps/fix", "lbl/range"} & set(GRAPH.node("fbn_deadreck").inputs)


def test_measurements_late_by_up_to_five_seconds_give_the_same_state_as_in_time(
    twin: Twin, voyage: tuple[list[Output], Deadreck], late: Late
) -> None:
    # actuators on time: what predict made of them reaches back no farther than its own history
    arrivals = [a if a[1] != "actuators" else (a[2].stamp_ns, a[1], a[2]) for a in late(twin, 3, 5.0)]
    cut = twin.stamp_ns[-1] - 6_000_000_000
    arrivals = [a for a in arrivals if a[2].stamp_ns < cut]
    in_time = [a for a in on_time(twin) if a[2].stamp_ns < cut]
    flush: Arrivals = [(twin.stamp_ns[-1], "sonar/detections", ping(cut))]
    no_feedback = (
        sailed_without_feedback(sorted(arrivals, key=lambda a: a[0]) + flush),
        sailed_without_feedback(in_time + flush),
    )
    a, b = (deadreck.ekf.state for deadreck in no_feedback)
    assert a.stamp_ns == b.stamp_ns
    assert np.array_equal(a.x, b.x)
    assert np.array_equal(a.covariance, b.covariance)
    assert no_feedback[0].ekf.reruns > 100


def sailed_without_feedback(arrivals: Arrivals) -> Deadreck:
    """Feedback's own delay depends on arrival, so it is left out where bits are compared."""
    from fbn_predict.estimator import Predict

    predict, deadreck = Predict(PredictParameters()), Deadreck(DeadreckParameters())
    end = (arrivals[0][0] // 200_000_000 + 1) * 200_000_000
    for arrival, topic, record in [*arrivals, (arrivals[-1][0] + 400_000_000, "", None)]:
        while arrival > end:
            for made in predict.advance(end):
                deadreck.put(made.topic, made.record)
            deadreck.advance(end)
            end += 200_000_000
        if topic == "actuators":
            predict.put(topic, record)  # type: ignore[arg-type]
        elif record is not None:
            deadreck.put(topic, record)
    return deadreck


@pytest.mark.parametrize("topic", ["imu/data", "pressure", "actuators"])
def test_stamps_moved_by_a_microsecond_move_the_pose_by_less_than_a_millimetre(
    sailed: Sailed, twin: Twin, voyage: tuple[list[Output], Deadreck], topic: str
) -> None:
    moved = [(t, n, replace(r, stamp_ns=r.stamp_ns + 1000) if n == topic else r) for t, n, r in on_time(twin)]
    position, angle = difference(odometry(sailed(moved)[0])[-1], odometry(voyage[0])[-1])
    assert position < 1e-3 and angle < np.radians(1e-3)


def test_an_extra_ping_changes_nothing_at_all(
    sailed: Sailed, twin: Twin, voyage: tuple[list[Output], Deadreck]
) -> None:
    extra = [
        (s, "sonar/detections", ping(s))
        for s in range(START_NS + 20_001_000_000, START_NS + 60_000_000_000, 350_000_000)
    ]
    outputs, _ = sailed(sorted([*on_time(twin), *extra], key=lambda a: a[0]))
    assert difference(odometry(outputs)[-1], odometry(voyage[0])[-1]) == (0.0, 0.0)


def test_the_same_data_gives_the_same_bits(sailed: Sailed, twin: Twin, voyage: tuple[list[Output], Deadreck]) -> None:
    again, _ = sailed(on_time(twin))
    assert all(
        np.array_equal(a.pose.position, b.pose.position) and np.array_equal(a.pose_covariance, b.pose_covariance)
        for a, b in zip(odometry(again), odometry(voyage[0]), strict=True)
    )


def test_position_never_jumps(voyage: tuple[list[Output], Deadreck]) -> None:
    lines = odometry(voyage[0])
    steps = np.array([difference(a, b)[0] for a, b in pairwise(lines)])
    assert steps.max() < 0.03 * 1.0 + 0.05  # 1 m/s over 30 ms, and z's correction: its sigma, 3 cm, and a margin


def test_odometry_comes_every_thirty_milliseconds(voyage: tuple[list[Output], Deadreck]) -> None:
    stamps = np.array([o.stamp_ns for o in odometry(voyage[0])])
    assert set(np.diff(stamps)) == {30_000_000}


def errors(twin: Twin, lines: list[Odometry]) -> tuple[Array, Array]:
    """Errors (n, 6) in ROS order, and NEES of (z, attitude) and of xy, (n, 2); xy relative to the start."""
    offset = lines[0].pose.position - twin.position[twin.index(lines[0].stamp_ns)]
    out, nees = [], []
    for line in lines:
        k = twin.index(line.stamp_ns)
        turn = twin.rotation[k] @ matrix_from_quaternion(line.pose.orientation).T
        e = np.concatenate((twin.position[k] - line.pose.position, so3_log(np.ascontiguousarray(turn))))
        e[:2] += offset[:2]
        c = line.pose_covariance
        nees.append((e[2:] @ np.linalg.solve(c[2:, 2:], e[2:]), e[:2] @ np.linalg.solve(c[:2, :2], e[:2])))
        out.append(e)
    return np.array(out), np.array(nees)


def test_errors_are_as_large_as_the_filter_says(nees_of_voyages: Array) -> None:
    # Means over 12 voyages of the NEES at their ends, 4 and 2 degrees of freedom: chi-square with 48 and 24,
    # so 99.8 % of such means lie within 2.3 and 6.3, and within 0.8 and 4.0.
    earth, plane = nees_of_voyages.mean(axis=0)
    assert 2.3 < earth < 6.3
    assert 0.8 < plane < 4.0


@pytest.fixture(scope="module")
def nees_of_voyages(sailed: Sailed) -> Array:
    ends = []
    for seed in range(12):
        twin = sail(PredictParameters(), 60.0, seed)
        ends.append(errors(twin, odometry(sailed(on_time(twin))[0]))[1][-1])
    return np.array(ends)


def change(arrivals: Arrivals, topic: str, fault: Callable[[Record, int], Record | None]) -> Arrivals:
    """The same arrivals with a fault on a topic's records from 30 s to 50 s."""
    out: Arrivals = []
    for i, (t, n, r) in enumerate(arrivals):
        faulty = n == topic and START_NS + 30e9 < t < START_NS + 50e9
        new = fault(r, i) if faulty else r
        if new is not None:
            out.append((t, n, new))
    return out


def with_value(record: Record, value: float) -> Record:
    if isinstance(record, Imu):
        return replace(record, orientation=np.full(4, value))
    name = {"FluidPressure": "fluid_pressure", "Range": "range"}[type(record).__name__]
    return replace(record, **{name: value})  # type: ignore[arg-type]


FAULTS: dict[str, Callable[[Record, int], Record | None]] = {
    "silent": lambda r, i: None,
    "not a number": lambda r, i: with_value(r, np.nan),
    "infinite": lambda r, i: with_value(r, np.inf),
    "zero": lambda r, i: with_value(r, 0.0),
    "from the future": lambda r, i: replace(r, stamp_ns=r.stamp_ns + 10**12),
    "from long ago": lambda r, i: replace(r, stamp_ns=r.stamp_ns - 20 * 10**9),
}


@pytest.mark.parametrize("topic", ["imu/data", "pressure", "altitude"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_sensor_leaves_a_finite_state_that_recovers(
    sailed: Sailed, twin: Twin, topic: str, fault: str
) -> None:
    outputs, deadreck = sailed(change(on_time(twin), topic, FAULTS[fault]))
    state = deadreck.ekf.state
    assert np.isfinite(state.x).all()
    assert np.linalg.eigvalsh(state.covariance)[0] > 0.0
    sensor = {"imu/data": "compass", "pressure": "depth", "altitude": "altimeter"}[topic]
    last = answers(outputs, sensor)[-1]
    assert last.verdict is Verdict.USED
    assert np.linalg.norm(errors(twin, odometry(outputs))[0][-1, 2:]) < 0.3


def test_a_frozen_compass_is_named_and_not_believed(sailed: Sailed, twin: Twin) -> None:
    held = next(r for t, n, r in on_time(twin) if n == "imu/data" and t > START_NS + 30e9)
    assert isinstance(held, Imu)
    arrivals = change(on_time(twin), "imu/data", lambda r, i: replace(held, stamp_ns=r.stamp_ns))
    outputs, _ = sailed(arrivals)
    reasons = [a.reason for a in answers(outputs, "compass") if a.verdict is Verdict.REFUSED]
    assert sum("frozen" in r for r in reasons) > 150  # 200 values in 20 s, the first 20 unsuspected


def test_duplicates_are_counted_and_used_once(
    sailed: Sailed, twin: Twin, voyage: tuple[list[Output], Deadreck]
) -> None:
    doubled = sorted([*on_time(twin), *(a for a in on_time(twin) if a[1] == "pressure")], key=lambda a: a[0])
    outputs, _ = sailed(doubled)
    assert difference(odometry(outputs)[-1], odometry(voyage[0])[-1]) == (0.0, 0.0)
    assert sum(a.reason == "duplicate" for a in answers(outputs, "depth")) > 400


def test_a_silent_sensor_is_named_in_health(sailed: Sailed, twin: Twin) -> None:
    arrivals = [a for a in on_time(twin) if a[1] != "pressure" or a[0] < START_NS + 40e9]
    _, deadreck = sailed(arrivals)
    assert deadreck.health().level is Level.WARN
    assert "depth: no data for" in deadreck.health().message


def test_a_gate_that_locks_out_a_good_sensor_resets_itself(sailed: Sailed, twin: Twin) -> None:
    def shifted(r: Record, i: int) -> Record:
        return replace(r, fluid_pressure=r.fluid_pressure + 50_000.0)  # type: ignore[attr-defined,call-arg]

    outputs, _ = sailed(change(on_time(twin), "pressure", shifted))
    reset = [a for a in answers(outputs, "depth") if "gate reset" in a.reason]
    assert len(reset) == 2  # there, and back again
    assert abs(errors(twin, odometry(outputs))[0][-1, 2]) < 0.2


def test_a_clock_that_goes_back_resets_with_a_reason(sailed: Sailed, twin: Twin) -> None:
    _, deadreck = sailed([a for a in on_time(twin) if a[0] < START_NS + 20e9])
    said = [o.record for o in deadreck.advance(START_NS)]
    assert any(isinstance(i, Innovation) and "went back" in i.reason for i in said)
    assert deadreck.health().level is Level.WARN


def test_missing_motions_are_stepped_over_with_doubt(twin: Twin) -> None:
    from fbn_predict.estimator import Predict

    predict, deadreck = Predict(PredictParameters()), Deadreck(DeadreckParameters())
    lost = range(START_NS + 10_000_000_000, START_NS + 10_500_000_000)
    outputs: list[Output] = []
    waiting = on_time(twin)
    for end in range(START_NS, START_NS + 20_000_000_001, 200_000_000):
        while waiting[0][0] <= end:
            _, topic, record = waiting.pop(0)
            (predict if topic == "actuators" else deadreck).put(topic, record)
        for out in predict.advance(end):
            if out.record.stamp_ns not in lost:
                deadreck.put(out.topic, out.record)
        outputs += deadreck.advance(end)
    assert deadreck.ekf.head_ns == START_NS + 20_000_000_000
    assert deadreck.health().values["bridged"] == 50
    assert any("missing" in a.reason for a in answers(outputs, "predict"))


def test_a_deviation_told_by_reference_turns_yaw_without_a_jump(
    sailed: Sailed, twin: Twin, voyage: tuple[list[Output], Deadreck]
) -> None:
    told, deviation = START_NS + 30_000_000_000, np.zeros(9)
    deviation[0] = 0.02
    belief = prior(PredictParameters().dynamics, PredictParameters().doubt)
    known = np.hstack((np.zeros((9, 15)), np.diag([0.005**2] * 5 + [0.1**2] * 4)))
    record = VehicleParameters(told, "map", *belief, deviation, known)
    without = odometry(voyage[0])
    lines = odometry(sailed(sorted([*on_time(twin), (told, "predict/parameters", record)], key=lambda a: a[0]))[0])
    turned = np.array([difference(a, b)[1] for a, b in zip(without, lines, strict=True)])
    after = np.array([line.stamp_ns for line in lines]) > told + 20_000_000_000
    assert abs(np.median(turned[after]) - 0.02) < 0.004  # what is left of its time constant of 600 s: 3 to 10 %
    # yaw given the deviation is the mean of some ten measurements, as turn rates are off by 0.008 rad/s over their
    # 0.1 s: a gain of 0.1 to 0.2 a measurement, no step of more than a quarter of what was told
    assert np.abs(np.diff(turned)).max() < 0.25 * 0.02
    variance = np.array([line.pose_covariance[5, 5] for line in lines])
    assert np.median(variance[after]) < 0.4 * np.median([line.pose_covariance[5, 5] for line in without])


def test_yaw_is_never_surer_than_the_compass_deviates(voyage: tuple[list[Output], Deadreck]) -> None:
    """Every heading has the deviation's whole variance; a turn carries little from one heading to the next."""
    deviation = DeadreckParameters().compass.deviation
    sigma = np.sqrt([line.pose_covariance[5, 5] for line in odometry(voyage[0])[100:]])
    assert sigma.min() > 0.9 * deviation
