"""A small run with errors known in closed form: straight dives over a field, no noise unless asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import yaml

from fbn_bringup.cli import main
from fbn_bringup.evaluation.run import Item
from fbn_bringup.evaluation.truth import TrueFeature, Truth
from fbn_bringup.simulation import simulate_to_bag
from fbn_common import records as r
from fbn_common.types import NS, Array
from fbn_ros.bag import BagWriter

START_NS = 1_000 * NS
DATUM = (42.358, -71.09, 0.0)
PRIOR_SIGMA = 5.0  # m
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Story:
    """What is true of the run, and how wrong each estimate is."""

    dives: int = 3
    dive_s: int = 120
    surface_s: int = 60
    speed: float = 0.8  # m/s, to the east
    depth: float = 2.0  # m
    drift: tuple[float, float] = (0.02, 0.01)  # m/s, error of dead reckoning's velocity
    reference_error: tuple[float, float] = (1.0, 0.5)  # m
    map_shift: tuple[float, float] = (3.0, -4.0)  # m, prior map less true features
    on_map: tuple[float, float] = (0.3, 0.4)  # m, vehicle less features, once matched
    wrong_pairs: int = 0  # of four pairs in each dive
    noise: float = 0.0  # m, on estimates; for pictures

    @property
    def leg_s(self) -> int:
        return self.dive_s + self.surface_s

    @property
    def total_s(self) -> int:
        return self.dives * self.leg_s + self.surface_s

    def diving(self, t: float) -> bool:
        """Under water: the second part of each leg."""
        return t < self.dives * self.leg_s and t % self.leg_s >= self.surface_s

    def position(self, t: float) -> Array:
        """True position (3,) [m] at t [s]."""
        return np.array([self.speed * t, 0.0, -self.depth if self.diving(t) else 0.0])

    def features(self) -> tuple[TrueFeature, ...]:
        """Four features beside every dive."""
        return tuple(
            TrueFeature(
                4 * d + i,
                np.array([self.speed * (d * self.leg_s + self.surface_s + 20.0 * (i + 1)), 8.0, -5.0]),
                100 + 4 * d + i,
                d == 0 and i == 0,
            )
            for d in range(self.dives)
            for i in range(4)
        )


@pytest.fixture
def story() -> type[Story]:
    return Story


@pytest.fixture
def tell():
    return items_of


@pytest.fixture
def truth_of():
    return lambda s: Truth(DATUM, s.features())


def items_of(s: Story, seed: int = 0) -> list[Item]:
    """All messages of the run in log order."""
    rng, items = np.random.default_rng(seed), []

    def say(topic: str, record: r.Record, delay_s: float = 0.0) -> None:
        items.append((record.stamp_ns + round(delay_s * NS), topic, record))

    say("reference/datum", r.Datum(START_NS, "map", *DATUM))
    say("global/map", _map(s, START_NS, np.array([*s.map_shift, 0.0])))
    for i in range(s.total_s * 5):
        t, stamp = i / 5, START_NS + i * NS // 5
        _poses(s, t, stamp, rng, say)
        if i % 5 == 0:
            _sensors(s, t, stamp, rng, say)
            _innovations(s, t, stamp, rng, say)
            _tracking(s, t, stamp, say)
    items.sort(key=lambda item: item[0])
    return items


def _poses(s: Story, t: float, stamp: int, rng: np.random.Generator, say) -> None:
    p, n = s.position(t), s.noise * rng.standard_normal(6)
    shift = np.array([*s.map_shift, 0.0]) + np.array([*s.on_map, 0.0])
    say("truth/odometry", _odometry(stamp, "map", p, 1e-4))
    say("deadreck/odometry", _odometry(stamp, "odom", p + t * np.array([*s.drift, 0.0]), 0.01 + (0.03 * t) ** 2))
    say(
        "reference/odometry",
        _odometry(stamp, "map", p + np.array([*s.reference_error, 0.0]) + np.array([n[0], n[1], 0.0]), 1.0),
    )
    matched = t >= s.surface_s + 60
    say("global/odometry", _odometry(stamp, "map", p + (shift if matched else [*s.reference_error, 0.0]), 2.0))


def _sensors(s: Story, t: float, stamp: int, rng: np.random.Generator, say) -> None:
    p = s.position(t)
    say("altitude", r.Range(stamp, "altimeter_link", 0, 0.1, 0.3, 50.0, 5.0 + p[2]), 0.05)
    if not s.diving(t):
        latitude = DATUM[0] + p[1] / 111_081.0
        longitude = DATUM[1] + p[0] / (111_320.0 * np.cos(np.radians(DATUM[0])))
        say("gps/fix", r.NavSatFix(stamp, "gps", 0, latitude, longitude, 0.0, np.eye(3), 2), 0.2)


def _innovations(s: Story, t: float, stamp: int, rng: np.random.Generator, say) -> None:
    for node, sensor, dof in (("deadreck", "compass", 3), ("deadreck", "depth", 1), ("reference", "gps", 2)):
        if sensor == "gps" and s.diving(t):
            continue
        z = rng.standard_normal(dof)
        gated = rng.random() < 0.02
        nis = float(z @ z) * (25.0 if gated else 1.0)
        verdict, reason = (r.Verdict.GATED, "outside its gate") if gated else (r.Verdict.USED, "")
        say(f"{node}/innovations", r.Innovation(stamp, "base_link", sensor, nis, dof, verdict, reason, z, np.ones(dof)))


def _tracking(s: Story, t: float, stamp: int, say) -> None:
    d, at = int(t // s.leg_s), t % s.leg_s - s.surface_s
    if not s.diving(t) or at % 20 != 10 or at < 30:
        return
    seen = [f for f in s.features() if f.id // 4 == d and f.position[0] <= s.position(t)[0] + 16.0]
    odom = t * np.array([*s.drift, 0.0])
    tracked = tuple(
        r.TrackedFeature(f.id, r.Stage.FEATURE, 9, stamp - 9 * NS, stamp, f.position + odom, 0.04 * np.eye(3))
        for f in seen
    )
    say("tracking/features", r.TrackedFeatures(stamp, "odom", int(t), tracked))
    say("tracking/composite", _composite(stamp, [f.id for f in seen]))
    if at >= 50 and t >= s.surface_s + 60:
        _global(s, t, stamp, [f.id for f in seen], say)


def _global(s: Story, t: float, stamp: int, keys: list[int], say) -> None:
    wrong = min(s.wrong_pairs, len(keys))
    ids = tuple(100 + (k + (1 if i < wrong else 0)) for i, k in enumerate(keys))
    shift = np.array([*s.map_shift, 0.0])
    p = s.position(t) + shift + [*s.on_map, 0.0]
    best = r.MatchHypothesis(1, 0, 8.0, 0.98, 10.0, -2.0, ids, tuple(keys), r.Pose(p, LEVEL), np.eye(6))
    null = r.MatchHypothesis(0, 0, 0.0, 0.02, 0.0, 0.0, (), (), r.Pose(p, LEVEL), np.eye(6))
    target = s.features()[0]
    body = target.position - s.position(t) - [*s.on_map, 0.0]
    say("global/map", _map(s, stamp, shift))
    say("global/hypotheses", r.MatchHypotheses(stamp, "map", (best, null)))
    say("global/pose", r.PoseWithCovarianceStamped(stamp, "map", r.Pose(p, LEVEL), 0.25 * np.eye(6)))
    say(
        "global/status",
        r.LocalizationStatus(
            stamp,
            "map",
            True,
            r.Localization.MATCHED,
            0.98,
            len(ids),
            100,
            float(np.hypot(body[0], body[1])),
            0.0,
            0.0,
            "posterior over the threshold",
            target.position + shift,
            np.eye(3),
            body,
            0.25 * np.eye(3),
        ),
    )


def _map(s: Story, stamp: int, shift: Array) -> r.FeatureMap:
    features = tuple(
        r.MapFeature(f.map_id, f"r{f.id}", True, 0.98, 0.67, f.target, f.position + shift) for f in s.features()
    )
    covariance = np.kron(np.eye(len(features)) * 4.0 + 21.0, np.eye(3))
    return r.FeatureMap(stamp, "map", *DATUM, features, covariance)


def _composite(stamp: int, keys: list[int]) -> r.CompositeMeasurement:
    features = tuple(r.CompositeFeature(k, 9, 12.0, stamp - 9 * NS, stamp) for k in keys)
    n = 13 + 3 * len(keys)
    swept = r.SweptArea(2.0, 2, 2, np.zeros(2), np.ones(4))
    return r.CompositeMeasurement(
        stamp,
        "odom",
        1,
        stamp - 10 * NS,
        False,
        10,
        8.0,
        300.0,
        features,
        swept,
        np.zeros(n),
        np.eye(n),
        np.zeros(7),
        np.eye(7),
    )


def _odometry(stamp: int, frame: str, position: Array, variance: float) -> r.Odometry:
    covariance = np.diag([variance, variance, 0.0025, 1e-4, 1e-4, 1e-3])
    return r.Odometry(
        stamp, frame, "base_link", r.Pose(position, LEVEL), np.array([0.8, 0, 0, 0, 0, 0]), covariance, np.eye(6)
    )


@pytest.fixture
def fbn(monkeypatch, capsys):
    """The command line, called as from a shell: gives exit status, output and messages."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["fbn", *map(str, arguments)])
        try:
            main()
            status = 0
        except SystemExit as end:
            status = int(end.code or 0)
        heard = capsys.readouterr()
        return status, heard.out, heard.err

    return call


@pytest.fixture(scope="session")
def story_bag(tmp_path_factory) -> Path:
    """The story as a bag with its truth beside it."""
    s, place = Story(), tmp_path_factory.mktemp("story") / "bag"
    with BagWriter(place) as bag:
        for item in items_of(s):
            bag.write(*item)
    features = [
        {"id": f.id, "map_id": f.map_id, "target": f.target, "position": f.position.tolist()} for f in s.features()
    ]
    datum = dict(zip(("latitude", "longitude", "height"), DATUM, strict=True))
    (place / "truth.yaml").write_text(yaml.safe_dump({"datum": datum, "features": features}))
    return place


@pytest.fixture(scope="session")
def short_scenario(tmp_path_factory) -> Path:
    """The river's scenario, cut after the first minute and a half."""
    text = resources.files("fbn_sim").joinpath("data", "scenarios", "charles_river_2006.yaml").read_text()
    document = yaml.safe_load(text)
    document["mission"]["limit"] = 100.0
    path = tmp_path_factory.mktemp("scenario") / "short.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture(scope="session")
def short_bag(short_scenario, tmp_path_factory) -> Path:
    """That scenario as a bag."""
    return simulate_to_bag(str(short_scenario), tmp_path_factory.mktemp("log") / "short", 1000)
