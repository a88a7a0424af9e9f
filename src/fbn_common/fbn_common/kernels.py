"""One decorator for all compiled kernels, and where their compiled code is kept.

Numba's own cache notices a change of a kernel's file, but not of the kernels and constants of other files that were
compiled into it. So a package's cache directory is named by a digest of all sources its kernels can come from.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import config

F = TypeVar("F", bound=Callable[..., object])
KEEP_S = 14 * 86400  # how long the code of sources that are no longer used is kept


def kernel(function: F) -> F:
    """``function`` compiled by numba in nopython mode, kept on disk until a source that it can come from changes."""
    return _compiled(function)


def inner_kernel(function: F) -> F:
    """As :func:`kernel`, for a function that makes no arrays: it borrows those it is given and counts no references.

    Counting them costs more than the work of a function that is called many times a step.  One that does make an
    array, if only to copy a slice to a slice, does not compile.
    """
    return _compiled(function, _nrt=False)  # without numba's runtime of counted references


def _compiled(function: F, **options: Any) -> F:
    config.CACHE_DIR = str(cache_directory(function.__module__.partition(".")[0]))  # type: ignore[attr-defined]
    return cast(F, njit(cache=True, **options)(function))


@cache
def cache_directory(package: str) -> Path:
    """A directory for just these sources of ``package``, in ``NUMBA_CACHE_DIR`` or else ``~/.cache``; it is made."""
    digest = hashlib.sha256(package.encode())
    for path in sources(package):
        digest.update(path.name.encode() + path.read_bytes())
    room = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    directory = Path(room, f"fbn-kernels-{digest.hexdigest()[:16]}")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        directory.touch()
        forget_unused(directory.parent)
    except OSError:
        pass  # nowhere to write: numba looks for another place, or compiles anew each time
    return directory


def sources(package: str) -> Iterator[Path]:
    """The files with kernels, and with the constants in them (``layout.py``), of ``package`` and of ``fbn_common``."""
    for name in sorted({package, "fbn_common"}):
        spec = find_spec(name)
        for directory in (spec and spec.submodule_search_locations) or ():
            for path in sorted(Path(directory).rglob("*.py")):
                if path.name == "layout.py" or b"kernel\n" in path.read_bytes():
                    yield path


def forget_unused(room: Path) -> None:
    """Remove the compiled code of sources that nobody has used for ``KEEP_S``."""
    for directory in room.glob("fbn-kernels-*"):
        if directory.stat().st_mtime < time.time() - KEEP_S:
            shutil.rmtree(directory, ignore_errors=True)
