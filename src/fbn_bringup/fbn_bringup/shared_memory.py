"""What killed processes leave behind of Fast DDS's shared memory, removed."""

from __future__ import annotations

import fcntl
import os
import re
import time
from pathlib import Path

_SHARED_MEMORY = Path("/dev/shm")
_LOCK_FILE = re.compile(r"fastrtps_(?:[0-9a-f]{16}|port\d+)_(?:el|sl)")


def clean_shared_memory(directory: Path = _SHARED_MEMORY) -> int:
    """Remove what killed processes left of Fast DDS's shared memory; gives the number of segments removed.

    The living hold a lock on a file beside each of theirs.
    """
    removed = 0
    for lock_file in directory.glob("fastrtps_*_[es]l"):
        if _LOCK_FILE.fullmatch(lock_file.name) and not _is_held(lock_file):
            segment = lock_file.with_name(lock_file.name[:-3])
            for file in (lock_file, segment, lock_file.with_name(f"sem.{segment.name}_mutex")):
                file.unlink(missing_ok=True)
            removed += 1
    return removed


def _is_held(lock_file: Path) -> bool:
    """Whether a living process has it; so young that its maker may not have locked it yet counts as held."""
    try:
        with lock_file.open("ab") as file:
            if time.time() - os.fstat(file.fileno()).st_mtime < 2.0:
                return True
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    return False
