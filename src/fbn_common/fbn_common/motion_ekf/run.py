"""The filter's loop over motions and measurements, compiled: from a state to the next one asked for."""

from __future__ import annotations

from math import sqrt

import numpy as np

from fbn_common.kernels import inner_kernel, kernel
from fbn_common.motion_ekf.layout import (
    ALTITUDE,
    ALTITUDE_TIME,
    DROPPED_UNTIL,
    GATED_RUN,
    GPS_ROW,
    GRID_NS,
    LAST,
    LAST_USED,
    Config,
    Events,
    Kind,
    Motions,
    Reason,
    Snapshots,
)
from fbn_common.motion_ekf.measure import COLUMNS, cholesky, correct, innovation_covariance, model, project, whiten
from fbn_common.motion_ekf.propagate import carry, new_scratch
from fbn_common.records import Verdict
from fbn_common.types import Array

_USED, _GATED, _REFUSED = int(Verdict.USED), int(Verdict.GATED), int(Verdict.REFUSED)
_NONE, _GATE, _RULE = int(Reason.NONE), int(Reason.GATE), int(Reason.RULE)
_UNDER_WATER, _DROPPED, _RESET = int(Reason.UNDER_WATER), int(Reason.DROPPED), int(Reason.RESET)
_SINGULAR, _BASE, _TILTED = int(Reason.SINGULAR), int(Reason.BASE), int(Reason.TILTED)
_RUN = 3.0  # outliers in a row that agree with each other are not chance
_STALE_BASE = 3.0  # baselines after which an altitude is no base any more
_POSITION, _RANGE, _PARAMETERS = int(Kind.POSITION), int(Kind.RANGE), int(Kind.PARAMETERS)
_COMPASS, _CLIMB = int(Kind.COMPASS), int(Kind.CLIMB)

DONE, NO_MOTION, OUTSIDE = 0, 1, 2  # why `run` came back


@kernel
def largest_eigenvalue(xx: float, xy: float, yy: float) -> float:
    """Of a symmetric 2x2 matrix."""
    return 0.5 * (xx + yy) + sqrt(0.25 * (xx - yy) ** 2 + xy * xy)


@kernel
def _refusal(kind: int, data: Array, x: Array, p: Array, row: Array, time_s: float, config: Config) -> int:
    """A reason not to look at the measurement at all."""
    if kind == _POSITION:
        if -x[2] > config.fix_depth:
            return _UNDER_WATER
        if config.rule and largest_eigenvalue(p[0, 0], p[0, 1], p[1, 1]) <= largest_eigenvalue(
            data[2], data[3], data[4]
        ):
            return _RULE
    if row[DROPPED_UNTIL] > time_s:
        return _DROPPED
    return _NONE


@kernel
def _consistent(row: Array, nu: Array, noise: Array, m: int, gate: float) -> bool:
    """Whether an outlier agrees with the one before it to within the sensor's own noise."""
    total = 0.0
    for i in range(m):
        total += (nu[i] - row[LAST + i]) ** 2 / (2.0 * noise[i, i])
    return total < gate


@kernel
def _grown_into(row: Array, nu: Array, noise: Array, m: int, gate: float) -> bool:
    """Whether a fix within the gate is one more of the consistent outliers before it, to which the gate has grown.

    One of the two lots is off by a jump; it says nothing of the velocity, by whose doubt the gate grew.
    """
    return row[GATED_RUN] >= _RUN and _consistent(row, nu, noise, m, gate)


@kernel
def _others_agree(sensors: Array, s: int, time_s: float, window_s: float) -> bool:
    """Whether another source of position was used within the window."""
    for i in range(GPS_ROW, sensors.shape[0]):  # noqa: SIM110  numba
        if i != s and time_s - sensors[i, LAST_USED] < window_s:
            return True
    return False


@kernel
def _open(p: Array, kind: int, nu: Array, m: int) -> None:
    """Make the states behind a locked-out sensor as uncertain as its innovation is large."""
    size = 0.0
    for i in range(m):
        size += nu[i] * nu[i]
    first, count = 3, 3
    if kind == _POSITION or kind == _RANGE:  # noqa: SIM109  numba
        first, count = 0, 2
    elif kind == _CLIMB:
        first, count = 6, 3
    elif kind != _COMPASS:
        first, count = 2, 1
    for i in range(first, first + count):
        p[i, i] += size


@kernel
def _lockout(kind: int, sensors: Array, s: int, nu: Array, noise: Array, m: int, time_s: float, config: Config) -> int:
    """Count a gated measurement; says what follows: GATE, RESET or DROPPED."""
    row = sensors[s]
    gate = config.gate[m, kind]
    if row[GATED_RUN] == 0.0 or _consistent(row, nu, noise, m, gate):
        row[GATED_RUN] += 1.0
    else:
        row[GATED_RUN] = 1.0
    for i in range(m):
        row[LAST + i] = nu[i]
    if row[GATED_RUN] < config.lockout[kind]:
        return _GATE
    row[GATED_RUN] = 0.0
    if kind == _RANGE and _others_agree(sensors, s, time_s, config.drop_s):
        row[DROPPED_UNTIL] = time_s + config.drop_s
        return _DROPPED
    return _RESET


@kernel
def _awaits_base(data: Array, x: Array, row: Array, time_s: float) -> int:
    """For an altitude: BASE where it only serves as the base of the next one, TILTED where it is of no use."""
    down = x[11]  # R_zz
    if down < data[4]:
        return _TILTED
    age = time_s - row[ALTITUDE_TIME]
    if age < data[3] and age >= 0.0:
        return _BASE
    if age > _STALE_BASE * data[3] or age < 0.0:
        row[ALTITUDE], row[ALTITUDE_TIME] = data[0] * down, time_s
        return _BASE
    return _NONE


@kernel
def measure(e: int, x: Array, p: Array, sensors: Array, events: Events, config: Config) -> None:
    """Update by the measurement in slot ``e``; its answer goes to the events' own columns."""
    kind, data, s = events.kind[e], events.data[e], events.sensor[e]
    time_s = events.stamp[e] * 1e-9
    events.nis[e], events.dof[e], events.verdict[e] = 0.0, 0, _REFUSED
    for i in range(3):
        events.innovation[e, i], events.sigma[e, i] = 0.0, 0.0
    if kind == _CLIMB:
        base = _awaits_base(data, x, sensors[s], time_s)
        if base != _NONE:
            events.verdict[e], events.reason[e] = _USED if base == _BASE else _REFUSED, base
            return
    nu, noise, h = np.zeros(3), np.zeros((3, 3)), np.zeros((3, COLUMNS))
    columns = np.zeros(COLUMNS, np.int64)
    m, k = model(kind, x, data, sensors[s], time_s, config, nu, noise, columns, h)
    hp = project(p, columns, h, m, k)
    factor = innovation_covariance(hp, columns, h, noise, m, k)
    for i in range(m):
        events.innovation[e, i], events.sigma[e, i] = nu[i], np.sqrt(max(factor[i, i], 0.0))
    events.dof[e] = m
    if kind == _CLIMB:
        sensors[s, ALTITUDE], sensors[s, ALTITUDE_TIME] = data[0] * x[11], time_s
    reason = _refusal(kind, data, x, p, sensors[s], time_s, config)
    if reason != _NONE:
        events.reason[e] = reason
        return
    if not cholesky(factor):
        events.reason[e] = _SINGULAR
        return
    white = np.empty((m, 1))
    white[:, 0] = nu[:m]
    whiten(factor, white)
    nis = (white * white).sum()
    events.nis[e] = nis
    if nis > config.gate[m, kind]:
        reason = _lockout(kind, sensors, s, nu, noise, m, time_s, config)
        events.verdict[e], events.reason[e] = _GATED, reason
        if reason != _RESET:
            return
    elif kind == _POSITION and _grown_into(sensors[s], nu, noise, m, config.gate[m, kind]):
        reason = _RESET
    if reason == _RESET:
        _open(p, kind, nu, m)
        hp = project(p, columns, h, m, k)
        factor = innovation_covariance(hp, columns, h, noise, m, k)
        cholesky(factor)
        white[:, 0] = nu[:m]
        whiten(factor, white)
    events.verdict[e], events.reason[e] = _USED, reason
    sensors[s, GATED_RUN], sensors[s, LAST_USED] = 0.0, time_s
    whiten(factor, hp)
    correct(x, p, hp, white[:, 0].copy(), config.corrects[kind, 0], config.corrects[kind, 1])


@kernel
def _note_xy(events: Events, e: int, at: int, x: Array, p: Array) -> None:
    row = events.xy[e]
    row[at], row[at + 1], row[at + 2], row[at + 3], row[at + 4] = x[0], x[1], p[0, 0], p[0, 1], p[1, 1]


@inner_kernel
def _keep(snapshots: Snapshots, slot: int, t: int, x: Array, p: Array, sensors: Array) -> None:
    snapshots.stamp[slot] = t
    for i in range(x.shape[0]):
        snapshots.x[slot, i] = x[i]
    for i in range(p.shape[0]):
        for j in range(p.shape[1]):
            snapshots.covariance[slot, i, j] = p[i, j]
    for i in range(sensors.shape[0]):
        for j in range(sensors.shape[1]):
            snapshots.sensors[slot, i, j] = sensors[i, j]


@kernel
def run(
    start_ns: int,
    target_ns: int,
    first: int,
    last: int,
    x: Array,
    p: Array,
    sensors: Array,
    motions: Motions,
    events: Events,
    snapshots: Snapshots,
    config: Config,
    keep: bool,
) -> tuple[int, int, int]:
    """From ``start_ns`` to ``target_ns`` in place, taking ``events.order[first:last]`` on the way.

    Stops early for lack of a motion or at an event that is handled outside.  ``keep``: take snapshots.
    Gives why it came back, the time reached, and the next event.
    """
    t, i, capacity = start_ns, first, motions.stamp.shape[0]
    room = new_scratch(p.shape[0])
    while True:
        while i < last and events.stamp[events.order[i]] <= t:
            e = events.order[i]
            if events.kind[e] == _PARAMETERS:
                return OUTSIDE, t, i
            position = events.kind[e] == _POSITION or events.kind[e] == _RANGE
            if position:
                _note_xy(events, e, 0, x, p)
            measure(e, x, p, sensors, events, config)
            if position:
                _note_xy(events, e, 5, x, p)
            i += 1
        if keep and t % config.snapshot_ns == 0:
            slot = (t // config.snapshot_ns) % snapshots.stamp.shape[0]
            _keep(snapshots, slot, t, x, p, sensors)
        if t >= target_ns:
            return DONE, t, i
        end = (t // GRID_NS + 1) * GRID_NS
        k = (end // GRID_NS) % capacity
        if motions.stamp[k] != end:
            return NO_MOTION, t, i
        until = min(end, target_ns)
        if i < last:
            until = min(until, events.stamp[events.order[i]])
        begin = end - GRID_NS
        a0, a1 = (t - begin) / GRID_NS, (until - begin) / GRID_NS
        carry(x, p, motions, k, a0, a1, (until - t) * 1e-9, config, room)
        t = until
