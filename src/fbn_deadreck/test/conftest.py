"""A voyage of the twin and what dead reckoning makes of it, computed once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fbn_common.estimator import Output
from fbn_common.motion_ekf.lockstep import run
from fbn_deadreck.estimator import Deadreck
from fbn_deadreck.parameters import DeadreckParameters
from fbn_predict.estimator import Predict
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import START_NS, Arrivals, Twin, on_time, sail


def _sailed(arrivals: Arrivals, **changes: object) -> tuple[list[Output], Deadreck]:
    """Outputs of predict and dead reckoning, and the latter."""
    deadreck = Deadreck(DeadreckParameters(**changes))  # type: ignore[arg-type]
    outputs = run({"fbn_predict": Predict(PredictParameters()), "fbn_deadreck": deadreck}, arrivals)
    return outputs, deadreck


@pytest.fixture(scope="session")
def twin() -> Twin:
    return sail(PredictParameters(), 90.0, 1001)


@pytest.fixture(scope="session")
def voyage(twin: Twin) -> tuple[list[Output], Deadreck]:
    return _sailed(on_time(twin))


@pytest.fixture(scope="session")
def late() -> Callable[[Twin, int, float], Arrivals]:
    """Records that arrive late, each by its own random time."""

    def delayed(twin: Twin, seed: int, most_s: float) -> Arrivals:
        rng = np.random.default_rng(seed)
        arrivals = [
            (t + int(rng.uniform(0.0, most_s) * 1e9), topic, r) for t, topic, r in on_time(twin) if t > START_NS + 5e9
        ]
        early = [a for a in on_time(twin) if a[0] <= START_NS + 5e9]
        return sorted(early + arrivals, key=lambda a: a[0])

    return delayed


@pytest.fixture(scope="session")
def sailed() -> Callable[..., tuple[list[Output], Deadreck]]:
    """Predict and dead reckoning run over arrivals: outputs, and the latter."""
    return _sailed
