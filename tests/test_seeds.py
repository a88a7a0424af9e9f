"""The seeds of a study: in order whatever the processes, and kept until code or settings change."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from fbn_testing.seeds import How, run_seeds


def noted(notes: Path, offset: int, seed: int) -> int:
    """A seed's result, and a note that it was run; seed 5 fails."""
    if seed == 5:
        raise ValueError("seed 5")
    with (notes / "run").open("a") as file:
        file.write(f"{seed}\n")
    return seed + offset


def test_results_come_in_the_order_of_the_seeds_in_any_number_of_processes(tmp_path: Path) -> None:
    for jobs in (1, 2):
        assert run_seeds(partial(noted, tmp_path, 10), (3, 1, 2), "", How(jobs)) == [13, 11, 12]


def test_a_seed_that_was_kept_is_not_run_again_but_with_other_settings_it_is(tmp_path: Path) -> None:
    how, kept = How(1, tmp_path / "kept"), partial(noted, tmp_path, 10)
    assert run_seeds(kept, (1, 2), "", how) == [11, 12]
    assert run_seeds(kept, (1, 2, 3), "", how) == [11, 12, 13]
    assert run_seeds(partial(noted, tmp_path, 20), (1,), "", how) == [21]
    assert sorted((tmp_path / "run").read_text().split()) == ["1", "1", "2", "3"]


def test_a_seed_that_fails_costs_no_other_its_result(tmp_path: Path) -> None:
    how = How(1, tmp_path / "kept")
    with pytest.raises(ValueError, match="seed 5"):
        run_seeds(partial(noted, tmp_path, 10), (5, 6), "", how)
    assert run_seeds(partial(noted, tmp_path, 10), (6,), "", how) == [16]
    assert (tmp_path / "run").read_text().split() == ["6"]
