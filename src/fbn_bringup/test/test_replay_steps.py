"""How a log is cut into steps, and how parameters reach the nodes."""

from __future__ import annotations

from pathlib import Path

import pytest

from fbn_bringup.configuration import load_parameters, node_files
from fbn_bringup.offline import run_offline, stamped, steps
from fbn_common.graph import GRAPH
from fbn_common.parameters import ParameterError
from fbn_common.types import NS, nanoseconds
from fbn_testing.fakes import FAKE_GRAPH, FakeParameters
from fbn_testing.logs import sensor_log

STEP = nanoseconds(0.2)


def test_a_message_belongs_to_the_step_that_ends_at_or_after_its_log_time() -> None:
    log = [(5 * STEP - 1, "a", 1), (5 * STEP, "a", 2), (5 * STEP + 1, "a", 3)]
    assert [(s.end_ns // STEP, [e[2] for e in s.logged]) for s in steps(log)] == [(5, [1, 2]), (6, [3])]


def test_steps_without_messages_are_taken_too() -> None:
    log = [(STEP, "a", 1), (4 * STEP, "a", 2)]
    assert [(s.end_ns // STEP, len(s.logged)) for s in steps(log)] == [(1, 1), (2, 0), (3, 0), (4, 1)]


def test_a_long_silence_is_one_step() -> None:
    log = [(STEP, "a", 1), (STEP + 3600 * NS, "a", 2)]
    assert [len(s.logged) for s in steps(log)] == [1, 1]


def test_a_log_time_that_goes_back_stays_in_the_open_step() -> None:
    log = [(10 * STEP, "a", 1), (2 * STEP, "a", 2), (11 * STEP, "a", 3)]
    assert [[e[2] for e in s.logged] for s in steps(log)] == [[1, 2], [3]]


def test_outputs_get_log_times_in_their_order_that_end_with_the_step() -> None:
    assert list(stamped(100, ["a", "b", "c"])) == [(98, "a"), (99, "b"), (100, "c")]


def test_what_is_published_reaches_later_nodes_at_once_and_closes_loops_one_step_later() -> None:
    taken: dict[str, int] = {}
    first = [entry for entry in sensor_log(2.0) if entry[0] <= (1_700_000_000 * NS + STEP)]
    hosts = run_offline(FAKE_GRAPH, {n.name: FakeParameters() for n in FAKE_GRAPH.nodes}, first)
    for host in hosts:
        taken |= {topic: host.received[topic] for topic in (*host.node.inputs, *host.node.feedback)}
    assert taken["predict/motion"] > 0 and taken["tracking/composite"] == 1
    assert taken["reference/parameters"] == 0  # only one step was taken


def test_later_files_win_over_earlier_ones_and_overrides_over_all(tmp_path: Path) -> None:
    for name, gain in (("a", 0.1), ("b", 0.2)):
        text = f"/**:\n  ros__parameters: {{gain: 0.9}}\nfbn_global:\n  ros__parameters: {{gain: {gain}}}\n"
        (tmp_path / name).write_text(text)
    files = (tmp_path / "a", tmp_path / "b")
    loaded = load_parameters(FAKE_GRAPH, files, {"tracking.gain": 0.4})
    assert (loaded["fbn_global"].gain, loaded["fbn_tracking"].gain, loaded["fbn_predict"].gain) == (0.2, 0.4, 0.9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("fbn_golbal:\n  ros__parameters: {gain: 0.5}\n", "no node 'fbn_golbal'"),
        ("fbn_global:\n  ros__parameters: {gian: 0.5}\n", "fbn_global: unknown parameter 'gian'; did you mean 'gain'?"),
        ("fbn_global:\n  gain: 0.5\n", "must hold 'ros__parameters:'"),
        ("fbn_global: [", "not a readable parameter file"),
    ],
)
def test_a_wrong_parameter_file_is_refused_with_what_is_wrong(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(ParameterError) as caught:
        load_parameters(FAKE_GRAPH, (tmp_path / "file.yaml",))
    assert said in str(caught.value)


def test_an_override_for_no_node_is_refused() -> None:
    with pytest.raises(ParameterError, match="no node 'sonar'; there are fbn_predict"):
        load_parameters(FAKE_GRAPH, (), {"sonar.gain": 1.0})


def test_the_nodes_get_their_parameters_in_any_namespace() -> None:
    document = node_files(load_parameters(FAKE_GRAPH, (), {"global.gain": 0.25}))
    assert document["/**/fbn_global"] == {"ros__parameters": {"gain": 0.25, "names": ["a", "b"]}}


def test_a_sonar_file_is_looked_for_beside_the_parameter_file_and_its_arrays_reach_the_node(tmp_path: Path) -> None:
    sonar = "{name: A, about: a, frequency: 7.0e+5, aperture: 0.1, ping_rate: 5.0, arrays: {bow: {bearing_min: 1.0, "
    sonar += "bearing_max: 2.0, range_min: 1.0, range_max: 50.0, lobe_width: 0.3, range_sigma: 0.05, "
    (tmp_path / "mine.yaml").write_text(sonar + "bearing_sigma: 0.02, detection_probability: 0.5}}}")
    vehicle = tmp_path / "vehicle.yaml"
    vehicle.write_text("fbn_tracking: {ros__parameters: {head.sonar: mine.yaml, arrays.bow.range_max: 30.0}}")
    loaded = load_parameters(GRAPH, (vehicle,))
    (array,) = loaded["fbn_tracking"].arrays.values()
    assert array.bearing_max == 2.0 and array.range_max == 30.0
    given = node_files(loaded)["/**/fbn_tracking"]["ros__parameters"]
    assert given["arrays.bow.bearing_max"] == 2.0 and given["head.sonar"] == str(tmp_path / "mine.yaml")


def test_a_sonar_that_does_not_exist_is_refused_with_those_that_do(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="fbn_tracking: no sonar 'p900'; there are blueview_p450_130"):
        load_parameters(GRAPH, (), {"tracking.head.sonar": "p900"})
