"""How often the global filter matches rightly, wrongly or not at all, over many drawn worlds.

python -m fbn_testing.matching_study row_ambiguity --seeds 100
python -m fbn_testing.matching_study charles_river --seeds 100
python -m fbn_testing.matching_study other_place --seeds 100
python -m fbn_testing.matching_study size
python -m fbn_testing.matching_study jcbb
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from fbn_common.records import Localization, LocalizationStatus, MatchHypotheses
from fbn_common.types import Array
from fbn_global.estimator import Global
from fbn_global.jcbb import jcbb
from fbn_global.parameters import GlobalParameters
from fbn_testing.composite_world import Run, Settings, World, charles_river
from fbn_testing.plain_jcbb import PlainJcbb, crossing


@dataclass
class Outcome:
    """One run: the verdict at its end, whether ever declared wrong, and every posterior with its truth."""

    verdict: Localization = Localization.UNMATCHED
    right: bool = False
    wrong_ever: bool = False
    matched_ever: bool = False
    errors: list[float] = field(default_factory=list)
    calibration: list[tuple[float, bool]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def play(run: Run, parameters: GlobalParameters) -> Outcome:
    """Feed a run to the filter and judge each verdict by the true identities."""
    estimator, outcome = Global(parameters, run.prior), Outcome()
    positions = {f.id: p for f, p in zip(run.prior.features, run.prior.positions(run.datum), strict=True)}
    hypotheses: MatchHypotheses | None = None
    for topic, record in run.entries:
        estimator.put(topic, record)
        began = time.thread_time()
        outputs = estimator.advance(record.stamp_ns)
        if topic == "tracking/composite":
            outcome.seconds.append(time.thread_time() - began)
        for output in outputs:
            if isinstance(output.record, MatchHypotheses):
                hypotheses = output.record
                _calibrate(outcome, hypotheses, run)
            if isinstance(output.record, LocalizationStatus) and hypotheses is not None:
                _judge(outcome, output.record, hypotheses, run, positions)
    return outcome


def is_right(hypotheses: MatchHypotheses, index: int, run: Run) -> bool:
    """Whether most pairs of a hypothesis are true."""
    h = hypotheses.hypotheses[index]
    true = [run.key_feature.get(k) == m for m, k in zip(h.map_ids, h.feature_keys, strict=True)]
    return bool(true) and sum(true) > len(true) / 2


def _calibrate(outcome: Outcome, hypotheses: MatchHypotheses, run: Run) -> None:
    for k, h in enumerate(hypotheses.hypotheses):
        if h.map_ids:
            outcome.calibration.append((h.posterior, is_right(hypotheses, k, run)))


def _judge(
    outcome: Outcome, s: LocalizationStatus, hypotheses: MatchHypotheses, run: Run, positions: dict[int, Array]
) -> None:
    outcome.verdict = s.state
    outcome.right = False
    if s.matched:
        best = next(k for k, h in enumerate(hypotheses.hypotheses) if h.map_ids)
        outcome.right = is_right(hypotheses, best, run)
        outcome.matched_ever = True
        outcome.wrong_ever |= not outcome.right


def grid(columns: int, rows: int, scatter: float, seed: int) -> Array:
    """Like features (n, 3) 20 m apart."""
    rng = np.random.default_rng(seed + 20_000)
    xy = np.array([(20.0 * i, 20.0 * j) for j in range(rows) for i in range(columns)])
    return np.column_stack([xy + scatter * rng.standard_normal(xy.shape), np.full(len(xy), -4.0)])


def rows_world(seed: int, offset: float, observed: int) -> Settings:
    """Into a grid along its rows, until about so many columns were passed; the map lies off along the rows."""
    length = 20.0 * (observed - 1)
    return Settings(
        grid(8, 3, 0.3, seed), ((-60.0, 10.0), (length - 30.0, 10.0)), seed=seed,
        map_error=0.5, map_shift=(-offset, 0.0), fix_sigma=1.0, drift_sigma=0.03,
    )  # fmt: skip


def river_world(seed: int, **changes: object) -> Settings:
    legs = ((-40.0, 5.0), (80.0, 5.0), (80.0, 35.0), (0.0, 35.0), (0.0, 20.0), (80.0, 20.0))
    return replace(Settings(charles_river(seed), legs, seed=seed), **changes)  # type: ignore[arg-type]


def elsewhere(seed: int) -> Run:
    """A run in one field with the map of another."""
    run = World(river_world(seed)).make()
    rng = np.random.default_rng(seed + 30_000)
    other = np.column_stack([rng.uniform(-10, 90, 12), rng.uniform(-10, 50, 12), np.full(12, -4.0)])
    run.prior = World(river_world(seed, features=other)).run.prior
    run.key_feature = dict.fromkeys(run.key_feature, -1)
    return run


def summary(outcomes: list[Outcome]) -> str:
    """Rates at the end of the runs, and how often a wrong match was ever declared."""
    n = len(outcomes)
    matched = [o for o in outcomes if o.verdict is Localization.MATCHED]
    right = sum(o.right for o in matched) / n
    wrong = sum(not o.right for o in matched) / n
    ever = sum(o.wrong_ever for o in outcomes) / n
    slow = max(max(o.seconds) for o in outcomes)
    rates = f"right {right:6.1%}  wrong {wrong:6.1%}  undecided {1 - right - wrong:6.1%}  wrong ever {ever:6.1%}"
    return f"{rates}  slowest {slow:.3f} s"


def reliability(outcomes: list[Outcome]) -> Iterator[str]:
    """Of all hypotheses with a posterior in a bin: how many were right."""
    pairs = [p for o in outcomes for p in o.calibration]
    for low, high in ((0.01, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.01)):
        inside = [right for posterior, right in pairs if low <= posterior < high]
        if inside:
            mean = np.mean([posterior for posterior, _ in pairs if low <= posterior < high])
            stated = f"  posterior {low:4.2f}-{min(high, 1.0):4.2f}: stated {mean:.3f}"
            yield f"{stated}  right {np.mean(inside):.3f}  of {len(inside)}"


def _row_ambiguity(seeds: range, methods: list[str]) -> None:
    for observed in (3, 5):
        for offset in (5.0, 8.0, 12.0):
            runs = [World(rows_world(seed, offset, observed)).make() for seed in seeds]
            for method in methods:
                outcomes = [play(run, GlobalParameters(method=method)) for run in runs]
                print(f"observed {observed} offset {offset:4.0f} m {method:5s} {summary(outcomes)}", flush=True)
                if method == "NAPS":
                    print("\n".join(reliability(outcomes)), flush=True)


def _each(make: Callable[[int], Run]) -> Callable[[range, list[str]], None]:
    def study(seeds: range, methods: list[str]) -> None:
        runs = [make(seed) for seed in seeds]
        for method in methods:
            outcomes = [play(run, GlobalParameters(method=method)) for run in runs]
            print(f"{method:5s} {summary(outcomes)}", flush=True)
            print("\n".join(reliability(outcomes)), flush=True)

    return study


def _size(seeds: range, methods: list[str]) -> None:
    """Time of an update against the size of the map, the density of features staying the same."""
    for count in (12, 100, 1000, 5000):
        rng = np.random.default_rng(seeds[0])
        side = 20.0 * np.sqrt(count)
        features = np.column_stack([rng.uniform(-side / 2, side / 2, (count, 2)), np.full(count, -4.0)])
        settings = Settings(features, ((-80.0, 0.0), (80.0, 0.0), (80.0, 30.0), (-80.0, 30.0)), seed=seeds[0])
        outcome = play(World(settings).make(), GlobalParameters())
        print(
            f"{count:5d} features: median {np.median(outcome.seconds):.3f} s, slowest {max(outcome.seconds):.3f} s",
            flush=True,
        )


def _jcbb(seeds: range, methods: list[str]) -> None:
    """Time of the compiled branch and bound against the plain one, ten found features."""
    noise = 0.25 * np.eye(2)
    for maps in (20, 100, 1000):
        for sigma in (1.0, 3.0, 5.0):
            compiled, plain, nodes = [], [], []
            for seed in seeds:
                x, p, gate = crossing(seed, 10, maps, sigma)
                began = time.thread_time()
                result = jcbb(x, p, 10, gate, noise, 2, 1_000_000)
                compiled.append(time.thread_time() - began)
                search = PlainJcbb(x, p, 10, gate, noise, 2)
                began = time.thread_time()
                search.search([], 0, 0.0)
                plain.append(time.thread_time() - began)
                nodes.append(result.nodes)
                assert list(result.assigned) == search.best
            ms, ratio = 1e3 * np.median(compiled), np.median(np.array(plain) / np.maximum(compiled, 1e-7))
            where = f"map {maps:4d} sigma {sigma:3.0f} m: nodes {np.median(nodes):6.0f}"
            print(f"{where}  {ms:.3f} ms  plain {ratio:.0f} times", flush=True)


STUDIES: dict[str, Callable[[range, list[str]], None]] = {
    "row_ambiguity": _row_ambiguity,
    "charles_river": _each(lambda seed: World(river_world(seed)).make()),
    "imperfect_map": _each(lambda seed: World(river_world(seed, missing=0.2, surplus=0.2)).make()),
    "shifted_map": _each(lambda seed: World(river_world(seed, map_error=1.0, map_shift=(12.0, 9.0))).make()),
    "other_place": _each(elsewhere),
    "size": _size,
    "jcbb": _jcbb,
}


def main() -> None:
    """Run one study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--methods", default="NAPS")
    arguments = parser.parse_args()
    STUDIES[arguments.study](range(arguments.first, arguments.first + arguments.seeds), arguments.methods.split(","))


if __name__ == "__main__":
    main()
