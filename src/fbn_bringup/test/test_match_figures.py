"""Figures of the tracker's work count what became of infants."""

from __future__ import annotations

import numpy as np

from fbn_bringup.report.match_figures import fates
from fbn_common.records import Stage, TrackedFeature, TrackedFeatures


def _message(stamp: int, **stages: Stage) -> TrackedFeatures:
    found = (TrackedFeature(int(k[1:]), s, 2, 0, stamp, np.zeros(3), np.eye(3)) for k, s in stages.items())
    return TrackedFeatures(stamp, "odom", stamp, tuple(found))


def test_infants_are_promoted_or_deleted_once_and_a_feature_that_goes_is_neither() -> None:
    infant, feature, retired = Stage.INFANT, Stage.FEATURE, Stage.RETIRED
    messages = [
        _message(1, k1=infant, k2=infant),
        _message(2, k1=feature, k2=infant, k3=infant),
        _message(3, k1=feature),
        _message(4, k1=retired),
        _message(5),
    ]
    promoted, deleted = fates(messages)
    assert promoted.tolist() == [0, 1, 1, 1, 1]
    assert deleted.tolist() == [0, 0, 2, 2, 2]
