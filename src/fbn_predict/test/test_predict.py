"""The predict filter: its grid, late commands, feedback, parameters, silence and bad input."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from fbn_common.estimator import Level
from fbn_common.motion_ekf.layout import GRID_NS
from fbn_common.records import Innovation, JointState, Odometry, Pose, PredictedMotion, VehicleParameters, Verdict
from fbn_common.types import Array
from fbn_predict.estimator import INNOVATIONS, MOTION, PARAMETERS, Predict
from fbn_predict.parameters import PredictParameters, prior

T0 = 50_000_000_000
NONE = np.empty(0)


@pytest.fixture(scope="module")
def parameters() -> PredictParameters:
    return PredictParameters()


def command(stamp: int, rate: float = 100.0, pan: float = 0.0) -> JointState:
    return JointState(
        stamp, "", ("propeller", "pan", "tilt"), np.array([0.0, pan, 0.0]), np.array([rate, 0.0, 0.0]), NONE
    )


def odometry(stamp: int, speed: float, yaw: float = 0.0) -> Odometry:
    q = np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
    return Odometry(
        stamp,
        "odom",
        "base_link",
        Pose(np.array([0.0, 0, -3]), q),
        np.array([speed, 0, 0, 0, 0, 0]),
        np.eye(6),
        np.eye(6),
    )


def motions(outputs: list) -> list[PredictedMotion]:  # type: ignore[type-arg]
    return [o.record for o in outputs if o.topic == MOTION]


def moved(parts: list[PredictedMotion]) -> Array:
    """The newest version of each step, as rows of increment, rotation, velocity at end."""
    newest = {m.stamp_ns: m for m in parts}
    return np.array([np.concatenate((m.increment, m.rotation, m.velocity_end)) for _, m in sorted(newest.items())])


def test_motions_tile_time_on_a_grid_of_ten_milliseconds(parameters: PredictParameters) -> None:
    predict = Predict(parameters)
    predict.put("actuators", command(T0 + 3))
    out = motions(predict.advance(T0 + 200_000_001) + predict.advance(T0 + 333_000_000))
    assert out[0].start_ns == T0
    assert all(m.stamp_ns - m.start_ns == GRID_NS and m.stamp_ns % GRID_NS == 0 for m in out)
    assert all(a.stamp_ns == b.start_ns for a, b in itertools.pairwise(out))
    assert out[-1].stamp_ns == T0 + 330_000_000


def test_a_late_command_gives_the_motion_it_would_have_given_in_time(parameters: PredictParameters) -> None:
    early, late = Predict(parameters), Predict(parameters)
    commands = [command(T0), command(T0 + 123_456_789, 120.0, 0.3), command(T0 + 250_000_000, 120.0, -0.2)]
    for c in commands:
        early.put("actuators", c)
    late.put("actuators", commands[0])
    expected = motions(early.advance(T0 + 500_000_000))
    got = motions(late.advance(T0 + 300_000_000))
    late.put("actuators", commands[2])
    late.put("actuators", commands[1])
    got += motions(late.advance(T0 + 500_000_000))
    assert np.array_equal(moved(got), moved(expected))


def test_a_stamp_moved_by_a_microsecond_moves_the_motion_by_next_to_nothing(parameters: PredictParameters) -> None:
    ends = []
    for shift in (0, 1000):
        predict = Predict(parameters)
        predict.put("actuators", command(T0))
        predict.put("actuators", command(T0 + 100_000_000 - 500 + shift, 120.0, 0.4))
        ends.append(moved(motions(predict.advance(T0 + 1_000_000_000))))
    # 1 us of 0.1 rad/s^2 turning and 0.03 m/s^2 of thrust, over 1 s
    np.testing.assert_allclose(ends[1].sum(axis=0), ends[0].sum(axis=0), atol=1e-5)


def test_adopted_parameters_leave_the_velocity_continuous(parameters: PredictParameters) -> None:
    predict = Predict(parameters)
    predict.put("actuators", command(T0))
    before = motions(predict.advance(T0 + 3_000_000_000))
    mean, covariance = prior(parameters.dynamics, parameters.doubt)
    mean = mean.copy()
    mean[9] *= 1.3
    mean[12] = 0.4
    predict.put("reference/parameters", VehicleParameters(T0 + 3_000_000_000, "map", mean, covariance))
    out = predict.advance(T0 + 3_200_000_000)
    after = motions(out)
    assert np.array_equal(after[0].velocity_start, before[-1].velocity_end)
    assert np.array_equal(after[0].parameters, mean)
    assert [o.record.mean[12] for o in out if o.topic == PARAMETERS] == [0.4]  # type: ignore[attr-defined]


def test_feedback_carries_its_difference_forward_to_now(parameters: PredictParameters) -> None:
    predict = Predict(parameters)
    predict.put("actuators", command(T0, 0.0))
    predict.advance(T0 + 1_000_000_000)
    predict.put("deadreck/odometry", odometry(T0 + 500_000_000, 0.5))
    first = motions(predict.advance(T0 + 1_010_000_000))[0]
    # from rest at the stamp, 0.5 s of damping by 0.27 1/s
    assert first.velocity_start[0] == pytest.approx(0.5 * np.exp(-0.27 * 0.5), rel=1e-3)


def test_feedback_that_cannot_be_used_keeps_none_of_the_rest_out(parameters: PredictParameters) -> None:
    together, alone, ms = Predict(parameters), Predict(parameters), 1_000_000
    good = [odometry(T0 + 500 * ms, 0.5), odometry(T0 + 530 * ms, 0.4)]
    bad = [odometry(T0 + 510 * ms, np.nan), odometry(T0 + 515 * ms + 1, 0.9), odometry(T0 - 10 * ms, 0.9)]
    for predict, lines in ((together, [bad[0], good[1], bad[1], good[0], bad[2]]), (alone, good)):
        predict.put("actuators", command(T0, 0.0))
        predict.advance(T0 + 1000 * ms)
        for line in lines:
            predict.put("deadreck/odometry", line)
    mixed, plain = together.advance(T0 + 1010 * ms), motions(alone.advance(T0 + 1010 * ms))
    assert [o.record.reason for o in mixed if o.topic == INNOVATIONS] == ["not finite"]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(motions(mixed)[0].numbers, plain[0].numbers)
    counts = together.health().values
    assert (counts["feedback.used"], counts["feedback.unused"], counts["deadreck.refused"]) == (2, 2, 1)


def test_without_actuators_motion_is_predicted_and_uncertain(parameters: PredictParameters) -> None:
    silent, heard = Predict(parameters), Predict(parameters)
    heard.put("actuators", command(T0, 0.0))
    quiet, told = (
        motions(silent.advance(T0) + silent.advance(T0 + 100_000_000)),
        motions(heard.advance(T0 + 100_000_000)),
    )
    assert silent.health().level is Level.WARN
    assert np.trace(quiet[-1].noise) > 10.0 * np.trace(told[-1].noise)


def test_silence_of_the_actuators_is_named_and_prediction_goes_on(parameters: PredictParameters) -> None:
    predict = Predict(parameters)
    predict.put("actuators", command(T0))
    out = motions(predict.advance(T0 + 5_000_000_000))
    assert len(out) == 500
    assert "silent for 5.0 s" in predict.health().message
    assert np.trace(out[-1].noise) > 10.0 * np.trace(out[0].noise)


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (command(T0, np.nan), "propeller is nan"),
        (command(T0, 1e6), "propeller is 1000000.0"),
        (replace(command(T0), position=np.empty(1)), "3 names, but 1 values"),
        (replace(command(T0), name=("a", "b", "c")), "names none of"),
        (command(T0 + 60_000_000_000), "ahead of the clock"),
    ],
)
def test_a_malformed_command_is_refused_with_its_reason(
    parameters: PredictParameters, record: JointState, reason: str
) -> None:
    predict = Predict(parameters)
    predict.put("actuators", record)
    said = [o.record for o in predict.advance(T0 + 20_000_000) if o.topic.endswith("innovations")]
    assert [i.verdict for i in said] == [Verdict.REFUSED]  # type: ignore[attr-defined]
    assert reason in said[0].reason  # type: ignore[attr-defined]


@pytest.mark.parametrize("jump_s", [-30, 3600])
def test_a_jump_of_the_clock_starts_the_grid_anew_and_says_so(parameters: PredictParameters, jump_s: int) -> None:
    predict = Predict(parameters)
    predict.put("actuators", command(T0))
    predict.advance(T0 + 1_000_000_000)
    now = T0 + jump_s * 1_000_000_000
    said = [o.record.reason for o in predict.advance(now) if o.topic.endswith("innovations")]  # type: ignore[attr-defined]
    assert "jumped" in said[0]
    assert motions(predict.advance(now + 50_000_000))[0].start_ns == now


def fed(predict: Predict, commands: list[JointState]) -> list[Innovation]:
    """The answers to commands at 10 Hz, from the first stamp on."""
    said = []
    for c in commands:
        predict.put("actuators", c)
        said += [o.record for o in predict.advance(c.stamp_ns) if isinstance(o.record, Innovation)]
    return said


def lively(count: int, begin: int = 0) -> list[JointState]:
    """Commands of a control loop: each a little different."""
    return [command(T0 + 100_000_000 * k, 120.0, 0.01 * np.sin(k)) for k in range(begin, begin + count)]


def test_commands_that_stop_changing_are_named_after_two_seconds_and_count_as_silence(
    parameters: PredictParameters,
) -> None:
    predict = Predict(parameters)
    stuck = [replace(lively(1, 149)[0], stamp_ns=T0 + 100_000_000 * k) for k in range(150, 210)]
    assert not fed(predict, lively(150))
    said = fed(predict, stuck)
    assert said[0].reason == "frozen: 21 equal commands in a row, never more than 1 before"
    assert said[0].verdict is Verdict.REFUSED
    assert said[0].stamp_ns == stuck[19].stamp_ns
    assert len(said) == len(stuck) - 19
    assert predict.health().message.startswith("actuators frozen? 61 equal commands")
    assert predict.health().level is Level.WARN
    now = stuck[-1].stamp_ns
    noise = motions(predict.advance(now + GRID_NS))[0].noise
    assert not fed(predict, lively(1, 210))  # a change is believed at once
    assert predict.health().level is Level.OK
    assert np.trace(noise) > 10.0 * np.trace(motions(predict.advance(now + 120_000_000))[0].noise)


@pytest.mark.parametrize(
    ("name", "before", "constant"),
    [
        ("from the start", 0, command(0)),
        ("at rest", 150, command(0, 0.0)),
    ],
)
def test_constant_commands_that_may_be_meant_are_believed(
    parameters: PredictParameters, name: str, before: int, constant: JointState
) -> None:
    predict = Predict(parameters)
    same = [replace(constant, stamp_ns=T0 + 100_000_000 * k) for k in range(before, before + 300)]
    assert not fed(predict, [*lively(before), *same])
    assert predict.health().level is Level.OK


def test_a_stream_that_used_to_stay_the_same_may_do_so_again(parameters: PredictParameters) -> None:
    """Steps of 1 s: up to three times as long, and never less than 2 s, is not suspicious."""
    predict = Predict(parameters)
    steps = [command(T0 + 100_000_000 * k, 120.0, 0.01 * (k // 10 if k < 1500 else 149)) for k in range(1535)]
    said = fed(predict, steps)
    assert [s.reason for s in said[:1]] == ["frozen: 28 equal commands in a row, never more than 10 before"]
