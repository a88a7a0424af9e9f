"""The state over a restart: taken up with its age where it fits, refused by name where it does not."""

from __future__ import annotations

from pathlib import Path

from fbn_common.records import Verdict as Answer
from fbn_common.types import Array, seconds
from fbn_global.bank import Bank
from fbn_global.field import Field
from fbn_global.odometry import Reckoned
from fbn_global.outbox import Outbox
from fbn_global.parameters import GlobalParameters
from fbn_global.persistence import Saved, StateFileError, aged, fingerprint, load, save


class StateFile:
    """The file named by the parameters, if any; all that happens to it is answered in the outbox."""

    def __init__(self, parameters: GlobalParameters, out: Outbox) -> None:
        self.p = parameters
        self._path = Path(parameters.state_file) if parameters.state_file else None
        self._out = out

    def restore(self, bank: Bank, field: Field | None, reckoned: Reckoned, covariance: Array) -> float | None:
        """Put the saved hypotheses into a bank that begins; gives their age [s], or None with the bank as it was."""
        if self._path is None or not self._path.exists():
            return None
        try:
            saved = load(self._path)
            if field is None or saved.fingerprint != fingerprint(field):
                raise StateFileError(f"{self._path.name}: is about another map, or the datum is not known yet")
            age_s = seconds(reckoned.stamp_ns - saved.stamp_ns)
            if not 0.0 <= age_s <= self.p.state_age_s:
                raise StateFileError(f"{self._path.name}: is {age_s:.0f} s old")
        except StateFileError as error:
            self._out.answer(reckoned.stamp_ns, "state_file", Answer.REFUSED, str(error))
            return None
        speed = self.p.state_speed
        bank.restore(tuple(aged(h, reckoned.pose, covariance, age_s, speed) for h in saved.hypotheses))
        self._out.answer(reckoned.stamp_ns, "state_file", Answer.USED, f"{age_s:.0f} s old")
        return age_s

    def save(self, bank: Bank, field: Field | None, stamp_ns: int) -> None:
        """Keep the bank as it is at a stamp."""
        if self._path is None or field is None:
            return
        try:
            save(self._path, Saved(stamp_ns, fingerprint(field), bank.saved()))
        except OSError as error:
            self._out.answer(stamp_ns, "state_file", Answer.REFUSED, f"can't be written: {error}")
