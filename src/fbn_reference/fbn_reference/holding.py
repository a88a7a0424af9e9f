"""Ranges that wait until enough beacons are heard to tell who lies.

While the position is uncertain the gate lets any lie pass, and the beacon that is heard first would judge the others.
So ranges wait for ``lbl.hold``, and the beacons that agree are believed; see docs/equations/reference.md, "Beacons
that lie".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import groupby

import numpy as np

from fbn_common.motion_ekf.core import MotionEkf, State
from fbn_common.motion_ekf.intake import Intake
from fbn_common.motion_ekf.layout import LAST_USED, X_ROTATION
from fbn_common.records import BeaconRange
from fbn_common.types import Array, Vec3, nanoseconds
from fbn_reference.consensus import Heard, consensus, outlying
from fbn_reference.parameters import LblParameters

_REPLIES = 3  # of each beacon close a window early: their median stands against one outlier


class Refusal(StrEnum):
    """Why a range that waited was refused."""

    OUTVOTED = "this beacon contradicts those that agree with one another"
    UNDECIDED = "beacons contradict one another, and nothing tells which of them lie"
    MIRRORED = "two places explain the beacons' ranges about as well"
    OUTLIER = "outside the gate about where the beacons agree"
    TOO_OLD = "not in the filter's history when it was decided on"


@dataclass(slots=True, eq=False)
class Waiting:
    """A range that has not been decided on."""

    intake: Intake
    record: BeaconRange
    data: Array  # (8,) as in the timeline
    doubtful: bool = False  # found to be at a stamp at which the position is uncertain

    @property
    def stamp_ns(self) -> int:
        """Of the middle of its travel."""
        return self.record.stamp_ns


@dataclass(slots=True)
class Ruling:
    """What became of ranges that waited."""

    admitted: list[Waiting] = field(default_factory=list)
    refused: list[tuple[Waiting, Refusal]] = field(default_factory=list)


class Holding:
    """The ranges that wait, and the rulings on them: functions of stamps, not of the order of arrival."""

    def __init__(self, parameters: LblParameters) -> None:
        self.parameters = parameters
        self.waiting: list[Waiting] = []
        self.note = ""  # of the last window: what could not be decided
        self._noted_ns = -1
        self._hold_ns = nanoseconds(parameters.hold)
        self._lever = np.array(parameters.position)

    def put(self, waiting: Waiting) -> None:
        """Keep a range."""
        self.waiting.append(waiting)
        self.waiting.sort(key=lambda w: (w.stamp_ns, w.intake.row))

    def withdraw(self, intake: Intake, value: float, since_ns: int) -> list[Waiting]:
        """Give back a beacon's ranges of this value from after the stamp."""
        mine = [w for w in self.waiting if w.intake is intake and w.data[3] == value and w.stamp_ns > since_ns]
        self.waiting = [w for w in self.waiting if w not in mine]
        return mine

    def trusted(self, ekf: MotionEkf, intake: Intake, stamp_ns: int) -> bool:
        """Whether a range of this beacon was used lately: then it need not wait, the gate watches it."""
        if not self._hold_ns:
            return True
        return ekf.head_ns >= 0 and bool(
            stamp_ns * 1e-9 - ekf.state.sensors[intake.row, LAST_USED] < self.parameters.belief
        )

    def settled_ns(self, stamp_ns: int) -> int:
        """The stamp, or where ranges wait, just before the first of them: later than that nothing is settled."""
        return min([stamp_ns, *(w.stamp_ns - 1 for w in self.waiting[:1])])

    def complaint(self, now_ns: int) -> str:
        """What could not be decided of late; empty if nothing."""
        return self.note if 0 <= now_ns - self._noted_ns <= 2 * self._hold_ns else ""

    def rule(self, ekf: MotionEkf) -> Ruling:
        """What can be decided now: ranges the gate can judge, and else the oldest window if it is over."""
        ruling = Ruling()
        oldest = max(ekf.base.stamp_ns + 1, ekf.head_ns - ekf.history_ns)
        for w in self.waiting:
            if w.stamp_ns < oldest:
                ruling.refused.append((w, Refusal.TOO_OLD))
            elif w.stamp_ns <= ekf.head_ns and self._for_the_gate(ekf, w):
                ruling.admitted.append(w)
        if not ruling.admitted and not ruling.refused:
            self._close(ekf, ruling)
        done = {*ruling.admitted, *(w for w, _ in ruling.refused)}
        self.waiting = [w for w in self.waiting if w not in done]
        return ruling

    def _for_the_gate(self, ekf: MotionEkf, w: Waiting) -> bool:
        """Whether the beacon is trusted by now, or the position so certain that the gate tells a lie."""
        if self.trusted(ekf, w.intake, w.stamp_ns):
            return True
        if not w.doubtful:
            state = ekf.state_at(w.stamp_ns)
            arm = _place(state, self._lever) - w.data[:3]
            arm /= max(float(np.linalg.norm(arm)), 1e-3)
            predicted = float(arm @ state.covariance[:3, :3] @ arm)
            w.doubtful = predicted > self.parameters.uncertain**2 * float(w.data[4])
        return not w.doubtful

    # --- a window --------------------------------------------------------------------------------------

    def _window_end(self) -> int:
        """When all beacons have answered often enough, at the latest ``hold`` after the first range [ns]."""
        if not self.waiting:
            return -1
        end, missing = self.waiting[0].stamp_ns + self._hold_ns, dict.fromkeys(self.parameters.beacons, _REPLIES)
        for w in self.waiting:
            missing[w.record.beacon_id] -= 1
            if max(missing.values()) <= 0:
                return min(end, w.stamp_ns)
        return end

    def _close(self, ekf: MotionEkf, ruling: Ruling) -> None:
        """Decide on the ranges of the oldest window, if the filter has passed its end."""
        end = self._window_end()
        if not self.waiting or end > ekf.head_ns:
            return
        window = [w for w in self.waiting if w.stamp_ns <= end]
        mine = sorted(window, key=lambda w: w.intake.row)
        groups = [list(g) for _, g in groupby(mine, key=lambda w: w.intake.row)]
        state = ekf.state_at(end)
        p, gate = np.ascontiguousarray(state.covariance[:2, :2]), self.parameters.gate
        heard = _heard(ekf, window, groups, state, self._lever)
        found = consensus(p, heard, gate, self.parameters.margin)
        self.note, self._noted_ns = "", end
        if found is None:
            self.note = "lbl: no beacon agrees with the position, the gate decides"
            ruling.admitted += window
            return
        contested = Refusal.MIRRORED if found.mirrored else Refusal.UNDECIDED
        if found.undecided:
            self.note = f"lbl: {', '.join(found.undecided)} not believed: {contested.value}"
        for group, one in zip(groups, heard, strict=True):
            if one.name in found.believed:
                for w, place, excess in zip(group, one.places, outlying(one, found.fit, gate), strict=True):
                    if excess <= 1.0:
                        w.data[5:] = 1.0, *(place[:2] + found.fit.offset)
                        ruling.admitted.append(w)
                    else:
                        ruling.refused.append((w, Refusal.OUTLIER))
            else:
                why = contested if one.name in found.undecided else Refusal.OUTVOTED
                ruling.refused += [(w, why) for w in group]


def _place(state: State, lever: Vec3) -> Vec3:
    """Of the transducer [m]."""
    rotation = state.x[X_ROTATION : X_ROTATION + 9].reshape(3, 3)
    return np.asarray(state.x[:3] + rotation @ lever)


def _heard(
    ekf: MotionEkf, window: Sequence[Waiting], groups: Sequence[Sequence[Waiting]], end: State, lever: Vec3
) -> list[Heard]:
    """The window's ranges by beacon, all brought to one error of the position: the one at its middle range.

    Between the ranges the motions alone carry the position; what they may be off by from the middle goes to the
    range's variance, its correlation from range to range left out.
    """
    states, state = {}, ekf.state_at(window[0].stamp_ns)
    for w in window:
        state = ekf.open_loop(state, w.stamp_ns)
        states[w.stamp_ns] = state
    last = ekf.open_loop(state, end.stamp_ns)
    middle = states[window[len(window) // 2].stamp_ns].covariance
    shift = _place(end, lever) - _place(last, lever)
    shift[2] = 0.0  # depth is measured all the way

    def one(group: Sequence[Waiting]) -> Heard:
        mine = [states[w.stamp_ns] for w in group]
        growth = [np.abs(np.linalg.eigvalsh((middle - s.covariance)[:2, :2])).max() for s in mine]
        data = np.array([w.data for w in group])
        places = np.array([_place(s, lever) + shift for s in mine])
        return Heard(group[0].record.beacon_id, data[0, :3], places, data[:, 3], data[:, 4] + growth)

    return [one(group) for group in groups]
