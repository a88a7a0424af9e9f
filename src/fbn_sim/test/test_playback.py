"""Playing a mission in step with a clock."""

from __future__ import annotations

from sim_cases import short_mission

from fbn_common.types import NS
from fbn_sim.playback import Playback


def test_every_record_is_handed_out_once_when_its_time_has_come() -> None:
    entries = short_mission().entries
    begin_ns = entries[0].log_time_ns
    playback = Playback(entries, begin_ns)
    count = 0
    for second in range(200):
        for entry in playback.due(second * NS):
            assert second - 1 <= (entry.log_time_ns - begin_ns) / NS <= second
            count += 1
    assert playback.over
    assert count == len(entries)


def test_all_times_are_shifted_alike() -> None:
    entries = short_mission().entries
    shifted = list(Playback(entries, entries[0].log_time_ns, shift_ns=5 * NS).due(10 * NS))
    for new, old in zip(shifted, entries, strict=False):
        assert new.log_time_ns - old.log_time_ns == 5 * NS
        assert new.record.stamp_ns - old.record.stamp_ns == 5 * NS


def test_a_rate_makes_the_mission_go_faster_than_the_clock() -> None:
    entries = short_mission().entries
    playback = Playback(entries, entries[0].log_time_ns, rate=10.0)
    (*_, last) = playback.due(2 * NS)
    assert 19.0 < (last.log_time_ns - entries[0].log_time_ns) / NS <= 20.0
    assert playback.time_ns(2 * NS) - entries[0].log_time_ns == 20 * NS
