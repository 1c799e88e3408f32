"""Recordings that are text: CSV of any separator, quoted or aligned, in whatever encoding."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from commissioning.recordings.table import MOST_CELLS, MOST_ROWS, Array, Table, distinct, unit_in
from profiles.errors import UsageError
from profiles.quantities import unit_named

__all__ = ["table_of_text"]

_SEARCHED = 200  # lines for the first row of numbers
_BLOCK = 3  # rows that look alike are numbers
_EMPTY = 3  # columns at the end that have a name and nothing else, at most
_FOOT = 20  # lines after the numbers that may be something else
_MOSTLY = 0.4  # of the bytes of a text in UTF-16 are zero
_COMMENTS = "#%!/;*'\""
_SPACES = "aligned spaces"
_SEPARATORS = (";", "\t", "|", ",", _SPACES)
_STAMP = re.compile(
    r"(?:(\d{4}-\d\d-\d\d)[T ])?(\d{1,2}:\d\d:\d\d)(?:[.,](\d{1,9}))?\s*(Z|[+-]\d\d:?\d\d)?"
)
_RULES = set("-=+_|: \t")  # of which the line below a header is drawn
_NOTHING = ("", "-", "—", "nan", "NaN", "NAN")


def table_of_text(path: Path, data: bytes) -> Table:
    """Read a text as a table; raises UsageError."""
    text = _decoded(path, data)
    if text.count("\n") > MOST_ROWS:
        raise UsageError(f"{path}: more than {MOST_ROWS} rows; cut the recording")
    if sum(text.count(sign) for sign in ",;\t|") > 4 * MOST_CELLS:
        raise UsageError(f"{path}: more than {MOST_CELLS} cells; cut the recording")
    lines = text.splitlines()
    try:
        return _Layout.of(path, lines).table(path, lines)
    except csv.Error as error:
        raise UsageError(f"{path}: cannot be read as CSV: {error}") from None


def _decoded(path: Path, data: bytes) -> str:
    """UTF-8, UTF-16 or what Western Windows writes."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    head = data[:2000]
    for zeros, letters, name in ((1, 0, "utf-16-le"), (0, 1, "utf-16-be")):
        share = head[zeros::2].count(0) / max(len(head), 1)
        if share > _MOSTLY and not head[letters::2].count(0):
            return data.decode(name, "replace")
    if b"\0" in head:
        raise UsageError(f"{path}: is no text; a recording is CSV, .mat or .npz")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the rows of a file are to be read.

    Attributes
    ----------
    first : index of the first row of numbers
    kept : indices of the columns of numbers
    stamped : those of them that are times of day or dates
    width : cells of a row, empty ones at its end left out
    """

    separator: str
    first: int
    width: int
    kept: tuple[int, ...]
    stamped: frozenset[int]
    has_comma: bool

    @classmethod
    def of(cls, path: Path, lines: list[str]) -> _Layout:
        """The first separator by which some rows in a row have the same numbers of numbers."""
        found: list[_Layout] = []
        for separator in _SEPARATORS:
            layout = cls._by(separator, lines)
            if layout is not None:
                found.append(layout)
        if not found:
            raise UsageError(_no_numbers(path, lines))
        return max(found, key=lambda one: (len(one.kept), len(one.kept) == one.width))

    @classmethod
    def _by(cls, separator: str, lines: list[str]) -> _Layout | None:
        for first in range(min(len(lines) - _BLOCK + 1, _SEARCHED)):
            rows = [_cells(line, separator) for line in lines[first : first + _BLOCK]]
            if len({len(row) for row in rows}) != 1 or not rows[0]:
                continue
            width, columns = len(rows[0]), list(zip(*rows, strict=True))
            stamped = frozenset(
                n for n, cells in enumerate(columns) if all(map(_STAMP.fullmatch, cells))
            )
            kept = tuple(
                n for n, cells in enumerate(columns) if n in stamped or all(map(_is_number, cells))
            )
            if len(kept) >= 2:
                block = [row[n] for row in rows for n in kept if n not in stamped]
                has_comma = any(re.search(r"\d,\d", cell) for cell in block) or cls._has_comma(
                    separator, lines[first : first + _SEARCHED], kept
                )
                return cls(separator, first, width, kept, stamped, has_comma)
        return None

    @staticmethod
    def _has_comma(separator: str, lines: list[str], kept: Sequence[int]) -> bool:
        if separator == "," and not any('"' in line for line in lines):
            return False
        rows = (_cells(line, separator) for line in lines)
        return any(re.search(r"\d,\d", row[n]) for row in rows for n in kept if n < len(row))

    def table(self, path: Path, lines: list[str]) -> Table:
        """Every row of numbers; raises UsageError naming the row that is none."""
        names, units = self._header(lines)
        bodies: list[list[str]] = []
        end, notes = len(lines), []
        for number, row in self._rows(lines):
            if len(row) < self.width or not self._fits(row):
                end = self._foot(path, lines, number, row, names)
                left = sum(bool(line.strip()) for line in lines[end:])
                notes.append(f"{path}: lines at its end that are no numbers left out: {left}")
                break
            bodies.append(row)
        columns: dict[str, Array] = {}
        for n in self.kept:
            columns[names[n]] = self._column(path, names[n], n, bodies)
        return Table(
            path,
            columns,
            {k: v for k, v in units.items() if k in columns},
            {},
            self.first + 1,
            tuple(notes),
            tuple(n + 1 for n in self.kept),
        )

    def _rows(self, lines: list[str]) -> Iterator[tuple[int, list[str]]]:
        """Number of the line, and its cells; empty lines left out."""
        for number, line in enumerate(lines[self.first :], self.first + 1):
            if line.strip():
                yield number, _cells(line, self.separator)

    def _fits(self, row: list[str]) -> bool:
        return all(row[n] in _NOTHING or self._value(row[n], n) is not None for n in self.kept)

    def _value(self, cell: str, n: int) -> float | None:
        if n in self.stamped:
            return _moment(cell)
        try:
            return float(cell.replace(",", ".") if self.has_comma else cell)
        except ValueError:
            return None

    def _foot(
        self, path: Path, lines: list[str], number: int, row: list[str], names: list[str]
    ) -> int:
        """Index of the line where the numbers end; raises UsageError where they go on after it."""
        after = lines[number:]
        goes_on = len(after) > _FOOT or any(
            len(cells) == self.width and self._fits(cells)
            for cells in (_cells(line, self.separator) for line in after if line.strip())
        )
        if not goes_on:
            return number - 1
        if len(row) < self.width:
            raise UsageError(f"{path}: row {number} has {len(row)} cells, the others {self.width}")
        bad = next(
            n for n in self.kept if self._value(row[n], n) is None and row[n] not in _NOTHING
        )
        raise UsageError(
            f"{path}: row {number}, column '{names[bad]}': '{row[bad][:40]}' is no number"
        )

    def _column(self, path: Path, name: str, n: int, rows: list[list[str]]) -> Array:
        to_number: Callable[[str], float]
        if n in self.stamped:
            to_number = _stamp
        elif self.has_comma:
            to_number = _with_comma
        else:
            to_number = float
        cells = [row[n] for row in rows]
        if self.has_comma and n not in self.stamped:
            grouped = next((k for k, cell in enumerate(cells) if "." in cell), None)
            if grouped is not None:
                raise UsageError(
                    f"{path}: column '{name}': '{cells[grouped][:40]}' has a point, and others "
                    "have decimal commas: is it a group of thousands? Export it without"
                )
        try:
            values = np.array([to_number(cell) for cell in cells], float)
        except ValueError:  # what is not there
            values = np.array(
                [np.nan if cell in _NOTHING else to_number(cell) for cell in cells], float
            )
        if n in self.stamped and len(values):
            values = _since_the_first(values)
        return values

    def _header(self, lines: list[str]) -> tuple[list[str], dict[str, str]]:
        """Names of the columns, by number where there are none, and units."""
        rows = [
            _cells(_uncommented(line, self.separator), self.separator)
            for line in lines[: self.first]
            if not set(line) <= _RULES
        ]
        # a header may name columns that are empty
        above = [row[: self.width] for row in rows if 0 <= len(row) - self.width <= _EMPTY][-2:]
        names = [str(n) for n in range(1, self.width + 1)]
        row_of_units: list[str] = []
        if above and self._is_units(above[-1]) and (len(above) == 2 or self._only_units(above[-1])):
            row_of_units = above.pop()
        elif len(above) == 2 and self._only_units(above[0]) and not self._only_units(above[1]):
            row_of_units = above.pop(0)
        if above:
            names = distinct([re.sub(r"\s+", " ", cell) for cell in above[-1]])
        elif row_of_units and not self._only_units(row_of_units):
            names, row_of_units = distinct(row_of_units), []
        units = {
            name: unit
            for n, name in enumerate(names)
            if (unit := (_bare(row_of_units[n]) if row_of_units else "") or unit_in(name))
        }
        units |= {names[n]: "s" for n in self.stamped}
        return names, units

    def _is_units(self, cells: list[str]) -> bool:
        """Whether every cell is a unit, or says nothing."""
        return all(_bare(cell) in ("", "-", "1", "%") or unit_named(_bare(cell)) for cell in cells)

    def _only_units(self, cells: list[str]) -> bool:
        return self._is_units(cells) and any(unit_named(_bare(cell)) for cell in cells)


def _bare(cell: str) -> str:
    return cell.strip().strip("[](){}<>").strip()


def _uncommented(line: str, separator: str) -> str:
    """A line without the sign that makes a comment of it."""
    text = line.lstrip()
    signs = _COMMENTS.replace(separator, "").replace('"', "")
    return text.lstrip(signs).lstrip() if text[:1] in signs and text[:1] else line


def _cells(line: str, separator: str) -> list[str]:
    """Cells of a line; empty ones at its end are no cells, nor the frame of a drawn table."""
    if separator == _SPACES:
        return line.split()
    if separator == "|":
        line = line.strip().strip("|")
    row = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".", 1))
    except ValueError:
        return False
    return True


def _with_comma(cell: str) -> float:
    return float(cell.replace(",", "."))


def _stamp(cell: str) -> float:
    found = _moment(cell)
    if found is None:
        raise ValueError(cell)
    return found


def _moment(cell: str) -> float | None:
    """A date and time of ISO 8601, or a time of day, s."""
    found = _STAMP.fullmatch(cell.strip())
    if found is None:
        return None
    day, clock, part, _zone = found.groups()
    try:
        moment = datetime.fromisoformat(f"{day or '1970-01-01'}T{clock:0>8}+00:00").timestamp()
    except ValueError:
        return None
    return moment + (int(part) / 10 ** len(part) if part else 0.0)


def _since_the_first(values: Array) -> Array:
    """Times of day that go on after midnight, from the first on, s."""
    day = 86400.0
    falls = np.diff(values) < -day / 2
    since: Array = values - values[0] + day * np.concatenate([[0.0], np.cumsum(falls)])
    return since


def _no_numbers(path: Path, lines: list[str]) -> str:
    rows = sum(
        any(sum(map(_is_number, _cells(line, s))) >= 2 for s in _SEPARATORS)
        for line in lines[:_SEARCHED]
        if line.strip()
    )
    if 0 < rows < _BLOCK:
        of_numbers = f"row{'s' if rows > 1 else ''} of numbers"
        return f"{path}: has {rows} {of_numbers}; a measurement needs hundreds"
    return (
        f"{path}: has no rows of numbers within its first {_SEARCHED} lines; a recording is CSV of "
        "two columns of numbers or more"
    )
