"""What a check finds, and the sensor data it looks at."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeVar

import numpy as np

from fbn_bringup.evaluation.series import Stamps, Traffic
from fbn_common.records import Record

R = TypeVar("R", bound=Record)


class Severity(IntEnum):
    """How much a finding matters."""

    NOTE = 0  # good to know
    WARNING = 1  # navigation will be worse
    ERROR = 2  # no navigation by this log


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found; ``remedy`` says what to do, or what the estimators will do."""

    severity: Severity
    topic: str
    text: str
    remedy: str


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """The sensors' side of a log: records and traffic by topic, and what could not be decoded, by reason."""

    records: dict[str, list[Record]]
    traffic: dict[str, Traffic]
    malformed: dict[str, Counter[str]] = field(default_factory=dict)

    def of(self, topic: str, kind: type[R]) -> list[R]:
        """The records of a topic, in the order logged."""
        return [x for x in self.records.get(topic, ()) if isinstance(x, kind)]


def stamps(records: list[R]) -> Stamps:
    """Stamps (n,) [ns]."""
    return np.array([x.stamp_ns for x in records], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The outcome: everything found, the worst first."""

    bag: str
    log: Log
    findings: tuple[Finding, ...]
    missing: tuple[str, ...]  # sensors' topics without a message

    @property
    def can_navigate(self) -> bool:
        """Is there no error among the findings?"""
        return all(f.severity < Severity.ERROR for f in self.findings)
