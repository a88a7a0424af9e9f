"""The main scenario over seeds that nothing was tuned on."""

from __future__ import annotations

import numpy as np
import pytest

from fbn_bringup.campaign import Plan, run_campaign


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
