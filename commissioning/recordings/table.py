"""A recording as it stands in its file: columns of numbers by name."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from profiles.errors import UsageError
from profiles.quantities import unit_named

__all__ = ["LARGEST", "MOST_CELLS", "MOST_ROWS", "Array", "Table", "distinct", "unit_in"]

Array = NDArray[np.float64]

LARGEST = 300_000_000  # bytes
MOST_ROWS = 2_000_000
MOST_CELLS = 10_000_000

_LETTERS = {"U", "r", "in", "min", "C"}  # that end names which mean no unit
_BRACKETS = re.compile(r"^(.*?)[\s_]*[\[(<]\s*([^\])>]+?)\s*[\])>]$")


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of a file as they stand there.

    Attributes
    ----------
    columns : by name, in the order of the file
    units : of columns, where the file says them: a row of units, or within the name
    scalars : single numbers of a file that has some
    first_row : line of the first number, for messages
    notes : what was passed over
    numbers : of the columns in the file, from 1; () : as they stand here
    """

    path: Path
    columns: dict[str, Array]
    units: dict[str, str]
    scalars: dict[str, float] = field(default_factory=dict)
    first_row: int = 1
    notes: tuple[str, ...] = ()
    numbers: tuple[int, ...] = ()

    def named(self, text: str) -> str:
        """The column that is meant: by its name, or by its number from 1; raises UsageError."""
        name = text.strip()
        if name in self.columns:
            return name
        names = list(self.columns)
        numbers = self.numbers or tuple(range(1, len(names) + 1))
        if name.isdecimal() and int(name) in numbers:
            return names[numbers.index(int(name))]
        near = difflib.get_close_matches(name, names, 1, 0.7)
        meant = f" Did you mean '{near[0]}'?" if near else ""
        raise UsageError(
            f"{self.path}: no column '{name:.80}'; there are: {', '.join(names)[:300]}.{meant}"
        )

    def unit(self, name: str) -> str:
        """What the file says of a column's unit, '' where it says none."""
        return self.units.get(name, "")


def unit_in(name: str) -> str:
    """The unit within a column's name: 'pos [inc]', 'time (ms)', 'torque_Nm', 'n in rpm'.

    '' where there is none that is known.
    """
    brackets = _BRACKETS.match(name)
    if brackets and unit_named(brackets[2]):
        return brackets[2]
    for sign in ("_", " in ", " ", "/"):
        head, found, unit = name.rpartition(sign)
        if found and head and unit not in _LETTERS and unit_named(unit):
            return unit
    return ""


def distinct(names: list[str]) -> list[str]:
    """Names of which each is there once: the second 'spare' is 'spare (2)'."""
    found: list[str] = []
    for number, name in enumerate(names, 1):
        plain, count = name or str(number), 1
        while (plain if count == 1 else f"{plain} ({count})") in found:
            count += 1
        found.append(plain if count == 1 else f"{plain} ({count})")
    return found
