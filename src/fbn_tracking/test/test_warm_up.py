"""A node that has started has compiled everything, and has been through a cut."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

from synthetic_world import World, corridor, simulate

from fbn_common.types import NS
from fbn_tracking.estimator import Tracking
from fbn_tracking.rehearsal import rehearsal

# The run is made by another process: making it calls kernels that the tracker calls too.
A_FIRST_MINUTE = """
import pickle, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from synthetic_world import play
from fbn_tracking.estimator import Tracking

def signatures():
    ours = [m for name, m in sys.modules.items() if name.startswith(("fbn_tracking", "fbn_common"))]
    kernels = [f for m in ours for f in vars(m).values() if hasattr(f, "signatures")]
    return {f"{f.__module__}.{f.__name__}": len(f.signatures) for f in kernels}

tracker, run = Tracking(), pickle.loads(Path(sys.argv[2]).read_bytes())
before = signatures()
composites = [o for o in play(tracker, run) if o.topic == "tracking/composite"]
print([name for name, count in signatures().items() if count > before.get(name, 0)], len(before) > 20, len(composites))
"""


def test_nothing_is_compiled_in_a_first_minute(tmp_path):
    run = tmp_path / "run.pickle"
    run.write_bytes(pickle.dumps(simulate(World(corridor(8), clutter=3.0, period=0.5), 120, 1017)))
    arguments = [sys.executable, "-c", A_FIRST_MINUTE, str(Path(__file__).parent), str(run)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    compiled, looked_at_all, composites = done.stdout.rsplit(maxsplit=2)
    assert (compiled, looked_at_all) == ("[]", "True") and int(composites) > 1


def test_the_rehearsal_graduates_a_target_and_makes_a_composite_of_it():
    tracker, outputs = Tracking(), []
    for number, records in enumerate(rehearsal(tracker.parameters.arrays)):
        for record in records:
            tracker.put("", record)
        outputs += tracker.advance(number * NS)
    (composite,) = [o.record for o in outputs if o.topic == "tracking/composite"]
    assert composite.features
    assert tracker.health().values.get("smoother_failures", 0) == 0


def test_a_new_tracker_remembers_nothing_of_its_rehearsal(monkeypatch):
    monkeypatch.setattr(Tracking, "_rehearsed", True)
    without = Tracking()
    monkeypatch.setattr(Tracking, "_rehearsed", False)
    tracker = Tracking()
    assert tracker.window is None and tracker.health() == without.health()
    assert tracker.advance(-NS) == []  # no clock has been seen yet
