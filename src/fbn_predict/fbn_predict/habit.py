"""Whether commands that do not change may be believed: a constant command is legitimate, a habit that breaks is not.

A value that stays cannot tell by itself whether it is meant.  What can be said: a stream that used to change with
nearly every message, as a control loop's does, and now repeats itself bit by bit for far longer than it ever did,
under way, has probably stopped being fed.
"""

from __future__ import annotations

from fbn_common.types import Array

_CHANGES = 100  # messages that changed something, before there is a habit: 10 s at 10 Hz
_LONGER = 3  # times as long as the stream ever stayed the same before


class Habit:
    """How long commands used to stay the same, in messages, and how long they have now."""

    def __init__(self, frozen_after: int) -> None:
        self.frozen_after = frozen_after  # equal commands in a row that are never suspicious; 0 = nothing is
        self.repeats = 0
        self._changes = self._longest = 0
        self._newest_ns = -1
        self._last = b""

    def hear(self, stamp_ns: int, values: Array) -> str:
        """Take note of a command, propeller first; what is wrong with it, empty if nothing.

        Commands out of order are not judged.  At rest, with the propeller still, constant is what they should be.
        """
        if stamp_ns <= self._newest_ns:
            return ""
        self._newest_ns = stamp_ns
        said = values.tobytes()
        changed, self._last = said != self._last, said
        if changed:
            self._longest, self._changes = max(self._longest, self.repeats), self._changes + 1
        self.repeats = 0 if changed or values[0] == 0.0 else self.repeats + 1
        if not self.frozen:
            return ""
        return f"frozen: {self.repeats + 1} equal commands in a row, never more than {self._longest + 1} before"

    @property
    def frozen(self) -> bool:
        """Whether the commands stay the same for longer than they used to."""
        bound = max(self.frozen_after, _LONGER * self._longest)
        return self.frozen_after > 0 and self._changes >= _CHANGES and self.repeats >= bound
