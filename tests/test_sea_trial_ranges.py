"""Acoustic ranges of a sea trial: outliers, and a beacon that lies, against a robust fit of the whole trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from fbn_testing.sea_trial import Fit, Trial, fit, read
from fbn_testing.sea_trial_study import outliers, run


@pytest.fixture(scope="module")
def trials() -> dict[str, tuple[Trial, Fit]]:
    found = {name: read(name) for name in ("goats_15", "goats_16")}
    return {name: (trial, fit(trial)) for name, trial in found.items()}


def test_the_files_hold_what_their_publishers_say(trials) -> None:
    (first, _), (second, _) = trials["goats_15"], trials["goats_16"]
    assert (len(first.poses), len(first.beacons), len(first.ranges)) == (473, 3, 786)
    assert (len(second.poses), len(second.beacons), len(second.ranges)) == (201, 4, 572)


def test_ranges_with_outliers_hold_the_position_over_kilometres(trials) -> None:
    trial, truth = trials["goats_15"]
    o = run(trial, truth, start_sigma=10.0)
    # The fit itself is good to 1 m or so (ranges leave 0.84 m over, by median); it smooths, the filter does not.
    assert np.median(o.error) < 3.0
    assert np.percentile(o.error, 90) < 6.0
    for beacon in trial.beacons:  # the fit calls 3 to 6 % of them outliers
        verdicts = o.verdicts(beacon)
        assert verdicts["USED"] > 0.9 * verdicts.total()
        assert verdicts["GATED"] > 0
    # Errors of ranges are correlated along the way and not normal: a factor of two either way, not the 95 % band.
    assert 0.5 < o.nis < 2.0


def test_a_beacon_that_is_not_where_it_is_said_to_be_is_dropped(trials) -> None:
    trial, truth = trials["goats_16"]
    assert outliers(trial, truth, "L1") > 0.9  # off by 24 m
    o = run(trial, truth, start_sigma=2.0)  # a fix from GPS before the dive
    liar = o.verdicts("L1")
    assert liar["USED"] < 0.1 * liar.total()
    assert liar["REFUSED"] > liar["GATED"]  # not only gated one by one
    for honest in ("L0", "L2", "L3"):
        assert o.verdicts(honest)["USED"] > 0.6 * o.verdicts(honest).total()
    assert np.percentile(o.error, 90) < 6.0


@pytest.mark.parametrize("start_sigma", [10.0, 1000.0])  # 0.6 and 0.8 of it is the start off
def test_a_beacon_that_lies_is_found_out_from_an_uncertain_start(trials, start_sigma: float) -> None:
    trial, truth = trials["goats_16"]
    o = run(trial, truth, start_sigma=start_sigma)
    assert np.percentile(o.error, 90) < 6.0
    assert o.verdicts("L1")["USED"] < 0.1 * o.verdicts("L1").total()
