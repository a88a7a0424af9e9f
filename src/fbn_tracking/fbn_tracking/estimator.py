"""The tracking filter: which sonar detections are real things, and where (IROS 2007; JOE 2013, IV)."""

from __future__ import annotations

from collections import Counter
from typing import ClassVar

import numpy as np

from fbn_common.estimator import Health, Level, Output
from fbn_common.records import Innovation, PingMotion, Record, SonarDetections, TrackedFeatures, Verdict
from fbn_common.types import NS, nanoseconds
from fbn_tracking.composite import compose
from fbn_tracking.cut import choose_cut, cut
from fbn_tracking.heading import deviation_variance, drift_prior, regression
from fbn_tracking.intake import Intake, refusal, usable
from fbn_tracking.nursery import Nursery
from fbn_tracking.parameters import TrackingParameters
from fbn_tracking.publish import tracked_features
from fbn_tracking.rehearsal import rehearsal
from fbn_tracking.scan import Scanner
from fbn_tracking.track import Detection, Track, first_ping, make_look, next_ping, pose_matrix
from fbn_tracking.warm_up import warm_up
from fbn_tracking.window import Base, Window

_WIDE = np.array([1e3, 30.0, 30.0, 30.0])  # m, rad: what is put in at the base of a chain; its own earth says more
_FRAME = "odom"


class Tracking:
    """Infants, features and composites from ping motions and sonar detections."""

    _rehearsed: ClassVar[bool] = False

    def __init__(self, parameters: TrackingParameters | None = None) -> None:
        self.parameters = parameters or TrackingParameters()
        warm_up()
        self._reset()
        if not Tracking._rehearsed:
            Tracking._rehearsed = True
            self._rehearse()

    def _rehearse(self) -> None:
        """Play a made-up run and forget it: once a process, so that no first graduation and no first cut is late."""
        for number, records in enumerate(rehearsal(self.parameters.arrays)):
            for record in records:
                self.put("", record)
            self.advance(number * NS)
        self._reset()

    def _reset(self) -> None:
        par = self.parameters
        self._intake = Intake(set(par.arrays), nanoseconds(par.ping_wait))
        self._now_ns = -(2**62)
        self._last_ns = -(2**62)
        self._window: Window | None = None
        self._nursery = Nursery(par)
        self._scanner = Scanner(par, self._nursery)
        self._pings = 0
        self._sequence = 0
        self._counts: Counter[str] = Counter()

    def put(self, topic: str, record: Record) -> None:
        """Take in a ping's motion or a scan."""
        self._intake.put(record)

    def advance(self, now_ns: int) -> list[Output]:
        """Process the pings whose motion has come, in the order of their stamps."""
        outputs: list[Output] = []
        if now_ns < self._now_ns:
            self._start_over(now_ns)
        self._now_ns = now_ns
        answers, self._intake.answers = self._intake.answers, []
        outputs += self._answer(answers)
        for motion in self._linked(self._intake.take_motions(now_ns)):
            outputs += self._process(motion)
        outputs += self._late_scans()
        return outputs + self._answer(self._intake.expire(now_ns))

    def _start_over(self, now_ns: int) -> None:
        """The clock jumped back: forget everything but the counters and the answers still owed."""
        answers, counts = self._intake.answers, self._counts
        self._reset()
        self._counts = counts
        self._counts["clock_resets"] += 1
        self._intake.answers = [*answers, refusal("clock", now_ns, Verdict.REFUSED, "the clock jumped back: reset")]

    def health(self) -> Health:
        """Counters, and whether the smoother failed."""
        window = self._window
        values: dict[str, int | float | str] = dict(sorted(self._counts.items()))
        values |= dict(sorted(self._nursery.counts.items()))
        values |= {"pings": self._pings, "composites": self._sequence}
        if window is None:
            return Health(Level.STALE, "no ping has come yet", values)
        values |= {"window_pings": len(window.pings), "infants": len(self._nursery.infants)}
        values |= {"features": len(window.features)}
        if self._counts["smoother_failures"]:
            return Health(Level.WARN, f"smoother failed {self._counts['smoother_failures']} times", values)
        return Health(Level.OK, f"{len(window.features)} features, {len(self._nursery.infants)} infants", values)

    @property
    def window(self) -> Window | None:
        """The window being smoothed, to be looked at; None before the first ping."""
        return self._window

    @property
    def tracks(self) -> list[Track]:
        """Its features and the infants, to be looked at."""
        features = [] if self._window is None else self._window.features.values()
        return [*features, *self._nursery.infants.values()]

    # --- pings ---

    def _linked(self, motions: list[PingMotion]) -> list[PingMotion]:
        """The motions to process now; one whose predecessor is missing waits for it a while."""
        ready, last = [], self._last_ns
        wait = nanoseconds(self.parameters.link_wait)
        for number, motion in enumerate(motions):
            starts = motion.previous_ns == motion.stamp_ns or self._window is None
            patient = motion.stamp_ns > last and not starts and motion.previous_ns != last
            if patient and motion.previous_ns > last and self._now_ns - motion.stamp_ns < wait:
                for waiting in motions[number:]:
                    self._intake.motions[waiting.stamp_ns] = waiting
                break
            ready.append(motion)
            last = max(last, motion.stamp_ns)
        return ready

    def _process(self, motion: PingMotion) -> list[Output]:
        """One ping: the six steps of IROS 2007, II."""
        if motion.stamp_ns <= self._last_ns:
            reason = "a ping of this stamp or a later one has been processed"
            return self._answer([refusal("ping_motion", motion.stamp_ns, Verdict.LATE, reason)])
        outputs = self._append(motion)
        window = self._window
        assert window is not None
        self._last_ns, self._pings = motion.stamp_ns, self._pings + 1
        for scan in self._intake.take_scans(motion.stamp_ns):
            outputs += self._scan(window, scan, window.last)
        self._nursery.tend(window, motion.stamp_ns)
        self._smooth(window)
        outputs.append(Output("tracking/features", self._features(window)))
        return outputs + self._cut()

    def _append(self, motion: PingMotion) -> list[Output]:
        """Add the pose, to the chain where it links to it, else to a new one."""
        window, gap = self._window, nanoseconds(self.parameters.composite.max_gap)
        linked = window is not None and motion.previous_ns == self._last_ns != motion.stamp_ns
        if window is not None and linked and motion.stamp_ns - self._last_ns <= gap:
            window.add_ping(next_ping(window.pings[window.last], motion, window.base.deviation))
            return []
        outputs = self._close() if window is not None else []
        self._window = self._start(motion)
        self._smooth(self._window)
        return outputs

    def _start(self, motion: PingMotion) -> Window:
        deviation = deviation_variance(motion.earth_covariance, motion.heading_deviation)
        ping = first_ping(motion, deviation)
        mean = np.concatenate((motion.earth, np.zeros(3)))
        covariance = np.diag(np.concatenate((_WIDE**2, np.zeros(3))))
        covariance[4:, 4:] = drift_prior(motion)
        base = Base(pose_matrix(motion.pose), mean, covariance, True, deviation, regression(motion, deviation))
        return Window(base, {ping.index: ping}, self.parameters.feature.weak_theta_sigma)

    def _smooth(self, window: Window) -> None:
        window.update()
        self._note_failures(window)

    def _note_failures(self, window: Window) -> None:
        """Count what has failed in a window since it was last asked, wherever it was smoothed."""
        self._counts["smoother_failures"] += window.failures
        window.failures = 0

    # --- scans ---

    def _scan(self, window: Window, scan: SonarDetections, index: int) -> list[Output]:
        look = make_look(scan, index, self.parameters.arrays[scan.frame_id], self.parameters.feature)
        kept, answers = usable(scan, self.parameters.max_detections)
        array = self.parameters.arrays[scan.frame_id]
        echoes = [
            Detection(look, scan.stamp_ns, np.array([
                e.range, e.bearing, max(e.range_sigma, array.range_sigma), max(e.bearing_sigma, array.bearing_sigma),
                *look.limits[4:],
            ]))
            for e in kept
        ]  # fmt: skip
        window.pings[index].looks.append(look)
        self._counts["scans"] += 1
        self._counts["echoes"] += len(scan.detections)
        return self._answer([*answers, *self._scanner.scan(window, look, echoes)])

    def _late_scans(self) -> list[Output]:
        """Scans whose ping was processed before they came: used while the ping is in the window."""
        window, outputs = self._window, []
        if window is None:
            return []
        at = {ping.stamp_ns: index for index, ping in window.pings.items()}
        for stamp in sorted({stamp for stamp, _ in self._intake.scans if stamp <= self._last_ns}):
            for scan in self._intake.take_scans(stamp):
                if stamp not in at:
                    reason = "its ping was lost or has left the window"
                    outputs += self._answer([refusal(scan.frame_id, stamp, Verdict.LATE, reason)])
                else:
                    outputs += self._scan(window, scan, at[stamp])
                    self._smooth(window)
        return outputs

    # --- composites ---

    def _cut(self) -> list[Output]:
        assert self._window is not None
        last = choose_cut(self._window, self._nursery, self.parameters.composite)
        return [] if last is None else self._divide(last)

    def _close(self) -> list[Output]:
        """End the chain: all that the window still holds becomes a composite."""
        window = self._window
        assert window is not None
        self._nursery.graduate_remaining(window)
        self._smooth(window)
        outputs = self._divide(window.last) if len(window.pings) > 1 else []
        self._nursery.clear()
        return outputs

    def _divide(self, last: int) -> list[Output]:
        assert self._window is not None
        old = self._window
        try:
            part, self._window = cut(old, last, self._nursery, self.parameters)
        except (RuntimeError, np.linalg.LinAlgError) as error:
            self._note_failures(old)
            self._counts["composites_failed"] += 1
            self._window = self._start(old.pings[old.last].motion)
            self._nursery.clear()
            text = f"composite failed: {str(error).splitlines()[0]}"
            return self._answer([refusal("composite", self._last_ns, Verdict.REFUSED, text)])
        self._note_failures(old)
        self._smooth(self._window)
        composite = compose(part, self._sequence, self.parameters.composite.cell_size, _FRAME)
        self._sequence += 1
        return [Output("tracking/composite", composite)]

    # --- outputs ---

    def _features(self, window: Window) -> TrackedFeatures:
        return tracked_features(window, self._nursery, self._scanner.joint, self._pings, _FRAME)

    def _answer(self, answers: list[Innovation]) -> list[Output]:
        for answer in answers:
            self._counts[answer.verdict.name.lower()] += 1
        return [Output("tracking/innovations", answer) for answer in answers]
