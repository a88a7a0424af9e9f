"""The front half's study: what it withholds, and how it judges."""

from __future__ import annotations

import numpy as np

from fbn_common.motion_ekf.lockstep import play, run
from fbn_common.records import VehicleParameters
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import on_time, sail
from fbn_reference.parameters import ReferenceParameters
from fbn_sim.scenario import load_scenario
from fbn_sim.sea import draw_sea
from fbn_sim.sensors.compass import draw_deviation
from fbn_testing.motion_study import assignments, seed_range
from fbn_testing.motion_voyage import front_half
from fbn_testing.motion_world import as_stated


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


def test_in_a_world_as_stated_compass_and_water_vary_by_what_the_filters_are_told() -> None:
    """Mean squares of 400 draws, or of 800 components, within four times their own standard deviation."""
    told, seeds = ReferenceParameters(), range(1000, 1400)
    scenario = load_scenario("no_map_transit", as_stated(0.2))
    compass, sea = scenario.sensors.compass, scenario.sea
    drawn = np.array([draw_deviation(compass, seed) for seed in seeds])
    deviation = (drawn[:, 0] ** 2 + drawn[:, 2] ** 2) / 2.0 + drawn[:, 4] ** 2 + compass.drift_sigma**2
    assert abs(deviation.mean() / told.compass.deviation**2 - 1.0) < 4.0 * deviation.std() / deviation.mean() / 20.0
    tides = np.array([draw_sea(sea, 15.0, 1800.0, seed).tide for seed in seeds])
    moved = np.mean((tides[:, 1800] - tides[:, 0]) ** 2)
    component = 0.2**2 / 2.0
    walked = 0.5 * (told.walk.water**2 + told.walk.water_share**2 * component)  # half an hour
    wandered = 2.0 * told.walk.wander**2 * component * (1.0 - np.exp(-1800.0 / told.walk.wander_time))
    assert abs(moved / (walked + wandered) - 1.0) < 4.0 * np.sqrt(2.0 / 800.0)
