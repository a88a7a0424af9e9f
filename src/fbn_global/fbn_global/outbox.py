"""What an estimator has to publish: records, and an answer to every measurement, counted."""

from __future__ import annotations

import numpy as np

from fbn_common.estimator import Output
from fbn_common.records import Innovation, Record, Verdict
from fbn_common.types import Array


class Outbox:
    """Outputs of one advance, and counts of all answers so far."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._outputs: list[Output] = []

    def empty(self) -> list[Output]:
        """All that is to be published; the box is empty then."""
        outputs, self._outputs = self._outputs, []
        return outputs

    def publish(self, topic: str, record: Record) -> None:
        self._outputs.append(Output(topic, record))

    def answer(self, stamp_ns: int, sensor: str, verdict: Verdict, reason: str = "") -> None:
        """An answer without an innovation."""
        self.innovation(stamp_ns, sensor, verdict, reason, np.zeros(0), np.zeros(0), 0.0, 0)

    def innovation(
        self,
        stamp_ns: int,
        sensor: str,
        verdict: Verdict,
        reason: str,
        innovation: Array,
        sigma: Array,
        nis: float,
        dof: int,
    ) -> None:
        """One measurement's answer."""
        name = f"{sensor} {verdict.name.lower()}"
        self.counts[name] = self.counts.get(name, 0) + 1
        record = Innovation(stamp_ns, "map", sensor, nis, dof, verdict, reason, innovation, sigma)
        self.publish("global/innovations", record)
