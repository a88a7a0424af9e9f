"""A node's figures about itself."""

from __future__ import annotations

from fbn_ros.statistics import Statistics


def test_a_cycle_is_missed_when_the_timer_is_late_by_a_whole_period() -> None:
    statistics = Statistics()
    for late in (-0.001, 0.0, 0.004, 0.0099):
        statistics.tick(late, 0.01)
    assert statistics.report()["timer cycles missed"] == 0
    statistics.tick(0.012, 0.01)
    statistics.tick(0.035, 0.01)
    values = statistics.report()
    assert values["timer cycles missed"] == 4
    assert values["timer late max [ms]"] == 35.0


def test_missed_cycles_are_counted_in_all_and_lateness_since_the_last_report() -> None:
    statistics = Statistics()
    statistics.tick(0.02, 0.01)
    statistics.report()
    values = statistics.report()
    assert values["timer cycles missed"] == 2
    assert values["timer late max [ms]"] == 0.0
