"""The motion half in one process, in lock step, for tests and campaigns; the offline runner's way in small."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from fbn_common.estimator import Estimator, Output
from fbn_common.graph import GRAPH
from fbn_common.records import Record

Arrival = tuple[int, str, Record]  # time of arrival, topic, record


def run(estimators: Mapping[str, Estimator], records: Iterable[Arrival], step_ns: int = 200_000_000) -> list[Output]:
    """All outputs of these nodes (names of the graph's) on records ``(time of arrival, topic, record)``, sorted."""
    return [output for made in play(estimators, records, step_ns) for output in made]


def play(
    estimators: Mapping[str, Estimator],
    records: Iterable[Arrival],
    step_ns: int = 200_000_000,
    withheld: frozenset[str] = frozenset(),
) -> Iterator[list[Output]]:
    """As :func:`run`, step by step, so that nothing need be kept; topics ``withheld`` are given to no node."""
    nodes = [n for n in GRAPH.nodes if n.name in estimators]
    feedback: list[Output] = []
    for end, batch in _batches(records, step_ns):
        made: list[Output] = []
        for node in nodes:
            estimator = estimators[node.name]
            for topic, record in (*batch, *made):
                if topic in node.inputs and topic not in withheld:
                    estimator.put(topic, record)
            for topic, record in feedback:
                if topic in node.feedback and topic not in withheld:
                    estimator.put(topic, record)
            made += estimator.advance(end)
        feedback = made
        yield made


def _batches(records: Iterable[Arrival], step_ns: int) -> Iterator[tuple[int, list[tuple[str, Record]]]]:
    """The records cut at whole multiples of the step, empty steps included: end of the step, and what arrived in it."""
    batch: list[tuple[str, Record]] = []
    end = -1
    for arrival, topic, record in records:
        if end < 0:
            end = (arrival // step_ns + 1) * step_ns
        while arrival > end:
            yield end, batch
            end, batch = end + step_ns, []
        batch.append((topic, record))
    yield end, batch
