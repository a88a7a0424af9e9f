"""The main scenario over seeds that nothing was tuned on; and that a campaign goes on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fbn_bringup.campaign import Plan, Row, run_campaign, summary_tables
from fbn_bringup.campaign_journal import Journal, JournalError, write


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_the_river_is_matched_on_nearly_every_dive_and_never_falsely() -> None:
    rows = run_campaign(Plan("charles_river_2006"), range(10))
    assert not [row.error for row in rows if row.error]
    total = {name: sum(row.values[name] or 0 for row in rows) for name in ("dives", "dives_matched", "false_matches")}
    assert total["false_matches"] == 0
    # the aim is 98 % of dives over 100 seeds; of 60 dives, 55 or fewer would speak against it (binomial, 1 %)
    assert total["dives_matched"] >= 0.98 * total["dives"] - 3.3
    assert np.median([row.values["on_map_median_m"] for row in rows]) <= 1.5


NOWHERE = Plan("atlantis")  # no such scenario: a seed that is run ends at once, with an error


def test_seeds_whose_rows_are_kept_are_not_run_again(tmp_path: Path) -> None:
    journal, done = Journal(tmp_path, NOWHERE), []
    journal.keep(Row(3, {"dives": 6.0, "target_median_m": None}, 1.5))
    rows = run_campaign(NOWHERE, [3, 4], 1, done.append, Journal(tmp_path, NOWHERE))
    assert [(row.seed, bool(row.error)) for row in rows] == [(3, False), (4, True)] and done == [1, 2]
    assert rows[0] == Row(3, {"dives": 6.0, "target_median_m": None}, 1.5)


def test_a_row_is_on_disk_when_its_seed_ends_and_one_that_failed_is_tried_again(tmp_path: Path) -> None:
    on_disk: list[int] = []
    path = tmp_path / "rows.jsonl"
    run_campaign(
        NOWHERE, [1, 2], 1, lambda _: on_disk.append(len(path.read_text().splitlines())), Journal(tmp_path, NOWHERE)
    )
    assert on_disk == [1, 2, 3]  # what was planned, and a line more after each seed
    assert Journal(tmp_path, NOWHERE).rows() == {}


def test_what_was_stated_is_kept_with_its_row_and_told_in_table_summary_and_figure(tmp_path: Path) -> None:
    journal = Journal(tmp_path, NOWHERE)
    journal.keep(Row(1, {"dives": 6.0}, 1.0, stated=((0.995, True),) * 19 + ((0.995, False),)))
    rows = list(Journal(tmp_path, NOWHERE).rows().values())
    assert rows[0].stated[-1] == (0.995, False)
    write(tmp_path, NOWHERE, rows)
    told = json.loads((tmp_path / "summary.json").read_text())["reliability"]
    assert [(b["count"], b["right"]) for b in told] == [(20, 0.95)]
    assert (tmp_path / "reliability.png").stat().st_size > 1000
    assert [len(t.rows) for t in summary_tables(NOWHERE, rows)][-1] == 1


def test_a_line_cut_off_by_a_crash_costs_that_row_alone(tmp_path: Path) -> None:
    journal = Journal(tmp_path, NOWHERE)
    for seed in (1, 2):
        journal.keep(Row(seed, {"dives": 6.0}, 1.0))
    whole = journal.path.read_text()
    journal.path.write_text(whole[:-9])
    assert list(journal.rows()) == [1]
    journal.keep(Row(2, {"dives": 5.0}, 1.0))
    assert {s: r.values["dives"] for s, r in journal.rows().items()} == {1: 6.0, 2: 5.0}


def test_rows_of_other_settings_are_not_mixed_in(tmp_path: Path) -> None:
    Journal(tmp_path, NOWHERE).keep(Row(1, {}, 1.0))
    with pytest.raises(JournalError, match="--fresh"):
        Journal(tmp_path, Plan("atlantis", (), ("global.method=JCBB",)))
    vehicle = tmp_path / "vehicle.yaml"
    vehicle.write_text("a: 1")
    Journal(tmp_path / "v", Plan("atlantis", (vehicle,)))
    vehicle.write_text("a: 2")
    with pytest.raises(JournalError):
        Journal(tmp_path / "v", Plan("atlantis", (vehicle,)))


def test_rows_made_with_a_sonar_file_that_has_changed_are_not_mixed_in(tmp_path: Path) -> None:
    sonar, vehicle = tmp_path / "ours.yaml", tmp_path / "vehicle.yaml"
    vehicle.write_text("tracking:\n  head: {sonar: ours.yaml}\n")
    for name, plan in {
        "by file": Plan("atlantis", (vehicle,)),
        "by setting": Plan("atlantis", (), (f"tracking.head.sonar={sonar}",)),
    }.items():
        sonar.write_text("range_max: 40")
        Journal(tmp_path / name, plan)
        sonar.write_text("range_max: 50")
        with pytest.raises(JournalError):
            Journal(tmp_path / name, plan)


def test_the_command_goes_on_and_begins_anew_when_told(fbn, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    target = tmp_path / "c"
    Journal(target, NOWHERE).keep(Row(0, {"dives": 6.0}, 1.0))
    status, out, err = fbn("campaign", "atlantis", "--seeds", "0:1", "-o", target)
    assert status == 0 and "1 of 1 seeds are there already" in err and "6" in out
    status, _, err = fbn("campaign", "atlantis", "--seeds", "0:1", "-o", target, "--fresh", "--jobs", "1")
    assert status == 1 and "atlantis" in err
