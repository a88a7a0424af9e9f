"""Every measurement's answer: a refusal at once, or what became of it as soon as the filter has processed it."""

from __future__ import annotations

from fbn_common.estimator import Output
from fbn_common.motion_ekf.core import MotionEkf
from fbn_common.motion_ekf.intake import Intake
from fbn_common.motion_ekf.monitor import refusal
from fbn_common.records import Verdict


class Answers:
    """The answers that a filter gives, and those that it still owes: one for each measurement in its timeline."""

    def __init__(self, node: str, frame_id: str) -> None:
        self.topic, self.frame_id = f"{node}/innovations", frame_id
        self._owed: dict[int, Intake] = {}

    def owe(self, slot: int, intake: Intake) -> None:
        """A measurement of this intake is in this slot of the timeline."""
        self._owed[slot] = intake

    def release(self, slot: int) -> Intake | None:
        """Whose measurement is in the slot, if it has not been answered; it will not be."""
        return self._owed.pop(slot, None)

    def clear(self) -> None:
        """Owe nothing: the timeline is a new one."""
        self._owed.clear()

    def say(self, stamp_ns: int, sensor: str, verdict: Verdict, reason: str) -> Output:
        """The answer to what no intake's counters are for."""
        return Output(self.topic, refusal(stamp_ns, self.frame_id, sensor, verdict, reason))

    def refuse(self, intake: Intake, stamp_ns: int, verdict: Verdict, reason: str) -> Output:
        """The answer to a measurement that is not used; counts it."""
        intake.watch.verdicts[verdict.name] += 1
        return self.say(stamp_ns, intake.sensor, verdict, reason)

    def processed(self, ekf: MotionEkf) -> list[Output]:
        """One innovation for each measurement that was processed for the first time, in the order of stamps."""
        events, head = ekf.events.rows, ekf.head_ns
        stamp = events.stamp.item
        done = sorted((stamp(slot), slot) for slot in self._owed if stamp(slot) <= head)
        return [Output(self.topic, self._owed.pop(s).answer(events, s, self.frame_id)) for _, s in done]

    def skipped(self, ekf: MotionEkf, until_ns: int, reason: str) -> list[Output]:
        """Refusals of what is stamped up to here: a filter that started later will not process it."""
        events, out = ekf.events, []
        for slot in events.slots[: events.after(until_ns)]:
            intake = self.release(slot)
            if intake is not None:
                events.rows.verdict[slot] = Verdict.REFUSED  # nobody is to take it for a used one
                out.append(self.refuse(intake, int(events.rows.stamp[slot]), Verdict.REFUSED, reason))
        return out
