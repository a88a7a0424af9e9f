"""The state over a restart: taken up with its age, or refused by name."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbn_common.estimator import Output
from fbn_common.geodesy import geodetic_from_enu
from fbn_common.records import (
    Datum,
    Innovation,
    Localization,
    LocalizationStatus,
    MatchHypotheses,
    Odometry,
    PoseWithCovarianceStamped,
    Record,
    Verdict,
)
from fbn_common.types import NS
from fbn_global import persistence
from fbn_global.estimator import Global
from fbn_global.parameters import GlobalParameters
from fbn_testing.composite_world import DATUM, Run, Settings, World, charles_river
from fbn_testing.matching_play import is_right


@pytest.fixture(scope="module")
def run() -> Run:
    return World(Settings(charles_river(5), ((-40.0, 5.0), (60.0, 5.0)), seed=5)).make()


@pytest.fixture
def parameters(tmp_path: Path) -> GlobalParameters:
    return GlobalParameters(
        state_file=str(tmp_path / "state.fbn"), datum=[DATUM.latitude, DATUM.longitude, DATUM.height]
    )


def finish(run: Run, parameters: GlobalParameters) -> Global:
    estimator = Global(parameters, run.prior)
    for topic, record in run.entries:
        estimator.put(topic, record)
        estimator.advance(record.stamp_ns)
    return estimator


def again(run: Run, parameters: GlobalParameters, after_s: float) -> tuple[Global, list[Output]]:
    """A new filter that gets one odometry so long after the end, in a new odom frame."""
    odometry = [r for _, r in run.entries if isinstance(r, Odometry)]
    stamp_ns = odometry[-1].stamp_ns + round(after_s * NS)
    estimator = Global(parameters, run.prior)
    estimator.put("deadreck/odometry", replace(odometry[0], stamp_ns=stamp_ns))
    return estimator, estimator.advance(stamp_ns)


def answers(outputs: list[Output]) -> list[tuple[Verdict, str]]:
    records = [o.record for o in outputs if isinstance(o.record, Innovation)]
    return [(r.verdict, r.reason) for r in records if r.sensor == "state_file"]


def test_after_a_restart_the_place_is_known_the_less_the_longer_ago(run: Run, parameters: GlobalParameters) -> None:
    before = finish(run, parameters)
    poses = []
    for after in (5.0, 60.0):
        estimator, outputs = again(run, parameters, after)
        assert answers(outputs)[0][0] is Verdict.USED
        assert estimator._bank is not None
        assert before._bank is not None
        assert [h.rows for h in estimator._bank.all] == [h.rows for h in before._bank.all]
        poses.append(next(o.record for o in outputs if isinstance(o.record, Odometry)))
    # 1 m/s: (60 s)^2 - (5 s)^2 more variance; the drift of one second's carry is far below
    np.testing.assert_allclose(poses[1].pose_covariance[0, 0] - poses[0].pose_covariance[0, 0], 3600 - 25, rtol=0.02)


def test_a_damaged_file_is_refused_by_name_and_the_filter_starts_clean(run: Run, parameters: GlobalParameters) -> None:
    finish(run, parameters)
    path = Path(parameters.state_file)
    data = bytearray(path.read_bytes())
    for spoiled, reason in ((data[:-100], "damaged"), (b"x" * 50, "no saved state"), (b"", "no saved state")):
        path.write_bytes(bytes(spoiled))
        _, outputs = again(run, parameters, 5.0)
        assert answers(outputs)[0][0] is Verdict.REFUSED
        assert answers(outputs)[0][1].startswith("state.fbn")
        assert reason in answers(outputs)[0][1]
        assert not [o for o in outputs if isinstance(o.record, PoseWithCovarianceStamped)]


def test_one_flipped_bit_is_damage(run: Run, parameters: GlobalParameters) -> None:
    finish(run, parameters)
    path = Path(parameters.state_file)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    _, outputs = again(run, parameters, 5.0)
    assert "damaged" in answers(outputs)[0][1]


def rewritten(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """The file with other arrays in it, and a checksum that fits them."""
    head = len(persistence._MAGIC)
    with np.load(io.BytesIO(path.read_bytes()[head + 32 :])) as loaded:
        arrays = dict(loaded)
    change(arrays)
    body = io.BytesIO()
    np.savez(body, **arrays)
    path.write_bytes(persistence._MAGIC + hashlib.sha256(body.getvalue()).digest() + body.getvalue())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda a: a.pop("mean_0"), "does not hold what it should"),
        (lambda a: a.update(mean_0=a["mean_0"][:-1]), "not finite and positive definite"),
        (lambda a: a["covariance_0"].__setitem__((0, 0), np.nan), "not finite and positive definite"),
        (lambda a: a["covariance_0"].__setitem__((1, 1), -1.0), "not finite and positive definite"),
        (lambda a: a.update(count=np.array(0)), "not finite and positive definite"),
    ],
)
def test_a_whole_file_with_senseless_content_is_refused_by_name(
    run: Run, parameters: GlobalParameters, change: Callable[[dict[str, Any]], object], reason: str
) -> None:
    finish(run, parameters)
    rewritten(Path(parameters.state_file), change)
    _, outputs = again(run, parameters, 5.0)
    verdict, text = answers(outputs)[0]
    assert verdict is Verdict.REFUSED
    assert text.startswith("state.fbn") and reason in text
    assert not [o for o in outputs if isinstance(o.record, PoseWithCovarianceStamped)]


def test_a_crash_while_writing_leaves_the_old_state(
    run: Run, parameters: GlobalParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    finish(run, parameters)
    before = Path(parameters.state_file).read_bytes()

    def crash(*_: object) -> None:
        raise OSError("power is gone")

    monkeypatch.setattr("fbn_global.persistence.os.replace", crash)
    finish(run, replace(parameters, method="POS"))
    assert Path(parameters.state_file).read_bytes() == before


def test_where_nothing_can_be_written_the_filter_goes_on_and_says_so(run: Run, tmp_path: Path) -> None:
    estimator = finish(run, GlobalParameters(state_file=str(tmp_path / "missing" / "state.fbn")))
    values = estimator.health().values
    assert values["count state_file refused"] == values["count composite used"]


def test_a_state_of_another_map_or_too_old_is_refused(run: Run, parameters: GlobalParameters) -> None:
    finish(run, parameters)
    other = replace(run, prior=World(Settings(charles_river(6), ((0.0, 0.0), (30.0, 0.0)), seed=6)).run.prior)
    assert "another map" in answers(again(other, parameters, 5.0)[1])[0][1]
    assert "s old" in answers(again(run, parameters, 5000.0)[1])[0][1]


def test_no_half_written_file_is_left(run: Run, parameters: GlobalParameters) -> None:
    finish(run, parameters)
    assert [p.name for p in Path(parameters.state_file).parent.iterdir()] == ["state.fbn"]


def restarted(run: Run, parameters: GlobalParameters, after_s: float, late_s: float) -> list[Output]:
    """A new filter and tracker: the same way once more, so long after the end; the datum comes late by so much."""
    entries = [(t, r) for t, r in run.entries if t in ("deadreck/odometry", "tracking/composite")]
    shift_ns = entries[-1][1].stamp_ns - entries[0][1].stamp_ns + round(after_s * NS)
    datum = Datum(entries[0][1].stamp_ns + round(late_s * NS), "map", DATUM.latitude, DATUM.longitude, DATUM.height)
    entries.append(("reference/datum", datum))
    estimator, outputs = Global(replace(parameters, datum=[]), run.prior), []
    for topic, record in sorted(((t, delayed(r, shift_ns)) for t, r in entries), key=lambda e: e[1].stamp_ns):
        estimator.put(topic, record)
        outputs += estimator.advance(record.stamp_ns)
    return outputs


def delayed(record: Record, by_ns: int) -> Record:
    starts = {"start_ns": record.start_ns + by_ns} if hasattr(record, "start_ns") else {}
    return replace(record, stamp_ns=record.stamp_ns + by_ns, **starts)


@pytest.mark.parametrize("late_s", [0.0, 5.0, 30.0])
def test_a_state_waits_for_the_datum_and_the_vehicle_finds_itself_by_it_again(
    run: Run, parameters: GlobalParameters, late_s: float
) -> None:
    """The datum comes with the first odometry, after it, or after two composites; no fix, only the state says where."""
    finish(run, parameters)
    outputs = restarted(run, parameters, 60.0, late_s)
    assert [a[0] for a in answers(outputs)] == [Verdict.USED]
    statuses = [o.record for o in outputs if isinstance(o.record, LocalizationStatus)]
    assert statuses[-1].state is Localization.MATCHED
    told = [o.record for o in outputs if isinstance(o.record, MatchHypotheses)]
    assert is_right(told[-1], 0, run)


def test_without_a_datum_a_state_is_neither_used_nor_written_over(run: Run, parameters: GlobalParameters) -> None:
    finish(run, parameters)
    before = Path(parameters.state_file).read_bytes()
    outputs = restarted(run, parameters, 60.0, 1e6)[:-1]
    assert not [o for o in outputs if isinstance(o.record, PoseWithCovarianceStamped)]
    assert Path(parameters.state_file).read_bytes() == before or answers(outputs)


def test_about_another_datum_the_state_is_carried_over(run: Run, parameters: GlobalParameters) -> None:
    """The new origin lies 300 m east and 400 m south of the old: all places move by as much the other way."""
    before = finish(run, parameters)
    there = geodetic_from_enu(np.array([300.0, -400.0, 0.0]), DATUM)
    moved = replace(parameters, datum=[there.latitude, there.longitude, 0.0])
    estimator, outputs = again(run, moved, 5.0)
    assert [a[0] for a in answers(outputs)] == [Verdict.USED]
    assert estimator._bank is not None and before._bank is not None and estimator._field is not None
    for old, new in zip(before._bank.all, estimator._bank.all, strict=True):
        shift = new.state.mean[:2] - old.state.mean[:2]
        # the axes at 500 m differ by 500 m tan(42 deg) / R = 7e-5: 7 mm over the 100 m of the field
        np.testing.assert_allclose(shift, [-300.0, 400.0], atol=0.1)
        for row in new.rows:
            block = persistence.Block(persistence.Kind.MAP, row)
            from_file = new.state.marginal(block)[0][:2] - estimator._field.position[row, :2]
            assert before._field is not None
            as_before = old.state.marginal(block)[0][:2] - before._field.position[row, :2]
            np.testing.assert_allclose(from_file, as_before, atol=0.02)


def test_drift_learnt_before_a_restart_is_not_taken_for_that_of_the_new_dead_reckoning(
    run: Run, parameters: GlobalParameters
) -> None:
    finish(run, parameters)
    estimator, _ = again(run, parameters, 5.0)
    assert estimator._bank is not None
    for h in estimator._bank.all:
        np.testing.assert_allclose(np.diag(h.state.covariance)[6:9], parameters.motion.drift_sigma**2)


def test_the_area_swept_before_a_restart_counts_after_it(run: Run, parameters: GlobalParameters) -> None:
    """How dense objects off the map are rests on all of it: found objects over no area would be a crowd."""
    before = finish(run, parameters)
    estimator, _ = again(run, parameters, 5.0)
    assert estimator._bank is not None and before._bank is not None
    assert estimator._bank.memory.area == before._bank.memory.area > 1000.0
