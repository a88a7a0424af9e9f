"""Each node alone, over DDS: what it gives is what its estimator gives in one process, live and in lock step."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbn_bringup.configuration import Parameters
from fbn_bringup.offline import steps
from fbn_common import records as r
from fbn_common.graph import GRAPH
from fbn_common.parameters import ParameterError, flatten
from fbn_testing.compare import difference, read_log
from fbn_testing.fakes import FAKE_GRAPH
from fbn_testing.faults import with_field
from fbn_testing.harness import NodeHarness
from fbn_testing.logs import sensor_record

RNG = np.random.default_rng(5)
STEPS = 60  # 12 s of the log: every node has published by then


def given(parameters: Any) -> dict[str, Any]:
    """Parameters as a node is given them; ROS has neither null nor an untyped empty list."""
    return {name: value for name, value in flatten(parameters).items() if value is not None and value != []}


@pytest.mark.parametrize("name", [node.name for node in GRAPH.nodes])
def test_a_node_over_dds_says_what_its_estimator_says_in_one_process(
    name: str, river_run: Path, river_parameters: Parameters, domain: int
) -> None:
    node = GRAPH.node(name)
    log = read_log(river_run / "bag")
    wanted = {*node.inputs, *node.feedback}
    played = [s for s, _ in zip(steps(log), range(STEPS), strict=False)]
    with NodeHarness(node, domain, given(river_parameters[name]), lock_step=True) as harness:
        for step in played:
            for _, topic, record in step.logged:
                if topic in wanted:
                    harness.publish(topic, record)
            harness.step(step.end_ns)
        heard = harness.received
        for topic in node.outputs:
            expected = [e.record for e in log if e.topic == topic and e.log_time_ns <= played[-1].end_ns]
            assert len(heard[topic]) == len(expected), topic
            assert not any(difference(a, b, topic) for a, b in zip(expected, heard[topic], strict=True))
    assert sum(map(len, heard.values())) > STEPS


def test_a_live_node_advances_by_its_timer_and_publishes(domain: int) -> None:
    with NodeHarness(FAKE_GRAPH.node("deadreck"), domain, graph=FAKE_GRAPH) as harness:
        harness.publish("pressure", sensor_record("pressure", harness.now_ns(), 0, RNG))
        harness.publish("sonar/detections", sensor_record("sonar/detections", harness.now_ns(), 1, RNG))
        harness.spin_until(lambda: bool(harness.received["deadreck/ping_motion"]))
        harness.spin_until(lambda: len(harness.received["deadreck/odometry"]) > 10)
        stamps = [record.stamp_ns for record in harness.received["deadreck/odometry"]]
        assert np.all(np.diff(stamps) > 0)


BAD = {
    "a pressure that is no number": ("pressure", with_field("fluid_pressure", float("nan")), "fluid_pressure"),
    "a quaternion of zero norm": ("imu/data", with_field("orientation", np.zeros(4)), "orientation"),
    "a covariance with a NaN": (
        "imu/data",
        with_field("orientation_covariance", np.full((3, 3), np.nan)),
        "covariance",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_malformed_data_is_answered_and_good_data_beside_it_is_used(case: str, domain: int) -> None:
    topic, spoil, field = BAD[case]
    with NodeHarness(FAKE_GRAPH.node("deadreck"), domain, graph=FAKE_GRAPH) as harness:
        now_ns = harness.now_ns()
        harness.publish(topic, spoil(sensor_record(topic, now_ns, 0, RNG)))
        harness.publish("altitude", sensor_record("altitude", now_ns, 0, RNG))
        harness.spin_until(lambda: bool(harness.received["deadreck/innovations"]))
        answer = harness.received["deadreck/innovations"][0]
        assert isinstance(answer, r.Innovation)
        assert (answer.verdict, answer.sensor, answer.stamp_ns) == (r.Verdict.REFUSED, topic, now_ns)
        assert field in answer.reason
        harness.spin_until(lambda: harness.node.host.health().values["taken"] == 1)


def test_bytes_that_are_no_message_are_answered_too(domain: int) -> None:
    with NodeHarness(FAKE_GRAPH.node("deadreck"), domain, graph=FAKE_GRAPH) as harness:
        harness.publish_raw("imu/data", b"\x00\x01\x00\x00 this is no imu")
        harness.spin_until(lambda: bool(harness.received["deadreck/innovations"]))
        answer = harness.received["deadreck/innovations"][0]
        assert isinstance(answer, r.Innovation)
        assert answer.verdict is r.Verdict.REFUSED
        assert "the bytes of a sensor_msgs/msg/Imu" in answer.reason


def test_diagnostics_tell_health_counts_rates_and_what_is_missing(domain: int) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    with NodeHarness(FAKE_GRAPH.node("deadreck"), domain, graph=FAKE_GRAPH) as harness:
        harness.listen("/diagnostics", DiagnosticArray)
        harness.publish("pressure", sensor_record("pressure", harness.now_ns(), 0, RNG))
        harness.publish("pressure", r.FluidPressure(harness.now_ns(), "", float("inf"), 1.0))
        harness.spin_until(lambda: len(harness.messages["/diagnostics"]) >= 2)
        status = harness.messages["/diagnostics"][-1].status[0]
        values = {v.key: v.value for v in status.values}
        assert status.hardware_id == "fbn_deadreck"
        assert status.level == bytes([1])  # WARN: something was refused
        assert (values["taken"], values["malformed pressure"], values["pressure count"]) == ("1", "1", "1")
        assert "imu/data" in values["silent"]
        assert "nothing on imu/data (attitude by prediction alone" in status.message


def test_a_node_that_was_killed_is_named_by_those_who_need_it_and_so_is_its_return(domain: int) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    upstream = [sys.executable, "-m", "fbn_testing.node", "--ros-args", "-r", "__node:=fbn_predict"]
    mine = ("predict/motion", "predict/parameters")
    with NodeHarness(FAKE_GRAPH.node("deadreck"), domain, graph=FAKE_GRAPH, not_mine=mine) as harness:
        harness.listen("/diagnostics", DiagnosticArray)

        def told() -> list[tuple[str, str]]:
            own = [a.status[0] for a in harness.messages["/diagnostics"] if a.status[0].hardware_id == "fbn_deadreck"]
            return [(s.message, v.value) for s in own for v in s.values if v.key == "gone"]

        for _ in range(2):
            with subprocess.Popen(upstream, stderr=subprocess.DEVNULL) as predict:
                harness.spin_until(lambda: harness.node.statistics.received["predict/motion"] > 0, 20.0)
                harness.spin_until(lambda: told()[-1:] != [] and told()[-1][1] == "")
                harness.node.statistics.received.clear()
                predict.kill()
            harness.spin_until(lambda: told()[-1][1] == "predict/motion predict/parameters")
            assert "nothing on predict/motion (the filters stand still)" in told()[-1][0]


def test_parameters_are_declared_with_unit_and_origin(domain: int) -> None:
    with NodeHarness(FAKE_GRAPH.node("global"), domain, {"gain": 0.5}, graph=FAKE_GRAPH) as harness:
        assert harness.node.get_parameter("gain").value == 0.5
        assert harness.node.get_parameter("names").value == ["a", "b"]
        assert "[-]; from: arbitrary" in harness.node.describe_parameter("gain").description


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"gian": 0.5}, "unknown parameter 'gian'; did you mean 'gain'?"),
        ({"gain": 7.0}, "gain must lie between 0 and 1"),
        ({"gain": "much"}, "gain [-]: expected float, got 'much'"),
    ],
)
def test_a_wrong_parameter_is_refused_with_the_remedy(parameters: dict[str, Any], said: str, domain: int) -> None:
    with (
        pytest.raises(ParameterError) as caught,
        NodeHarness(FAKE_GRAPH.node("global"), domain, parameters, graph=FAKE_GRAPH),
    ):
        pass
    assert said in str(caught.value)
