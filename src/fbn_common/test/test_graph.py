"""The graph's declaration is consistent with itself."""

from __future__ import annotations

import pytest

from fbn_common.graph import GRAPH


def test_every_input_and_output_is_a_declared_topic() -> None:
    for node in GRAPH.nodes:
        assert {*node.inputs, *node.outputs, *node.feedback} <= set(GRAPH.topics)


def test_every_topic_has_at_most_one_publisher() -> None:
    outputs = [topic for node in GRAPH.nodes for topic in node.outputs]
    assert len(outputs) == len(set(outputs))


def test_data_flows_forward_and_loops_only_through_feedback() -> None:
    order = [node.name for node in GRAPH.nodes]
    for position, node in enumerate(GRAPH.nodes):
        for topic in node.inputs:
            publisher = GRAPH.publisher(topic)
            assert publisher is None or order.index(publisher.name) < position, (
                f"{topic} runs backward into {node.name}"
            )


def test_external_inputs_are_what_sensors_must_supply() -> None:
    assert set(GRAPH.external_inputs()) == {
        "actuators", "imu/data", "pressure", "altitude", "gps/fix", "lbl/range", "sonar/detections",
    }  # fmt: skip


def test_a_part_of_the_graph_asks_the_log_for_what_the_missing_part_published() -> None:
    tail = GRAPH.only(("tracking", "global"))
    assert "deadreck/ping_motion" in tail.external_inputs()
    assert [n.name for n in tail.nodes] == ["fbn_tracking", "fbn_global"]


def test_an_unknown_node_is_answered_with_those_there_are() -> None:
    with pytest.raises(KeyError, match="fbn_global"):
        GRAPH.node("navigator")
