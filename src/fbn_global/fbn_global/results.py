"""What the filter tells: its verdict, and pose, map and target as the leading hypothesis has them."""

from __future__ import annotations

from fbn_common.geodesy import GeodeticPoint
from fbn_common.types import nanoseconds
from fbn_global import publish
from fbn_global.bank import Bank
from fbn_global.field import Field
from fbn_global.hypotheses import Hypothesis
from fbn_global.outbox import Outbox
from fbn_global.parameters import GlobalParameters
from fbn_global.reckoning import Reckoning
from fbn_global.target import Target, blend, locate, target_row
from fbn_global.verdict import Mode, Verdict, judge, modes


class Results:
    """The verdict so far, and the records made of it."""

    def __init__(self, parameters: GlobalParameters, out: Outbox) -> None:
        self.p = parameters
        self.verdict = Verdict()
        self.modes: tuple[Mode, ...] = ()
        self._out = out
        self._status_ns: int | None = None

    def leading(self, bank: Bank) -> Hypothesis:
        """Whose pose is published: the best of the declared match, else the null's."""
        if self.verdict.matched and self.modes:
            wanted = self.modes[0].best.id
            return next((h for h in bank.rivals if h.id == wanted), bank.null)
        return bank.null

    def judge(self, bank: Bank, field: Field | None, stamp_ns: int) -> None:
        """The verdict after a composite."""
        if field is None or not len(field.features):
            self.verdict = Verdict(reason="no prior map")
            return
        before = self.verdict.state
        self.modes = tuple(modes(bank, field, self.p.verdict.mode_radius))
        self.verdict = judge(self.verdict, list(self.modes), bank.null.score.posterior, stamp_ns, self.p.verdict)
        if self.verdict.state is not before:
            self._status_ns = None

    def publish_pose(self, bank: Bank, reckoning: Reckoning) -> None:
        """``global/pose``, now."""
        end = reckoning.now
        if end is not None:
            pose, covariance = reckoning.carried(self.leading(bank).state, end)
            self._out.publish("global/pose", publish.pose_message(end.stamp_ns, pose, covariance))

    def publish_map(self, bank: Bank, field: Field | None, datum: GeodeticPoint, stamp_ns: int) -> None:
        """``global/map``."""
        message = publish.map_message(stamp_ns, self.leading(bank), field, bank.memory, datum, self.p.scoring)
        self._out.publish("global/map", message)

    def keep_status(self, bank: Bank, target: Target | None, now_ns: int) -> None:
        """``global/status``."""
        self._status_ns = now_ns
        message = publish.status_message(now_ns, self.verdict, self.leading(bank), target)
        self._out.publish("global/status", message)

    def status_due(self, now_ns: int) -> bool:
        """Whether the status is to be told: once a period, and when the verdict has changed."""
        return self._status_ns is None or now_ns - self._status_ns >= nanoseconds(self.p.status_period_s)

    def target(self, bank: Bank, field: Field | None, reckoning: Reckoning) -> Target | None:
        """The target as the leading hypothesis has it, with the spread over the others."""
        end, row = reckoning.now, target_row(field) if field is not None else None
        if row is None or end is None or field is None:
            return None
        leading = self.leading(bank)
        accounts = [leading, *(h for h in bank.all if h is not leading and h.score.posterior > 0.01)]
        begin, tie = reckoning.tie(end)
        targets = [locate(h, field, row, begin, end, tie) for h in accounts]
        return blend(targets, [max(h.score.posterior, 1e-6) for h in accounts])
