"""GPS withheld from a log: what is judged, and against what; on a log imported from a csv made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fbn_bringup.evaluation.run import RunError
from fbn_bringup.evaluation.withheld import STILL_WATER, withhold
from fbn_bringup.importing.importer import Item, import_logs
from fbn_bringup.importing.mapping import read_mapping

CONFIG = Path(__file__).parents[1] / "config"
SPEED, COUNT = 1.045, 178  # m/s at 50 counts over 128, as iver2.yaml has it
WATER = np.array([0.10, -0.05])  # m/s, towards east and north
SECONDS, TURN_S = 150, 30.0  # a leg of half a minute, then the other way
METRE = 1.0 / 111_000.0  # deg of latitude


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> list[Item]:
    """East and west in turns in a current, at 1 Hz, without noise but the resolution of the columns."""
    header = "Latitude,Longitude,Time,Date,Number of Sats,HDOP,C True Heading,Pitch Angle,Roll Angle,DFS Depth (m),"
    header += "DTB Height (m),Motor Speed CMD,Fin Yaw T,Fin Yaw B"
    position, lines = np.zeros(2), [header]
    for i in range(SECONDS):
        heading = 90.0 if (i // TURN_S) % 2 == 0 else 270.0
        position = position + WATER + SPEED * np.array([np.sin(np.radians(heading)), 0.0]) * (i > 0)
        place = f"{position[1] * METRE:.9f},{position[0] * METRE:.9f}"
        lines.append(f"{place},{i // 60:02d}:{i % 60:02d}.0,9/18/20,9,1.0,{heading - 0.7:.2f},0,0,0,5,{COUNT},118,118")
    path = tmp_path_factory.mktemp("log") / "1_20200918_100000_made.csv"
    path.write_text("\n".join(lines) + "\n")
    return import_logs([path], read_mapping(CONFIG / "import/iver2.yaml"))[0]


def test_the_water_learnt_with_gps_holds_the_position_without(log) -> None:
    moving = withhold(log, [CONFIG / "iver2.yaml"], {})
    still = withhold(log, [CONFIG / "iver2.yaml"], STILL_WATER)
    # 149 s of fixes, 60 % withheld; they are 0.7 s older than their rows.
    assert moving.seconds == pytest.approx(0.6 * 149.0, abs=1.0)
    # Sudden turns cost the model seconds of wrong heading, the same for both; the current is 0.11 m/s for 90 s: 10 m.
    assert np.hypot(*(moving.water - WATER)) < 0.05
    assert moving.final < 0.5 * still.final
    assert np.all(still.water_sigma < 1e-3)


def test_the_distance_is_that_of_the_fixes_withheld(log) -> None:
    found = withhold(log, [CONFIG / "iver2.yaml"], {})
    # over ground 1.145 m/s east, 0.945 m/s west; less what is cut off at three turns, at samples 5 s apart
    assert found.distance == pytest.approx(89.0 * SPEED, rel=0.08)


def test_a_log_with_too_few_fixes_is_refused(log) -> None:
    few = [item for item in log if item[1] != "gps/fix"][:10]
    with pytest.raises(RunError, match="0 good fixes are too few"):
        withhold(few, [], {})


def test_a_share_that_leaves_nothing_is_refused(log) -> None:
    with pytest.raises(RunError, match="between 0 and 1"):
        withhold(log, [], {}, share=1.0)
