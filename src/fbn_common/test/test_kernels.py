"""Compiled code is never older than the sources it was made of."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import fbn_common
from fbn_common.kernels import KEEP_S

OUTER = """
from fbn_common.kernels import kernel
from fbn_toy.inner import twice

@kernel
def four_times(x):
    return twice(twice(x))
"""
INNER = """
from fbn_common.kernels import kernel

@kernel
def twice(x):
    return FACTOR * x
"""


def result(directory: Path) -> float:
    """``four_times(1.0)`` in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(directory), "NUMBA_CACHE_DIR": str(directory / "cache")}
    command = [sys.executable, "-c", "from fbn_toy.outer import four_times; print(four_times(1.0))"]
    return float(subprocess.check_output(command, env=environment, cwd=directory))


def test_a_kernel_is_compiled_anew_when_a_kernel_of_another_file_changes_and_old_code_is_forgotten(
    tmp_path: Path,
) -> None:
    for name in ("__init__.py", "kernels.py"):  # all that the toy needs
        target = tmp_path / "fbn_common" / name
        target.parent.mkdir(exist_ok=True)
        shutil.copy(Path(fbn_common.__file__).parent / name, target)
    toy = tmp_path / "fbn_toy"
    toy.mkdir()
    (toy / "__init__.py").touch()
    (toy / "outer.py").write_text(OUTER)
    (toy / "inner.py").write_text(INNER.replace("FACTOR", "2.0"))
    assert result(tmp_path) == 4.0
    assert result(tmp_path) == 4.0
    (first,) = (tmp_path / "cache").iterdir()  # the second run found the first one's code
    assert list(first.rglob("*.nbc"))

    (toy / "inner.py").write_text(INNER.replace("FACTOR", "3.0"))
    assert result(tmp_path) == 9.0
    assert len(list((tmp_path / "cache").iterdir())) == 2

    long_ago = time.time() - KEEP_S - 60
    os.utime(first, (long_ago, long_ago))
    assert result(tmp_path) == 9.0
    assert not first.exists()
