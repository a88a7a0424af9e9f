"""Reference: absolute x and y, and the parameters of vehicle and water; may jump."""

from __future__ import annotations

from functools import cache

import numpy as np

from fbn_common.estimator import Output
from fbn_common.geodesy import GeodeticPoint, enu_from_geodetic
from fbn_common.graph import GRAPH
from fbn_common.motion_ekf.filter import MotionFilter
from fbn_common.motion_ekf.intake import Intake
from fbn_common.motion_ekf.layout import (
    ACTUATION,
    BEACON_ROW,
    ESTIMATED_REFERENCE,
    GPS,
    GPS_ROW,
    LAYER,
    OWN,
    SIZE_REFERENCE,
    WATER,
    X_DEVIATION,
    X_PARAMETERS,
    Config,
    IntArray,
    Kind,
)
from fbn_common.motion_ekf.monitor import all_finite, content_of
from fbn_common.motion_ekf.parameters import quantile_table
from fbn_common.motion_ekf.sensors import Unusable, usable_covariance
from fbn_common.motion_ekf.warm_up import rehearse
from fbn_common.records import BeaconRange, Datum, NavSatFix, Record, ReferenceFix, VehicleParameters, Verdict
from fbn_common.types import Array, nanoseconds
from fbn_reference.holding import Holding, Waiting
from fbn_reference.parameters import ReferenceParameters
from fbn_reference.ranges import beacon_intakes, objection
from fbn_reference.rehearsal import PARAMETERS, position_records
from fbn_reference.service import Gain

_OF_POSITION, _USED = (int(Kind.POSITION), int(Kind.RANGE)), int(Verdict.USED)


class Reference(MotionFilter):
    """EKF over pose, velocity and all 15 parameters, with GPS and ranges; errors of sensors are considered."""

    name = "reference"
    frame_id = "map"
    size = SIZE_REFERENCE
    estimated = ESTIMATED_REFERENCE

    def __init__(self, parameters: ReferenceParameters, *, rehearsed: bool = True) -> None:
        self.own = parameters
        ranks = {topic: i for i, topic in enumerate(GRAPH.node("fbn_reference").inputs)}
        self.datum = parameters.map.datum if parameters.map.datum_given else None
        self._beacons = beacon_intakes(parameters.lbl)
        super().__init__(parameters, ranks, BEACON_ROW + len(self._beacons))
        self._datum_said = False
        if rehearsed:
            _rehearse()

    def _restart(self) -> None:
        super()._restart()
        for intake in self._beacons.values():
            intake.reset()
        self._holding = Holding(self.own.lbl)
        self._gain: Gain | None = None
        self._fix_ns = self._settled_ns = self._parameters_ns = -1

    def config(self) -> Config:
        """The kernels' numbers."""
        gps, lbl = self.own.gps, self.own.lbl
        base = super().config()
        base.tau[GPS - OWN :] = gps.time_constant
        base.lever[Kind.POSITION], base.lever[Kind.RANGE] = gps.position, lbl.position
        base.lockout[Kind.RANGE] = lbl.lockout
        base.gate[:, Kind.RANGE] = quantile_table({Kind.RANGE: lbl.gate})[:, Kind.RANGE]
        return base._replace(
            white=gps.white,
            correlated=gps.correlated**2,
            fix_depth=gps.surface_depth,
            rule=gps.rule,
            drop_s=lbl.drop,
        )

    def corrects(self) -> IntArray:
        """As the base class; what measures position corrects everything."""
        rows = super().corrects()
        rows[[Kind.POSITION, Kind.RANGE]] = 0, ESTIMATED_REFERENCE
        return rows

    def start_xy(self) -> tuple[float, float, float]:
        """As the parameters say."""
        return self.own.map.start_x, self.own.map.start_y, self.own.map.start_sigma**2

    # --- taking in --------------------------------------------------------------------------------------

    def sensors(self) -> dict[str, Intake]:
        """As the base class, and GPS."""
        gps = Intake(
            "gps", self.own.gps, Kind.POSITION, GPS_ROW, self._fix_data,
            lambda r: content_of(r.latitude, r.longitude, r.status) if r.status >= 0 else content_of(r.stamp_ns),
        )  # fmt: skip
        return super().sensors() | {"gps/fix": gps}

    def take(self, topic: str, record: Record, now_ns: int) -> list[Output]:
        """A range belongs to the middle of its travel; it waits if the gate cannot judge it."""
        if not isinstance(record, BeaconRange):
            return []
        intake = self._beacons.get(record.beacon_id)
        why = objection(record, self.own.lbl)
        if intake is None or why:
            return [
                self.answers.say(record.stamp_ns, "lbl", Verdict.REFUSED, why or f"unknown beacon {record.beacon_id!r}")
            ]
        stamp = record.stamp_ns - nanoseconds(record.travel_delay / 2.0)
        at_middle = BeaconRange(
            stamp, record.frame_id, record.beacon_id, record.range, record.range_variance, record.travel_delay
        )
        data, said = self.examine(intake, at_middle, now_ns)
        if data is None:
            return said + (self._withdraw(intake, record.range) if intake.watch.stopped else [])
        if self._holding.trusted(self.ekf, intake, stamp):
            return self.enter(intake, topic, at_middle, data)
        self._holding.put(Waiting(intake, at_middle, data))
        return said

    def _withdraw(self, intake: Intake, value: float) -> list[Output]:
        """Take back what a beacon repeated before it was known to be frozen; answer what was not answered yet."""
        rows, since, why = self.ekf.events.rows, intake.watch.began_ns, f"taken back: {intake.watch.stopped}"
        mine = [s for s in self.ekf.events.slots if rows.sensor[s] == intake.row and rows.stamp[s] > since]
        out = []
        for slot in (s for s in mine if rows.data[s, 3] == value):
            self.ekf.withdraw(slot)
            if self.answers.release(slot) is not None:
                out.append(self.answers.refuse(intake, int(rows.stamp[slot]), Verdict.REFUSED, why))
        waited = self._holding.withdraw(intake, value, since)
        return out + [self.answers.refuse(intake, w.stamp_ns, Verdict.REFUSED, why) for w in waited]

    def settle(self, now_ns: int) -> list[Output]:
        """Rule on ranges that wait until no more can be said: who is admitted changes the position for the others."""
        out: list[Output] = []
        while self._holding.waiting:
            ruling = self._holding.rule(self.ekf)
            for w in ruling.admitted:
                out += self.enter(w.intake, "lbl/range", w.record, w.data)
            out += [self.answers.refuse(w.intake, w.stamp_ns, Verdict.REFUSED, why.value) for w, why in ruling.refused]
            if not ruling.admitted and not ruling.refused:
                break
            self.ekf.advance(now_ns)
        return out

    def notes(self) -> list[str]:
        """What the beacons leave undecided."""
        undecided = self._holding.complaint(self.ekf.head_ns)
        return [undecided] if undecided else []

    def _fix_data(self, fix: NavSatFix) -> Array:
        """Data (5,) of a fix in ``map``: x, y, covariance xx, xy, yy; the first good one makes the datum."""
        gps = self.own.gps
        if fix.status < 0:
            raise Unusable("no fix (status -1)")
        if not all_finite(fix.latitude, fix.longitude) or abs(fix.latitude) > 90.0 or abs(fix.longitude) > 360.0:
            raise Unusable("latitude or longitude is not finite, or no place on earth")
        if fix.position_covariance_type == 0 or not np.any(fix.position_covariance):
            raise Unusable("covariance unknown")
        c = usable_covariance(np.ascontiguousarray(fix.position_covariance[:2, :2]), gps.sigma_max, gps.sigma_min)
        if c[0, 0] + c[1, 1] > 2.0 * gps.sigma_max**2:
            raise Unusable(f"standard deviation over {gps.sigma_max} m")
        if self.datum is None:
            if self.ekf.head_ns >= 0 and -self.ekf.state.x[2] > gps.surface_depth:
                raise Unusable("a fix under water")
            self.datum = GeodeticPoint(fix.latitude, fix.longitude, fix.altitude if np.isfinite(fix.altitude) else 0.0)
        height = self.datum.height  # the vehicle's z comes from its depth
        x, y, _ = enu_from_geodetic(fix.latitude, fix.longitude, height, self.datum)
        return np.array([x, y, c[0, 0], c[0, 1], c[1, 1]])

    # --- what goes out ----------------------------------------------------------------------------------

    def publishes(self) -> bool:
        """``map`` exists once there is a datum."""
        return self.datum is not None

    def services(self, now_ns: int) -> list[Output]:
        """The datum once, parameters when due, and a fix where information was gained."""
        out: list[Output] = []
        if self.datum is not None and not self._datum_said:
            self._datum_said = True
            d = self.datum
            record = Datum(self.ekf.head_ns, "map", d.latitude, d.longitude, d.height)
            out.append(Output("reference/datum", record))
        out += self._gained()
        if self._position_known() and self.ekf.head_ns - self._parameters_ns >= nanoseconds(self.own.parameters_period):
            out.append(Output("reference/parameters", self._parameters_record()))
        return out

    def _position_known(self) -> bool:
        p = self.ekf.state.covariance
        return bool(max(p[0, 0], p[1, 1]) < self.own.known_sigma**2)

    def _parameters_record(self) -> VehicleParameters:
        state = self.ekf.state
        self._parameters_ns = state.stamp_ns
        block, further = slice(ACTUATION, WATER + 3), slice(WATER + 3, LAYER + 2)
        return VehicleParameters(
            state.stamp_ns, "map", state.x[X_PARAMETERS:X_DEVIATION].copy(), state.covariance[block, block].copy(),
            state.x[X_DEVIATION:].copy(), state.covariance[further, ACTUATION : LAYER + 2].copy(),
        )  # fmt: skip

    def _gained(self) -> list[Output]:
        """Follow the measurements of position that are settled; publish their information when it is worth it."""
        events = self.ekf.events
        due = self._holding.settled_ns(self.ekf.head_ns - nanoseconds(self.own.fix_delay))
        rows = events.rows
        for slot in events.slots[events.after(self._settled_ns) : events.after(due)]:
            self._settled_ns = int(rows.stamp[slot])
            if int(rows.kind[slot]) not in _OF_POSITION or int(rows.verdict[slot]) != _USED:
                continue
            self._fix_ns = self._settled_ns
            if self._gain is None:
                row = rows.xy[slot]
                self._gain = Gain(row[:2], np.array([[row[2], row[3]], [row[3], row[4]]]))
            self._gain.add(rows.xy[slot, :5], rows.xy[slot, 5:])
        gain = self._gain
        if gain is None or not gain.worth(self.own.fix_gain) or not self._position_known():
            return []
        xy, covariance = gain.collect()
        return [Output("reference/fix", ReferenceFix(self._fix_ns, "map", xy, covariance, gain.covariance.copy()))]


@cache
def _rehearse() -> None:
    """Once in a process, so that no first fix or range is late."""
    rehearse(Reference(PARAMETERS, rehearsed=False), position_records)
