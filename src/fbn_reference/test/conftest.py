"""The motion half run over arrivals, and a voyage of the twin."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from fbn_common.estimator import Output
from fbn_common.motion_ekf.lockstep import run
from fbn_deadreck.estimator import Deadreck
from fbn_deadreck.parameters import DeadreckParameters
from fbn_predict.estimator import Predict
from fbn_predict.parameters import PredictParameters
from fbn_predict.twin import Arrivals, Twin, sail
from fbn_reference.estimator import Reference
from fbn_reference.parameters import ReferenceParameters


def _sailed(arrivals: Arrivals, parameters: ReferenceParameters | None = None) -> tuple[list[Output], Reference]:
    reference = Reference(parameters or ReferenceParameters())
    nodes = {
        "fbn_predict": Predict(PredictParameters()),
        "fbn_deadreck": Deadreck(DeadreckParameters()),
        "fbn_reference": reference,
    }
    return run(nodes, arrivals), reference


@pytest.fixture(scope="session")
def sailed() -> Callable[..., tuple[list[Output], Reference]]:
    """Predict, dead reckoning and reference run over arrivals: outputs, and the last."""
    return _sailed


@pytest.fixture(scope="session")
def surfaced() -> Twin:
    """A voyage near the surface."""
    return sail(PredictParameters(), 100.0, 1003, depth=0.7)
