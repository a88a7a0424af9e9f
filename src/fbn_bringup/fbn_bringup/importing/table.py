"""A column log in memory: cells by name of column, as text and as numbers."""

from __future__ import annotations

import csv
import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fbn_bringup.importing.mapping import FileFormat, Quantity, Rule
from fbn_common.types import Array

Mask = npt.NDArray[np.bool_]
_NO_VALUE = ("", "nan", "null", "none", "n/a")


class LogError(Exception):
    """A log that the mapping does not fit; the text says where and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Rows of one file: ``lines`` (n,) in the file, and cells of the wanted columns, stripped of blanks."""

    path: Path
    lines: npt.NDArray[np.int64]
    cells: dict[str, list[str]]
    format: FileFormat

    def __len__(self) -> int:
        return len(self.lines)

    def where(self, keep: Mask) -> Table:
        """The rows kept by a mask (n,)."""
        kept = np.flatnonzero(keep)
        cells = {name: [column[i] for i in kept] for name, column in self.cells.items()}
        return Table(self.path, self.lines[kept], cells, self.format)

    def missing(self, column: str) -> Mask:
        """Mask (n,) of cells without a value."""
        said = {m.strip() for m in self.format.missing}
        return np.array([c in said or c.lower() in _NO_VALUE for c in self.cells[column]], dtype=bool)

    def numbers(self, column: str) -> Array:
        """The column as numbers (n,); NaN where there is none."""
        gone = self.missing(column)
        return np.array([np.nan if g else self._number(c) for c, g in zip(self.cells[column], gone, strict=True)])

    def quantity(self, q: Quantity, *dimensions: str) -> Array:
        """A quantity in SI units (n,); NaN where a cell is missing or out of its range."""
        factor = q.si(*dimensions)
        if not q.columns:
            return np.full(len(self), np.nan if q.value is None else q.value * factor)
        readings = np.stack([self.numbers(c) for c in q.columns])
        low, high = (-np.inf if q.least is None else q.least), (np.inf if q.most is None else q.most)
        readings[(readings < low) | (readings > high)] = np.nan
        weights = np.array(q.weights) if q.weights else np.full(len(q.columns), 1.0 / len(q.columns))
        values = (weights @ readings - q.zero) * q.scale
        return np.asarray(values if q.floor is None else np.where(values < q.floor, q.floor, values)) * factor

    def meets(self, rule: Rule) -> Mask:
        """Mask (n,) of the rows that meet a rule."""
        met = ~self.missing(rule.column)
        values = self.numbers(rule.column)
        for bound, holds in (
            (rule.least, np.greater_equal),
            (rule.most, np.less_equal),
            (rule.above, np.greater),
            (rule.below, np.less),
        ):
            if bound is not None:
                met &= holds(values, bound)
        if rule.equals:
            met &= np.isin(values, rule.equals)
        if rule.differs:
            met &= ~np.isin(values, rule.differs)
        if rule.says:
            met &= np.array([c in rule.says for c in self.cells[rule.column]], dtype=bool)
        return np.asarray(met)

    def repeated(self, columns: Iterable[str]) -> Mask:
        """Mask (n,) of rows whose cells in all these columns are those of the row before."""
        same = np.zeros(len(self), dtype=bool)
        chosen = [self.cells[c] for c in columns]
        for i in range(1, len(self) if chosen else 0):
            same[i] = all(column[i] == column[i - 1] for column in chosen)
        return same

    def _number(self, cell: str) -> float:
        try:
            value = float(cell.replace(self.format.decimal, ".") if self.format.decimal != "." else cell)
        except ValueError:
            return np.nan
        return value if np.isfinite(value) else np.nan


def read_table(path: Path, format: FileFormat, wanted: Iterable[str]) -> tuple[Table, dict[str, int]]:
    """The wanted columns of a file, and how many rows were ragged (short: cells missing; long: cells ignored).

    Raises LogError for a file that cannot be read so, or has not these columns.
    """
    try:
        with path.open(encoding=format.encoding, newline="") as stream:
            for _ in range(format.skip_lines):
                next(stream, None)
            reader = csv.reader(stream, delimiter=format.delimiter)
            header = [" ".join(name.split()) for name in next(reader, [])]
            rows = [(reader.line_num + format.skip_lines, row) for row in reader]
    except (UnicodeDecodeError, LookupError) as error:
        raise LogError(
            f"{path}: not in encoding {format.encoding!r} ({error}); set file.encoding, e.g. latin-1"
        ) from error
    except (OSError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read: {error}") from error
    if not rows:
        raise LogError(f"{path}: has no rows below the names of columns")
    places = {name: _place(path, header, name) for name in dict.fromkeys(wanted)}
    ragged = {
        "short rows": sum(len(r) < len(header) for _, r in rows),
        "long rows": sum(len(r) > len(header) for _, r in rows),
    }
    cells = {name: [r[i].strip() if i < len(r) else "" for _, r in rows] for name, i in places.items()}
    return Table(path, np.array([line for line, _ in rows]), cells, format), {k: n for k, n in ragged.items() if n}


def _place(path: Path, header: list[str], name: str) -> int:
    """Index of a column; names are compared with blanks at the ends cut off and inner ones made single."""
    plain = " ".join(name.split())
    found = [i for i, column in enumerate(header) if column == plain]
    if len(found) == 1:
        return found[0]
    if found:
        numbers = ", ".join(str(i + 1) for i in found)
        raise LogError(f"{path}: column {name!r} is there {len(found)} times (columns {numbers}); rename all but one")
    near = difflib.get_close_matches(plain, header, 1)
    hint = (
        f"did you mean {near[0]!r}?"
        if near
        else f"it has: {', '.join(header[:12])}{' ...' if len(header) > 12 else ''}"
    )
    raise LogError(f"{path}: no column {name!r}; {hint}")
