"""The motion half in one process, in lock step, for tests and campaigns; the offline runner's way in small."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fbn_common.estimator import Estimator, Output
from fbn_common.graph import GRAPH
from fbn_common.records import Record


def run(
    estimators: Mapping[str, Estimator], records: Iterable[tuple[int, str, Record]], step_ns: int = 200_000_000
) -> list[Output]:
    """All outputs of these nodes (names of the graph's) on records ``(time of arrival, topic, record)``, sorted."""
    nodes = [n for n in GRAPH.nodes if n.name in estimators]
    outputs: list[Output] = []
    feedback: list[Output] = []
    batch: list[tuple[str, Record]] = []
    end = -1

    def advance() -> None:
        nonlocal feedback, batch
        made: list[Output] = []
        for node in nodes:
            estimator = estimators[node.name]
            for topic, record in (*batch, *made):
                if topic in node.inputs:
                    estimator.put(topic, record)
            for topic, record in feedback:
                if topic in node.feedback:
                    estimator.put(topic, record)
            made += estimator.advance(end)
        outputs.extend(made)
        feedback, batch = made, []

    for arrival, topic, record in records:
        if end < 0:
            end = (arrival // step_ns + 1) * step_ns
        while arrival > end:
            advance()
            end += step_ns
        batch.append((topic, record))
    advance()
    return outputs
