"""One scan: match its echoes, feed the tracks, note who was missed, give birth to the rest."""

from __future__ import annotations

from math import log1p

from fbn_common import chi_square
from fbn_common.records import Innovation, Verdict
from fbn_common.types import Mat3
from fbn_tracking.matching import DRIFT, Joint, Match, Prediction, match, predict_feature, predict_infants, view_weights
from fbn_tracking.nursery import Nursery
from fbn_tracking.parameters import TrackingParameters
from fbn_tracking.track import Detection, Look, Track
from fbn_tracking.window import Window

_VISIBLE = 0.05  # weight of the beam under which a look that sees nothing says nothing


class Scanner:
    """Steps 2 to 4 of IROS 2007, II, for one array's echoes."""

    def __init__(self, parameters: TrackingParameters, nursery: Nursery) -> None:
        self.parameters = parameters
        self.nursery = nursery
        self.joint: Joint | None = None
        self._gate = float(chi_square.bound(parameters.gate, 3))
        self._of: tuple[int, int, tuple[int, ...]] | None = None

    def scan(self, window: Window, look: Look, echoes: list[Detection]) -> list[Innovation]:
        """Take in a look's echoes; gives the innovation of each that was matched."""
        features = [t for t in window.features.values() if not t.retired and t.anchor <= look.index]
        drift_covariance = self._refresh_joint(window, look.index, features)
        self.nursery.follow(window, drift_covariance)
        infants = [t for t in self.nursery.infants.values() if t.modes]
        predictions = [predict_feature(window, t, look, self.joint) for t in features] if self.joint else []
        predictions += predict_infants(window, infants, look)
        matches = match(predictions, echoes, look, self._gate, self.parameters.infant.clutter)
        changed = [m.prediction.track for m in matches if self._feed(window, m, echoes[m.echo])]
        self._note_misses(predictions, {m.prediction.track.key for m in matches}, look)
        taken, before = {m.echo for m in matches}, set(self.nursery.infants)
        for number, echo in enumerate(echoes):
            if number not in taken:
                self.nursery.born(echo)
        changed += [t for t in self.nursery.infants.values() if t.key not in before or not t.modes]
        self.nursery.refresh(changed, self.nursery.around(window, drift_covariance))
        return [_innovation(m, echoes[m.echo]) for m in matches]

    def _refresh_joint(self, window: Window, index: int, features: list[Track]) -> Mat3:
        """Bring the joint covariance up to date; gives that of the drift."""
        of = (id(window), index, tuple(t.key for t in features))
        if not features:
            self.joint = self._of = None
            return window.base.covariance[4:, 4:]
        if self._of != of:
            try:
                self.joint, self._of = Joint.of(window, index, features), of
            except RuntimeError:
                window.failures += 1
                self.joint = self._of = None
                return window.base.covariance[4:, 4:]
        assert self.joint is not None
        return self.joint.block([DRIFT], [3])

    def _feed(self, window: Window, found: Match, echo: Detection) -> bool:
        """Give an echo to its track; whether the track is an infant."""
        track = found.prediction.track
        track.last_seen_ns = max(track.last_seen_ns, echo.stamp_ns)
        track.seen += 1
        if track.graduated:
            window.add_detection(track, echo)
            return False
        track.score += found.evidence
        track.detections.append(echo)
        track.detections.sort(key=lambda d: d.index)
        return True

    def _note_misses(self, predictions: list[Prediction], matched: set[int], look: Look) -> None:
        weights: dict[int, tuple[Track, float]] = {}
        for prediction, weight in zip(predictions, view_weights(predictions, look), strict=True):
            key = prediction.track.key
            if key not in matched and weight > weights.get(key, (prediction.track, _VISIBLE))[1]:
                weights[key] = (prediction.track, weight)
        for track, weight in weights.values():
            track.misses.append(look)
            track.score += log1p(-look.detection_probability * weight)


def _innovation(found: Match, echo: Detection) -> Innovation:
    track = found.prediction.track
    kind = "feature" if track.graduated or track.memory is not None else "infant"
    return Innovation(
        echo.stamp_ns,
        echo.look.array,
        f"{echo.look.array}/{kind}",
        found.nis,
        2,
        Verdict.USED,
        f"{kind} {track.key}",
        found.innovation,
        found.sigma,
    )
