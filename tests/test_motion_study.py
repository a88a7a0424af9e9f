"""The front half's study: what it withholds, and how it judges."""

from __future__ import annotations

import numpy as np

from fbn_common.motion_ekf.lockstep import play, run
from fbn_common.records import VehicleParameters
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import on_time, sail
from fbn_testing.motion_study import assignments, seed_range
from fbn_testing.motion_voyage import front_half


def test_without_sharing_predict_keeps_its_prior_and_with_it_does_not() -> None:
    arrivals = on_time(sail(PredictParameters(), 40.0, 1007, depth=0.7))
    last = {}
    for withheld in (frozenset[str](), frozenset({"reference/parameters"})):
        used = [
            o.record
            for made in play(front_half(), arrivals, withheld=withheld)
            for o in made
            if o.topic == "predict/parameters" and isinstance(o.record, VehicleParameters)
        ]
        last[bool(withheld)] = (used[0].mean, used[-1].mean)
    assert np.array_equal(*last[True])
    assert not np.array_equal(*last[False])


def test_playing_step_by_step_publishes_what_running_at_once_does() -> None:
    arrivals = on_time(sail(PredictParameters(), 10.0, 1007))
    at_once = run(front_half(), arrivals)
    stepwise = [o for made in play(front_half(), arrivals) for o in made]
    assert [(o.topic, o.record.stamp_ns) for o in stepwise] == [(o.topic, o.record.stamp_ns) for o in at_once]


def test_seeds_and_settings_are_read_as_written() -> None:
    assert list(seed_range("3:5")) == [3, 4]
    assert list(seed_range("7")) == [7]
    assert assignments(["a.b=0.5", "c=[1, 2]"]) == {"a.b": 0.5, "c": [1, 2]}
