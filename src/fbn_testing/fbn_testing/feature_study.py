"""What the tracker finds, where, and how sure of it: over many simulated missions, by the truth.

python -m fbn_testing.feature_study depth_of_features --seeds 0:50 --figure depth.png --story story.png
python -m fbn_testing.feature_study any_height --seeds 0:50 --jobs 2 --keep heights
python -m fbn_testing.feature_study changing_depth --seeds 0:50
python -m fbn_testing.feature_study charles_river_2006 --seeds 0:50
python -m fbn_testing.feature_study clutter --seeds 0:50
python -m fbn_testing.feature_study doppler_log --seeds 0:50
python -m fbn_testing.feature_study causes --seeds 1000:1010

A seed takes some 10 s of one core on ``depth_of_features``, 30 s on ``charles_river_2006``.  Values of one mission
share their heading's error: the band of a mean is that of as many independent values as there are seeds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from fbn_common import chi_square
from fbn_common.types import Array
from fbn_testing.feature_figures import Section, draw_sections
from fbn_testing.feature_judge import Verdict, judge
from fbn_testing.feature_runs import Heard, Outcome, hear, track
from fbn_testing.feature_story import PASSAGE, draw_story, off_lobe, stories
from fbn_testing.seeds import How, add_options, run_seeds, seed_range

console = Console(highlight=False, width=150)
CUBIC, LINEAR = {"feature.elevation": "cubic"}, {"feature.elevation": "linear"}
COMPASS = ("hard_iron_min", "hard_iron_max", "soft_iron_min", "soft_iron_max", "mount_sigma", "drift_sigma")
ROWS = ("left_near", "right_near", "left_far", "right_far")
ANY_HEIGHT = {"world.height_scatter": 1.2, **{f"world.rows.{row}.height": 1.5 for row in ROWS}}  # 0 to 4 m
NO_PRIOR = {"feature.height_scale": 1e6}  # m: any height over the floor is as likely as any other
LEG = "mission.legs."
DOWN_AND_UP = {
    f"{LEG}dive.to": [0.0, 0.0], f"{LEG}dive.depth": 1.0, f"{LEG}surface.to": [40.0, 0.0], f"{LEG}surface.depth": 3.5,
    f"{LEG}fix_2.to": [115.0, 0.0], f"{LEG}fix_2.depth": 1.0, f"{LEG}fix_2.speed": 0.8, f"{LEG}fix_2.seconds": 0.0,
}  # fmt: skip
CURRENT = {"sea.current_speed_min": 0.2, "sea.current_speed_max": 0.2}


class Study(NamedTuple):
    """Variants by name: what is changed in the scenario, and in the tracker."""

    scenario: str
    variants: dict[str, tuple[Mapping[str, Any], Mapping[str, Any]]]


class Mission(NamedTuple):
    """One seed: what each variant came to, and the time it all took."""

    verdicts: dict[str, Verdict]
    cpu_s: float


def against_linear(scenario: Mapping[str, Any]) -> dict[str, tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """The cubic model, without its prior of heights too, and the linear one."""
    return {"cubic": (scenario, CUBIC), "no prior of heights": (scenario, NO_PRIOR), "linear": (scenario, LINEAR)}


STUDIES = {
    "depth_of_features": Study("depth_of_features", against_linear({})),
    "any_height": Study("depth_of_features", against_linear(ANY_HEIGHT)),
    "changing_depth": Study("depth_of_features", against_linear(ANY_HEIGHT | DOWN_AND_UP)),
    "charles_river_2006": Study("charles_river_2006", {"cubic": ({}, CUBIC)}),
    "clutter": Study("depth_of_features", {"5 a ping": ({"sensors.sonar.clutter.noise": 2.5}, CUBIC)}),
    "doppler_log": Study("depth_of_features", {"0.2 m/s": (CURRENT, CUBIC)}),
    "causes": Study("depth_of_features", {
        "all errors": ({}, CUBIC),
        "mounts exact": ({"sensors.sonar.misalignment": 0.0}, CUBIC),
        "compass exact": ({f"sensors.compass.{error}": 0.0 for error in COMPASS}, CUBIC),
        "stamps exact": ({"sensors.sonar.stamp_offset": 0.0}, CUBIC),
        "features alone": ({f"sensors.sonar.clutter.{n}": 0.0 for n in ("patches", "fish", "bubbles")}, CUBIC),
    }),
}  # fmt: skip


def main() -> None:
    """Run one study, print its tables, draw its figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", default="0:50", help="first:last, the last one excluded")
    parser.add_argument("--figure", type=Path, help="PNG: vertical sections of the first seed, by variant")
    parser.add_argument("--story", type=Path, help="PNG: a feature of the first seed, from its first echo on")
    add_options(parser)
    given = parser.parse_args()
    seeds = seed_range(given.seeds)
    if given.story:
        draw_story(off_lobe(stories(hear("depth_of_features", seeds[0], PASSAGE))), given.story)
    chosen = STUDIES[given.study]
    missions = run_seeds(partial(mission, chosen), seeds, "missions", How(given.jobs, given.keep))
    verdicts = {name: [m.verdicts[name] for m in missions] for name in chosen.variants}
    if given.figure:
        draw_sections([Section(*named) for named in outcomes(chosen, seeds[0])], given.figure)
    for table in (places(verdicts), found(verdicts), drift(verdicts)):
        console.print(table, "")
    console.print(f"[dim]{np.mean([m.cpu_s for m in missions]):.1f} s of CPU time a seed")


def mission(study: Study, seed: int) -> Mission:
    """All variants on one seed, judged."""
    began = time.process_time()
    verdicts = {name: judge(outcome) for name, outcome in outcomes(study, seed)}
    return Mission(verdicts, time.process_time() - began)


def outcomes(study: Study, seed: int) -> Iterator[tuple[str, Outcome]]:
    """All variants on one seed by name; what variants hear alike is simulated once."""
    heard: dict[str, Heard] = {}
    for name, (changes, settings) in study.variants.items():
        key = repr(sorted(changes.items()))
        if key not in heard:
            heard[key] = hear(study.scenario, seed, changes)
        yield name, track(heard[key], settings)


def places(verdicts: dict[str, list[Verdict]]) -> Table:
    """Where features are said to be: errors, NEES by seeds with its band, elevations on the wrong side."""
    made = _table("True features", "NEES of x, y", "band", "NEES of depth", "band", "error of depth [m]", "5 to 95 %",
                  "sigma [m]", "x, y [m]", "other side")  # fmt: skip
    for name, all_seeds in verdicts.items():
        seen = [v for v in all_seeds if v.found]
        features = [f for v in seen for f in v.found]
        errors = np.array([abs(f.error[2]) for f in features])
        made.add_row(
            name,
            _mean([[f.horizontal for f in v.found] for v in seen]), _band(2, len(seen)),
            _mean([[f.depth for f in v.found] for v in seen]), _band(1, len(seen)),
            f"{np.median(errors):.2f}", _spread(errors),
            f"{np.median([np.sqrt(f.covariance[2, 2]) for f in features]):.2f}",
            f"{np.median([np.hypot(*f.error[:2]) for f in features]):.2f}",
            f"{np.mean([f.other_side for f in features]):.1%} of {len(features)}",
        )  # fmt: skip
    return made


def found(verdicts: dict[str, list[Verdict]]) -> Table:
    """What was found of what is there, and what is not."""
    made = _table("Found", "in view for 10 pings", "promoted", "worst seed", "7 echoes too", "promoted",
                  "of nothing in 10 min", "fish and bubbles", "patches of the bed")  # fmt: skip
    for name, seeds in verdicts.items():
        due, heard, hours = sum(v.due for v in seeds), sum(v.heard for v in seeds), sum(v.hours for v in seeds)
        worst = min(v.promoted / max(v.due, 1) for v in seeds)
        false = sum(v.false for v in seeds)
        made.add_row(
            name, str(due), f"{sum(v.promoted for v in seeds) / max(due, 1):.1%}", f"{worst:.0%}",
            str(heard), f"{sum(v.heard_promoted for v in seeds) / max(heard, 1):.1%}",
            f"{false / (6.0 * hours):.2f} ({false} in {hours:.1f} h)",
            f"{sum(v.passing for v in seeds) / (6.0 * hours):.2f}", str(sum(v.patches for v in seeds)),
        )  # fmt: skip
    return made


def drift(verdicts: dict[str, list[Verdict]]) -> Table:
    """Composites with features as a Doppler log: drift along and across the way against dead reckoning alone."""
    made = _table("Composites with features", "along [m]", "alone", "5 to 95 %", "across [m]", "alone", "5 to 95 %",
                  "% of the way", "alone", "NEES", "band", "n")  # fmt: skip
    for name, all_seeds in verdicts.items():
        seen = [v for v in all_seeds if v.moved]
        ways = [m for v in seen for m in v.moved]
        ours, alone = np.abs(np.array([m.error for m in ways])), np.abs(np.array([m.alone for m in ways]))
        length = np.array([m.distance for m in ways])
        share = [100.0 * float(np.median(np.hypot(e[:, 0], e[:, 1]) / length)) for e in (ours, alone)]
        made.add_row(
            name,
            *(cell for i in (0, 1) for cell in (f"{np.median(ours[:, i]):.2f}", f"{np.median(alone[:, i]):.2f}",
                                                _spread(np.asarray(ours[:, i], dtype=np.float64)))),
            *(f"{percent:.1f}" for percent in share),
            _mean([[m.nees for m in v.moved] for v in seen]), _band(2, len(seen)), str(len(ways)),
        )  # fmt: skip
    return made


def _table(title: str, *columns: str) -> Table:
    made = Table(title=title, title_justify="left", box=None, pad_edge=False)
    made.add_column("")
    for column in columns:
        made.add_column(column, justify="right")
    return made


def _mean(by_seed: list[list[float]]) -> str:
    """Mean over seeds of the mean of each, and its standard error."""
    means = np.array([np.mean(values) for values in by_seed])
    error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.nan
    return f"{means.mean():.2f} ± {error:.2f}"


def _band(dof: int, seeds: int) -> str:
    low, high = chi_square.band(dof * seeds)
    return f"{low:.2f} to {high:.2f}"


def _spread(values: Array) -> str:
    return f"{np.quantile(values, 0.05):.2f} to {np.quantile(values, 0.95):.2f}"


if __name__ == "__main__":
    main()
