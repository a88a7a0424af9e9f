"""Logs and graphs that the tests of the whole share; everything that speaks DDS does so on a domain of its own."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fbn_bringup.configuration import Parameters, load_parameters
from fbn_bringup.offline import replay_offline
from fbn_bringup.rundir import ReplayOptions
from fbn_common.graph import GRAPH
from fbn_common.types import nanoseconds
from fbn_ros.bag import BagReader, BagWriter
from fbn_testing.harness import private_domain
from fbn_testing.logs import write_sensor_log

ROOT = Path(__file__).resolve().parents[1]
RIVER = ROOT / "bags" / "charles_river_2006"
RIVER_S = 45.0  # s of the mission: on the surface and into the first dive, some dozens of pings


@pytest.fixture(scope="session")
def domain() -> Iterator[int]:
    """A DDS domain for this session."""
    with private_domain() as chosen:
        yield chosen


@pytest.fixture(autouse=True)
def _quiet_logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))


@pytest.fixture(scope="session")
def river(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The beginning of the sample mission, with its map and parameters beside it."""
    target = tmp_path_factory.mktemp("river") / "bag"
    with BagReader(RIVER) as source, BagWriter(target) as cut:
        for log_time_ns, topic, data in source.raw():
            if log_time_ns - source.start_ns < nanoseconds(RIVER_S):
                cut.copy(log_time_ns, topic, data, source)
    for name in ("prior_map.geojson", "parameters.yaml"):
        if (RIVER / name).exists():
            shutil.copy(RIVER / name, target / name)
    return target


@pytest.fixture(scope="session")
def river_options(river: Path) -> ReplayOptions:
    """The real graph with the river's map."""
    files = tuple(f for f in [river / "parameters.yaml"] if f.exists())
    return ReplayOptions(files, {"global.map_file": str(river / "prior_map.geojson")})


@pytest.fixture(scope="session")
def river_parameters(river_options: ReplayOptions) -> Parameters:
    """Every node's parameters for the river."""
    return load_parameters(GRAPH, river_options.parameter_files, river_options.overrides)


@pytest.fixture(scope="session")
def river_log(river: Path) -> list[Any]:
    """The river's sensor messages as (log time, topic, record)."""
    with BagReader(river) as reader:
        return list(reader.records(GRAPH.external_inputs()))


@pytest.fixture(scope="session")
def river_run(river: Path, river_options: ReplayOptions, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The river replayed in one process."""
    run = tmp_path_factory.mktemp("river_run") / "run"
    replay_offline(river, run, river_options)
    return run


@pytest.fixture(scope="session")
def sensor_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve seconds of made-up sensors."""
    return write_sensor_log(tmp_path_factory.mktemp("sensors") / "bag", 12.0)
