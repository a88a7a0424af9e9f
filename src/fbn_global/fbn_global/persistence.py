"""The filter's state on disk: written whole or not at all, read back only if whole, of this map, and not too old.

Kept is what outlives a restart of all nodes: every hypothesis's pose, map features, pairs and evidence.  Found features
and origins hang on the tracker's keys and are gone with it.  ``map`` may have another origin after the restart, as a
first fix gave it: what is kept is carried over to that.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from fbn_common.geodesy import GeodeticPoint, enu_from_geodetic, geodetic_array_from_enu
from fbn_common.prior_map import PriorFeature
from fbn_global.hypotheses import Hypothesis, Score
from fbn_global.state import HEAD, LOCAL, XY, Block, Kind, State, restart

_MAGIC = b"FBN global state 2\n"


class StateFileError(ValueError):
    """A file of saved state that can't be used: which, and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """The bank at a time, a fingerprint of the map it is about, ``map``'s origin, and the area swept in all [m^2]."""

    stamp_ns: int
    fingerprint: str
    datum: GeodeticPoint
    area: float
    hypotheses: tuple[Hypothesis, ...]  # the null first


def fingerprint(features: Sequence[PriorFeature]) -> str:
    """What tells one map from another: ids and places of its features, whatever the datum."""
    told = [(f.id, f.latitude, f.longitude, f.up) for f in features]
    return hashlib.sha256(repr(told).encode()).hexdigest()


def save(path: Path, saved: Saved) -> None:
    """Write the state; the file is the old one or the new one, whole."""
    arrays: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]] = {
        "stamp_ns": np.array(saved.stamp_ns, dtype=np.int64),
        "fingerprint": np.array(saved.fingerprint),
        "datum": np.array([saved.datum.latitude, saved.datum.longitude, saved.datum.height]),
        "area": np.array(saved.area),
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
            datum = GeodeticPoint(*(float(v) for v in arrays["datum"]))
            area = float(arrays["area"])
            saved = Saved(int(arrays["stamp_ns"]), str(arrays["fingerprint"]), datum, area, hypotheses)
    except (KeyError, ValueError, TypeError, IndexError, BadZipFile) as error:  # whole, but written by another program
        raise StateFileError(f"{path.name}: does not hold what it should: {error}") from error
    if not hypotheses or not saved.area >= 0.0 or not all(_sound(h.state) for h in hypotheses):
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


def aged(h: Hypothesis, begun: State, age_s: float, speed: float) -> Hypothesis:
    """A saved hypothesis after a time in which the vehicle may have gone anywhere at this speed [m/s].

    Depth, attitude and drift are those of the state that has begun; xy keep what they were, with ``(speed age)^2``
    more variance.
    """
    state = restart(h.state, LOCAL, begun.mean[LOCAL], begun.covariance[LOCAL, LOCAL])
    covariance = state.covariance.copy()
    covariance[XY, XY] += (speed * age_s) ** 2 * np.eye(2)
    return replace(h, state=replace(state, covariance=covariance))


def carried_over(h: Hypothesis, old: GeodeticPoint, new: GeodeticPoint) -> Hypothesis:
    """A hypothesis about another origin of ``map``; that its axes turn too, by 1e-4 a kilometre or so, is left out."""
    if old == new:
        return h
    firsts = np.array([XY.start, *h.state.starts.values()])
    mean = h.state.mean.copy()
    places = np.column_stack([mean[firsts], mean[firsts + 1], np.zeros(len(firsts))])
    for first, (latitude, longitude, height) in zip(firsts, geodetic_array_from_enu(places, old), strict=True):
        mean[first : first + 2] = enu_from_geodetic(latitude, longitude, height, new)[:2]
    return replace(h, state=replace(h.state, mean=mean))
