"""What a campaign leaves on disk: a row as each seed ends, so that it can go on where it stopped, and the summary."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fbn_bringup.campaign import Plan, Row, spreads, stated_by
from fbn_bringup.evaluation.calibration import bins, diagram
from fbn_bringup.simulation import project_root


class JournalError(Exception):
    """Rows on disk that are not of this campaign; the text says what to do."""


class Journal:
    """Rows of a campaign, one JSON line each, under the plan (and the code) that made them.

    Raises JournalError where the directory holds rows of another plan, or of other code.
    """

    def __init__(self, directory: Path, plan: Plan) -> None:
        self.path = directory / "rows.jsonl"
        self._head = {"plan": fingerprint(plan)}
        if not self.path.exists():
            directory.mkdir(parents=True, exist_ok=True)
            self.path.write_text(json.dumps(self._head) + "\n")
        elif self._lines()[:1] != [self._head]:
            raise JournalError(
                f"{self.path}: rows of other settings, files or code; choose another directory (-o), or --fresh"
            )

    def rows(self) -> dict[int, Row]:
        """Rows by seed; a seed that failed is not among them, so that it is run again."""
        found = [_row(line) for line in self._lines()[1:]]
        return {row.seed: row for row in found if not row.error}

    def keep(self, row: Row) -> None:
        """Append a row; it is on disk when this returns."""
        with self.path.open("a") as file:
            file.write(json.dumps(dataclasses.asdict(row), default=float) + "\n")

    def _lines(self) -> list[dict[str, Any]]:
        """All whole lines; the last one may have been cut off by a crash."""
        lines = []
        for text in self.path.read_text().splitlines():
            try:
                lines.append(json.loads(text))
            except json.JSONDecodeError:
                self._drop_tail(len(lines))
                break
        return lines

    def _drop_tail(self, whole: int) -> None:
        kept = self.path.read_text().splitlines()[:whole]
        self.path.write_text("".join(line + "\n" for line in kept))


def _row(line: dict[str, Any]) -> Row:
    stated = tuple((float(posterior), bool(right)) for posterior, right in line.pop("stated", ()))
    return Row(**line, stated=stated)


def fingerprint(plan: Plan) -> str:
    """A digest of what a seed's row depends on: settings, the files they name, and the sources of all packages."""
    digest = hashlib.sha256(repr((plan.scenario, plan.settings)).encode())
    for path in _files(plan):
        digest.update(path.read_bytes())
    digest.update(code().encode())
    return digest.hexdigest()[:16]


def code() -> str:
    """A digest of the sources of all packages, as they are on disk now."""
    digest, root = hashlib.sha256(), project_root()
    for path in sorted((root / "src").glob("*/fbn_*/**/*")) if root else ():
        if path.suffix in (".py", ".yaml"):
            digest.update(str(path.relative_to(root or path)).encode() + path.read_bytes())
    return digest.hexdigest()


def _files(plan: Plan) -> Iterator[Path]:
    """Scenario and parameter files, and the YAML files (a sonar's) that they or the settings name."""
    yield from _named(Path(), " ".join(plan.settings))
    for path in (Path(plan.scenario), *plan.parameter_files):
        if path.is_file():
            yield path
            yield from _named(path.parent, path.read_text(encoding="utf-8"))


def _named(place: Path, text: str) -> Iterator[Path]:
    """Files ending in .yaml that a text names, from the directory it speaks of."""
    return (found for name in re.findall(r"[^\s\"'=:,\[\]{}]+\.yaml", text) if (found := place / name).is_file())


def write(directory: Path, plan: Plan, rows: list[Row]) -> Path:
    """Write ``rows.csv`` and ``summary.json``; gives the path of the rows."""
    directory.mkdir(parents=True, exist_ok=True)
    names = list(dict.fromkeys(name for row in rows for name in row.values))
    target = directory / "rows.csv"
    with target.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["seed", *names, "wall_s", "error"])
        writer.writerows(
            [row.seed, *(row.values.get(n) for n in names), f"{row.wall_s:.1f}", row.error] for row in rows
        )
    document: dict[str, Any] = {
        "scenario": plan.scenario,
        "settings": list(plan.settings),
        "parameter_files": [str(p) for p in plan.parameter_files],
        "seeds": [row.seed for row in rows],
        "failed": {row.seed: row.error for row in rows if row.error},
        "measures": {s.name: finite(dataclasses.asdict(s)) for s in spreads(rows)},
    }
    if stated := stated_by(rows):
        diagram(directory / "reliability.png", {plan.scenario: stated})
        document["reliability"] = [dataclasses.asdict(b) for b in bins(stated)]
    (directory / "summary.json").write_text(json.dumps(document, indent=2))
    return target


def finite(values: dict[str, Any]) -> dict[str, Any]:
    """Values as JSON has them: no NaN."""
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items() if k != "name"}
