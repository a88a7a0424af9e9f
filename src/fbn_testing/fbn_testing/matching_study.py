"""How often the global filter matches rightly, wrongly or not at all, over many drawn worlds.

python -m fbn_testing.matching_study row_ambiguity --seeds 100 --methods NAPS,POS,JCBB
python -m fbn_testing.matching_study charles_river --seeds 100
python -m fbn_testing.matching_study imperfect_map --seeds 100
python -m fbn_testing.matching_study shifted_map --seeds 100
python -m fbn_testing.matching_study other_place --seeds 100
python -m fbn_testing.matching_study calibration --seeds 400 --figure reliability.png
python -m fbn_testing.matching_study even_odds --seeds 100 --figure reliability.png
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fbn_bringup.evaluation import calibration
from fbn_common.records import Localization
from fbn_global.parameters import METHODS, GlobalParameters
from fbn_testing import ideal_observer
from fbn_testing.composite_world import Run, World
from fbn_testing.matching_play import Outcome, play
from fbn_testing.matching_worlds import drawn, elsewhere, river_world, rows_world
from fbn_testing.seeds import How, add_options, run_seeds

Make = Callable[[int], Run]


@dataclass(frozen=True, slots=True)
class Options:
    """What is asked for."""

    seeds: range
    methods: tuple[str, ...]
    how: How
    figure: Path | None


@dataclass(frozen=True, slots=True)
class Played:
    """One seed: an outcome by method, and whether the ideal observer's match would be right; None: undecided."""

    outcomes: dict[str, Outcome]
    ideal: bool | None = None


def play_world(make: Make, methods: tuple[str, ...], seed: int) -> Played:
    """One seed of a world without rows."""
    run = make(seed)
    return Played({method: play(run, GlobalParameters(method=method)) for method in methods})


def play_rows(offset: float, observed: int, methods: tuple[str, ...], seed: int) -> Played:
    """One seed of ambiguous rows, beside the ideal observer."""
    settings = rows_world(seed, offset, observed)
    run = World(settings).make()
    belief = ideal_observer.believe(settings, run, GlobalParameters())
    outcomes = {method: play(run, GlobalParameters(method=method)) for method in methods}
    return Played(outcomes, belief.verdict(GlobalParameters().verdict))


def summary(outcomes: list[Outcome]) -> str:
    """Rates at the end of the runs, a wrong match ever declared, the likeliest place the right one; slowest update."""
    n = len(outcomes)
    matched = [o for o in outcomes if o.verdict is Localization.MATCHED]
    right = sum(o.right for o in matched) / n
    wrong = sum(not o.right for o in matched) / n
    ever = sum(o.wrong_ever for o in outcomes) / n
    slow = max(max(o.seconds) for o in outcomes)
    rates = f"right {right:6.1%}  wrong {wrong:6.1%}  undecided {(n - len(matched)) / n:6.1%}  wrong ever {ever:6.1%}"
    favoured = sum(o.favours_truth for o in outcomes) / n
    return f"{rates}  likeliest is right {favoured:6.1%}  slowest {slow:.3f} s"


def decided(played: list[Played], method: str) -> str:
    """What this method did of the runs that the ideal observer decides rightly, and of all others."""
    can, cannot = [p for p in played if p.ideal], [p for p in played if not p.ideal]
    right = sum(p.outcomes[method].right for p in can)
    wrong = sum(p.outcomes[method].wrong_ever for p in cannot)
    return f"  right {right} of {len(can)} decidable, wrong {wrong} of the {len(cannot)} others"


def ideal(played: list[Played]) -> str:
    """What the ideal observer declares."""
    shares = [sum(p.ideal is answer for p in played) / len(played) for answer in (True, False, None)]
    return "right {:6.1%}  wrong {:6.1%}  undecided {:6.1%}".format(*shares)


def show(played: list[Played], o: Options) -> None:
    """Rates by method, and the reliability of NAPS."""
    for method in o.methods:
        print(f"{method:5s} {summary([p.outcomes[method] for p in played])}")
    if "NAPS" in o.methods:
        print("\n".join(calibration.table(stated(played))), flush=True)


def stated(played: list[Played], method: str = "NAPS") -> calibration.Stated:
    """All posteriors of all runs, with their truth."""
    return [pair for p in played for pair in p.outcomes[method].calibration]


def row_ambiguity(o: Options) -> None:
    """A table over offsets, numbers observed and methods."""
    for observed in (3, 5):
        for offset in (5.0, 8.0, 12.0):
            where = f"columns {observed} offset {offset:4.0f} m"
            played = run_seeds(partial(play_rows, offset, observed, o.methods), o.seeds, where, o.how)
            print(f"{where} ideal {ideal(played)}")
            for method in o.methods:
                rates = summary([p.outcomes[method] for p in played])
                print(f"{where} {method:5s} {rates}{decided(played, method)}", flush=True)


def worlds(make: Make, o: Options) -> None:
    """Rates of each method in one kind of world."""
    show(run_seeds(partial(play_world, make, o.methods), o.seeds, "worlds", o.how), o)


def calibrate(make: Make, o: Options) -> None:
    """Of all the times that a posterior is stated, how often it is right; the map's error is drawn as it is stated."""
    played = run_seeds(partial(play_world, make, o.methods), o.seeds, "worlds", o.how)
    show(played, o)
    for method in o.methods:
        print(f"{method:5s} expected calibration error {calibration.expected_error(stated(played, method)):.3f}")
    if o.figure:
        calibration.diagram(o.figure, {method: stated(played, method) for method in o.methods})


def river(seed: int) -> Run:
    """The river's field and its map, 5 m off."""
    return World(river_world(seed)).make()


def imperfect(seed: int) -> Run:
    """A map that lacks a fifth of the features and has a fifth that are not there."""
    return World(river_world(seed, missing=0.2, surplus=0.2)).make()


def shifted(seed: int) -> Run:
    """A map 15 m off as a whole, three times what it states."""
    return World(river_world(seed, map_error=1.0, map_shift=(12.0, 9.0))).make()


def even_odds(seed: int) -> Run:
    """As the filter's prior has it: every other map is that of another place; of the rest a fifth is wrong."""
    return elsewhere(seed) if seed % 2 else imperfect(seed)


STUDIES: dict[str, Callable[[Options], None]] = {
    "row_ambiguity": row_ambiguity,
    "charles_river": partial(worlds, river),
    "imperfect_map": partial(worlds, imperfect),
    "shifted_map": partial(worlds, shifted),
    "other_place": partial(worlds, elsewhere),
    "calibration": partial(calibrate, drawn),
    "even_odds": partial(calibrate, even_odds),
}


def main() -> None:
    """Run one study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, default=20, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--methods", default="NAPS", help=f"of {','.join(METHODS)}")
    add_options(parser)
    parser.add_argument("--figure", type=Path, help="reliability diagram (PNG), of calibration, even_odds")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    STUDIES[given.study](Options(seeds, tuple(given.methods.split(",")), How(given.jobs, given.keep), given.figure))


if __name__ == "__main__":
    main()
