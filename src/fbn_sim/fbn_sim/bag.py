"""A simulated mission as a rosbag2 directory, with its prior map and what is true of the features beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from fbn_common.prior_map import write_prior_map
from fbn_ros.bag import BagWriter
from fbn_sim.simulation import Simulation

MAP_FILE, TRUTH_FILE = "prior_map.geojson", "truth.yaml"


def write_bag(simulation: Simulation, path: Path, progress: Callable[[float], None] = lambda fraction: None) -> Path:
    """Write the mission's log to a new directory ``path``, with ``prior_map.geojson`` and ``truth.yaml`` in it.

    ``progress`` is told the fraction done now and then.  Raises ``fbn_ros.bag.BagError`` if it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    total = len(simulation.entries)
    with BagWriter(path) as bag:
        for i, (log_time_ns, topic, record) in enumerate(simulation.records()):
            bag.write(log_time_ns, topic, record)
            if i % 2000 == 0:
                progress(i / total)
    write_prior_map(path / MAP_FILE, simulation.prior_map)
    (path / TRUTH_FILE).write_text(yaml.safe_dump(truth_document(simulation), sort_keys=False), encoding="utf-8")
    progress(1.0)
    return path


def truth_document(simulation: Simulation) -> dict[str, Any]:
    """Datum, features and dives as they truly were: plain values for YAML; positions are ENU about the datum [m]."""
    datum = simulation.scenario.world.datum
    true, mapped = simulation.truth.features, {f.id for f in simulation.prior_map.features}
    return {
        "scenario": simulation.scenario.name,
        "seed": simulation.seed,
        "datum": {"latitude": datum.latitude, "longitude": datum.longitude, "height": datum.height},
        "features": [
            {
                "id": i,
                "name": name,
                "position": [round(float(c), 4) for c in position],
                "map_id": i if i in mapped else None,
                "target": name == simulation.scenario.world.target,
            }
            for i, name, position in zip(true.ids, true.names, true.positions, strict=True)
        ],
        "dives": [{"start_ns": d.start_ns, "end_ns": d.end_ns} for d in simulation.dives],
    }
