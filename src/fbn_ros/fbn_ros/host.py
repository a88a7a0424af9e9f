"""An estimator as whoever runs it sees it: counted, timed, with malformed messages answered for it."""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections import Counter
from typing import Any

import numpy as np

from fbn_common.estimator import Estimator, Health, Level, Output
from fbn_common.graph import Node
from fbn_common.records import Innovation, Record, Verdict
from fbn_ros.conversion import ConversionError


def resolve(reference: str) -> Any:
    """The object that ``module:name`` names."""
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)


class Host:
    """One node's estimator; the same in a process of its own and in the offline runner.

    A message that was refused at the edge becomes an ``Innovation`` (REFUSED, with the reason) of this node.
    """

    def __init__(self, node: Node, estimator: Estimator) -> None:
        self.node, self.estimator = node, estimator
        self.received: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.published: Counter[str] = Counter()
        self.cpu_ns = 0
        self.advances = 0
        self._answers: list[Output] = []
        self._innovations = next(t for t in node.outputs if t.endswith("/innovations"))

    @classmethod
    def build(cls, node: Node, parameters: Any) -> Host:
        """The node's estimator with these parameters."""
        return cls(node, resolve(node.estimator)(parameters))

    def put(self, topic: str, record: Record | ConversionError) -> None:
        """Hand a record on; an error is answered."""
        if isinstance(record, ConversionError):
            self.refuse(topic, record)
            return
        self.received[topic] += 1
        begin = time.thread_time_ns()
        self.estimator.put(topic, record)
        self.cpu_ns += time.thread_time_ns() - begin

    def refuse(self, topic: str, error: ConversionError) -> None:
        """Answer a message of which no record could be made; it is published with the next advance."""
        self.refused[topic] += 1
        reason = f"{error.field}: expected {error.expected}, got {error.got}"
        none = np.zeros(0)
        answer = Innovation(error.stamp_ns, "", topic, 0.0, 0, Verdict.REFUSED, reason, none, none)
        self._answers.append(Output(self._innovations, answer))

    def advance(self, now_ns: int) -> list[Output]:
        """Everything there is to publish now."""
        begin = time.thread_time_ns()
        outputs = self.estimator.advance(now_ns)
        self.cpu_ns += time.thread_time_ns() - begin
        self.advances += 1
        answers, self._answers = self._answers, []
        for output in (outputs := [*answers, *outputs]):
            self.published[output.topic] += 1
        return outputs

    def health(self) -> Health:
        """The estimator's, with what was refused before it got there."""
        health = self.estimator.health()
        if not self.refused:
            return health
        counts = {f"malformed {topic}": n for topic, n in sorted(self.refused.items())}
        level = max(health.level, Level.WARN) if health.level is not Level.STALE else health.level
        return dataclasses.replace(health, level=level, values=health.values | counts)
