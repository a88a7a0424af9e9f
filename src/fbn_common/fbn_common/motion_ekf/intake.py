"""How a topic's records become measurements of the timeline, and how each of them is answered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from fbn_common.motion_ekf.layout import CLIMB_ROW, COMPASS_ROW, DEPTH_ROW, Events, Kind, Reason
from fbn_common.motion_ekf.monitor import Watch, content_of
from fbn_common.motion_ekf.parameters import FilterParameters, SensorParameters
from fbn_common.motion_ekf.sensors import altitude_data, compass_data, depth_data
from fbn_common.records import Innovation, Verdict
from fbn_common.types import Array

_VERDICTS = tuple(Verdict)  # by value
_NAMES = tuple(v.name for v in _VERDICTS)
_RESET = int(Reason.RESET)
_REASONS: dict[int, str] = {
    Reason.NONE: "",
    Reason.GATE: "outside the gate",
    Reason.RULE: "no better than the filter's own position",
    Reason.UNDER_WATER: "a fix under water",
    Reason.DROPPED: "this beacon disagreed too often",
    Reason.RESET: "gate reset after consistent outliers",
    Reason.SINGULAR: "innovation covariance not positive definite",
    Reason.BASE: "base of the next vertical speed",
    Reason.TILTED: "does not look down",
}


@dataclass(slots=True)
class Intake:
    """How one topic's records become measurements."""

    sensor: str
    parameters: SensorParameters
    kind: Kind
    row: int
    data: Callable[[Any], Array | None]
    content: Callable[[Any], bytes]
    watch: Watch = field(init=False)

    def __post_init__(self) -> None:
        self.watch = self._new_watch()

    def _new_watch(self) -> Watch:
        p = self.parameters
        return Watch(p.frozen_after, p.dead_after if p.use else 0.0)

    def reset(self) -> None:
        """Forget what came in; the counters stay."""
        verdicts = self.watch.verdicts
        self.watch = self._new_watch()
        self.watch.verdicts = verdicts

    def objection(self, record: Any, bounds: tuple[int, int]) -> tuple[Verdict, str] | None:
        """Why a record is not to be used; ``bounds``: oldest and newest stamp allowed."""
        found = self.watch.objection(record.stamp_ns, self.content(record), bounds)
        return found if self.parameters.use else (Verdict.REFUSED, "switched off by parameter")

    def answer(self, events: Events, slot: int, frame_id: str) -> Innovation:
        """What became of the measurement in this slot; counts it."""
        n, reason, verdict = events.dof.item(slot), events.reason.item(slot), events.verdict.item(slot)
        self.watch.verdicts[_NAMES[verdict]] += 1
        if reason == _RESET:
            self.watch.verdicts["RESET"] += 1
        return Innovation(
            events.stamp.item(slot), frame_id, self.sensor, events.nis.item(slot), n, _VERDICTS[verdict],
            _REASONS[reason], events.innovation[slot, :n].copy(), events.sigma[slot, :n].copy(),
        )  # fmt: skip


def common_intakes(p: FilterParameters) -> dict[str, Intake]:
    """Those of the sensors that both filters listen to, by topic."""
    return {
        "imu/data": Intake(
            "compass", p.compass, Kind.COMPASS, COMPASS_ROW,
            lambda r: compass_data(r, p.compass), lambda r: content_of(r.orientation),
        ),
        "pressure": Intake(
            "depth", p.depth, Kind.DEPTH, DEPTH_ROW,
            lambda r: depth_data(r, p.depth), lambda r: content_of(r.fluid_pressure),
        ),
        "altitude": Intake(
            "altimeter", p.altimeter, Kind.CLIMB, CLIMB_ROW,
            lambda r: altitude_data(r, p.altimeter), lambda r: content_of(r.range),
        ),
    }  # fmt: skip
