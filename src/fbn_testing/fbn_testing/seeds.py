"""The seeds of a study: in several processes, and each result on disk as soon as it is there."""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import pickle
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from fbn_bringup.campaign_journal import code
from fbn_bringup.ui import progress

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class How:
    """In how many processes seeds run, and the directory in which their results are kept, if any."""

    jobs: int = 1
    keep: Path | None = None


def seed_range(text: str) -> range:
    """``a:b`` as Python's range, or one seed."""
    first, colon, last = text.partition(":")
    return range(int(first), int(last)) if colon else range(int(first), int(first) + 1)


def add_options(parser: argparse.ArgumentParser) -> None:
    """``--jobs`` and ``--keep`` on a study's command line."""
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    about = "keep each seed's result there; what the same code and settings have left there is not run again"
    parser.add_argument("--keep", type=Path, metavar="DIR", help=about)


def run_seeds(one: Callable[[int], Result], seeds: Iterable[int], title: str, how: How) -> list[Result]:
    """``one`` of every seed, in the order of the seeds.

    ``one`` is a module's function, or a ``partial`` of one.  Results are kept under its name, its arguments, all
    sources and the seed: what was run in parts, or on several machines, adds up in one directory.  Where a seed fails
    the others are run, and kept, before its exception is raised.
    """
    seeds = list(seeds)
    files = [_file(how.keep, one, seed) for seed in seeds]
    with progress(title) as advance, _pool(how.jobs) as pool:
        runs = [pool.submit(_kept, one, seed, file) for seed, file in zip(seeds, files, strict=True)]
        for done, _ in enumerate(as_completed(runs), 1):
            advance(done / len(seeds), f"{done} of {len(seeds)} seeds")
        return [run.result() for run in runs]


def _pool(jobs: int) -> ProcessPoolExecutor:
    """New processes: a fork would share the threads of numba and of BLAS."""
    return ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"))


def _kept(one: Callable[[int], Result], seed: int, file: Path | None) -> Result:
    """A seed's result, from its file if that is there; the file is whole or not there at all."""
    if file is None:
        return one(seed)
    if not file.exists():
        part = file.with_suffix(f".{os.getpid()}")
        part.write_bytes(pickle.dumps(one(seed)))
        part.replace(file)
    result: Result = pickle.loads(file.read_bytes())
    return result


def _file(directory: Path | None, one: Callable[[int], object], seed: int) -> Path | None:
    """Where a seed's result is kept."""
    if directory is None:
        return None
    directory.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256((_named(one) + code()).encode()).hexdigest()[:16]
    return directory / f"{digest}_{seed}.pickle"


def _named(value: object) -> str:
    """A value by its text, a function by its name, in every process the same."""
    if isinstance(value, partial):
        return _named((value.func, *value.args, *sorted(value.keywords.items())))
    if isinstance(value, tuple):
        return f"({', '.join(map(_named, value))})"
    return str(getattr(value, "__qualname__", None) or repr(value))
