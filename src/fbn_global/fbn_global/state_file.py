"""The state over a restart: taken up with its age where it fits, refused by name where it does not.

It waits for dead reckoning and for ``map``'s origin, whichever comes last.
"""

from __future__ import annotations

from pathlib import Path

from fbn_common.records import Verdict as Answer
from fbn_common.types import seconds
from fbn_global.bank import Bank
from fbn_global.field import Field
from fbn_global.outbox import Outbox
from fbn_global.parameters import GlobalParameters
from fbn_global.persistence import Saved, StateFileError, aged, carried_over, fingerprint, load, save


class StateFile:
    """The file named by the parameters, if any; all that happens to it is answered in the outbox."""

    def __init__(self, parameters: GlobalParameters, out: Outbox) -> None:
        self.p = parameters
        self._path = Path(parameters.state_file) if parameters.state_file else None
        self._out = out
        self.awaited = self._path is not None and self._path.exists()

    def restore(self, bank: Bank, field: Field, stamp_ns: int) -> float | None:
        """Put the saved hypotheses into a bank whose pose is at a stamp; gives their age [s], or None: all as it was.

        It is tried once; then no state is awaited any more.
        """
        self.awaited = False
        try:
            saved, age_s = self._fitting(field, stamp_ns)
        except StateFileError as error:
            self._out.answer(stamp_ns, "state_file", Answer.REFUSED, str(error))
            return None
        begun, speed = bank.null.state, self.p.state_speed
        here = (carried_over(h, saved.datum, field.datum) for h in saved.hypotheses)
        bank.restore(tuple(aged(h, begun, age_s, speed) for h in here), saved.area)
        self._out.answer(stamp_ns, "state_file", Answer.USED, f"{age_s:.0f} s old")
        return age_s

    def _fitting(self, field: Field, stamp_ns: int) -> tuple[Saved, float]:
        """The saved state, of this map and not too old, and its age [s]; StateFileError says why not."""
        assert self._path is not None
        saved = load(self._path)
        age_s = seconds(stamp_ns - saved.stamp_ns)
        if saved.fingerprint != fingerprint(field.features):
            raise StateFileError(f"{self._path.name}: is about another map")
        if not 0.0 <= age_s <= self.p.state_age_s:
            raise StateFileError(f"{self._path.name}: is {age_s:.0f} s old")
        return saved, age_s

    def save(self, bank: Bank, field: Field | None, stamp_ns: int) -> None:
        """Keep the bank as it is at a stamp."""
        if self._path is None or field is None:
            return
        state = Saved(stamp_ns, fingerprint(field.features), field.datum, bank.memory.area, bank.saved())
        try:
            save(self._path, state)
        except OSError as error:
            self._out.answer(stamp_ns, "state_file", Answer.REFUSED, f"can't be written: {error}")
