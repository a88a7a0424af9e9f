"""The filter's state on disk: written whole or not at all, read back only if whole, of this map, and not too old.

Kept is what outlives a restart of all nodes: every hypothesis's pose, map features, pairs and evidence.  Found features
and origins hang on the tracker's keys and are gone with it.
"""

from __future__ import annotations

import hashlib
import io
import os
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from fbn_common.types import Array
from fbn_global.field import Field
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.state import HEAD, XY, Block, Kind, State, restart

_MAGIC = b"FBN global state 1\n"


class StateFileError(ValueError):
    """A file of saved state that can't be used: which, and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """The bank at a time, and a fingerprint of the map it is about."""

    stamp_ns: int
    fingerprint: str
    hypotheses: tuple[Hypothesis, ...]  # the null first


def fingerprint(field: Field) -> str:
    """What tells one map about one datum from another."""
    ids = np.array([f.id for f in field.features], dtype=np.int64)
    return hashlib.sha256(ids.tobytes() + field.position.tobytes()).hexdigest()


def save(path: Path, saved: Saved) -> None:
    """Write the state; the file is the old one or the new one, whole."""
    arrays: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]] = {
        "stamp_ns": np.array(saved.stamp_ns, dtype=np.int64),
        "fingerprint": np.array(saved.fingerprint),
        "count": np.array(len(saved.hypotheses), dtype=np.int64),
    }
    for n, h in enumerate(saved.hypotheses):
        rows = h.state.ids(Kind.MAP)
        at = np.concatenate([np.arange(HEAD), h.state.columns(*(Block(Kind.MAP, r) for r in rows))])
        arrays[f"mean_{n}"], arrays[f"covariance_{n}"] = h.state.mean[at], h.state.covariance[np.ix_(at, at)]
        arrays[f"rows_{n}"] = np.array(rows, dtype=np.int64)
        arrays[f"matched_{n}"] = np.array([row for _, row in h.pairs], dtype=np.int64)
        arrays[f"numbers_{n}"] = np.array([h.id, h.parent, h.surplus()], dtype=np.int64)
        arrays[f"scores_{n}"] = np.array([h.evidence, h.score.positive, h.score.negative, h.score.prior])
    body = io.BytesIO()
    np.savez(body, **arrays)  # type: ignore[arg-type]
    content = body.getvalue()
    temporary = path.with_suffix(path.suffix + ".part")
    with temporary.open("wb") as file:
        file.write(_MAGIC + hashlib.sha256(content).digest() + content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
    _flush(path.parent)


def load(path: Path) -> Saved:
    """The state in a file; StateFileError names the file and what is wrong with it."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StateFileError(f"{path.name}: can't be read: {error}") from error
    head = len(_MAGIC)
    if not data.startswith(_MAGIC):
        raise StateFileError(f"{path.name}: is no saved state of this version")
    if hashlib.sha256(data[head + 32 :]).digest() != data[head : head + 32]:
        raise StateFileError(f"{path.name}: is damaged")
    try:
        with np.load(io.BytesIO(data[head + 32 :]), allow_pickle=False) as arrays:
            hypotheses = tuple(_hypothesis(arrays, n) for n in range(int(arrays["count"])))
            saved = Saved(int(arrays["stamp_ns"]), str(arrays["fingerprint"]), hypotheses)
    except (KeyError, ValueError, IndexError, BadZipFile) as error:  # whole, but written by another program
        raise StateFileError(f"{path.name}: does not hold what it should: {error}") from error
    if not hypotheses or not all(_sound(h.state) for h in hypotheses):
        raise StateFileError(f"{path.name}: holds a state that is not finite and positive definite")
    return saved


def _sound(state: State) -> bool:
    """Whether a state is one: sizes that fit, finite, positive definite."""
    size = HEAD + 3 * len(state.starts)
    if state.mean.shape != (size,) or state.covariance.shape != (size, size):
        return False
    if not (np.isfinite(state.mean).all() and np.isfinite(state.covariance).all()):
        return False
    return bool(np.linalg.eigvalsh(state.covariance)[0] > 0.0)


def _flush(directory: Path) -> None:
    """The renaming itself on disk, where the system can do that."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _hypothesis(arrays: np.lib.npyio.NpzFile, n: int) -> Hypothesis:
    starts = {Block(Kind.MAP, int(row)): HEAD + 3 * k for k, row in enumerate(arrays[f"rows_{n}"])}
    pairs = tuple((-1 - k, int(row)) for k, row in enumerate(arrays[f"matched_{n}"]))
    identity, parent, surplus = (int(v) for v in arrays[f"numbers_{n}"])
    evidence, positive, negative, prior = (float(v) for v in arrays[f"scores_{n}"])
    state = State(arrays[f"mean_{n}"], arrays[f"covariance_{n}"], starts)
    score = Score(positive, negative, prior)
    return Hypothesis(identity, parent, state, evidence, pairs, dropped=surplus, score=score)


def aged(h: Hypothesis, pose: Array, pose_covariance: Array, age_s: float, speed: float) -> Hypothesis:
    """A saved hypothesis after a time in which the vehicle may have gone anywhere at this speed [m/s].

    Depth, attitude and drift are known anew; xy keep what they were, with ``(speed age)^2`` more variance.
    """
    local = slice(2, HEAD)
    mean = np.concatenate([pose[2:], np.zeros(3)])
    spread = np.zeros((7, 7))
    spread[:4, :4] = np.diag(np.maximum(np.diag(pose_covariance)[2:], 1e-8))
    spread[4:, 4:] = h.state.covariance[6:HEAD, 6:HEAD]
    state = restart(h.state, local, mean, spread)
    covariance = state.covariance.copy()
    covariance[XY, XY] += (speed * age_s) ** 2 * np.eye(2)
    return replace(h, state=replace(state, covariance=covariance))
