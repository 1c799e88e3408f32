"""Habits of real drives that a served virtual one takes on when it is asked to.

Each was seen on a drive, a stack or in a bug report that nobody here wrote. Without any the virtual drive
keeps its standards to the letter.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from profiles.errors import UnknownName, UsageError

__all__ = ["HABITS", "NONE", "Habit", "Habits", "habits_of"]


@dataclass(frozen=True, slots=True)
class Habit:
    """What a drive does; `default` is its value where none is given ('': it takes none)."""

    text: str
    default: str = ""


HABITS: dict[str, Habit] = {
    "lenient": Habit("stays operational when the heartbeat of its master is lost (1029h:01 = 1)"),
    "short-sdo": Habit("SDO answers are as long as they need to be, not 8 bytes"),
    "slow-reset": Habit("the fault bit goes so many s after the reset edge", "0.05"),
    "slow-mode": Habit("6061h follows 6060h after so many s", "4"),
    "slow-save": Habit("'save' is answered after so many s", "1.5"),
    "feed": Habit("counts so many position units a revolution, and says so by 6092h", "65536"),
    "gear": Habit("counts so behind a gear 10:1, and says so by 6091h and 6092h", "65536"),
    "old-factor": Habit("counts so, and says so by 6093h, the position factor of old", "65536"),
    "delivered": Habit("has 6091h, 6092h as delivered, 1/1, whatever it counts in"),
    "wrap": Habit(
        "its position counter stands so many counts below its end, where it wraps", "648"
    ),
    "modulo": Habit("its position wraps at each of so many counts, and says so by 607Bh", "131072"),
    "polarity": Habit("counts position and velocity the other way round, and says so by 607Eh"),
    "lacks": Habit("has none of these objects: 6502h+6076h", "6502h"),
}
_COUNTS = {"wrap", "modulo"}
_UNITS = {"feed", "gear", "old-factor"}
_OBJECT = re.compile(r"([0-9A-Fa-f]{4})h?")


@dataclass(frozen=True, slots=True)
class Habits:
    """Habits by name, each with its value as text."""

    values: dict[str, str]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def seconds(self, name: str) -> float:
        """Value of a habit, s; 0 where the drive does not have it."""
        return float(self.values.get(name, "0"))

    def counts(self, name: str) -> int:
        """Value of a habit, counts; 0 where the drive does not have it."""
        return int(self.values.get(name, "0"))

    @property
    def units(self) -> int:
        """Position units a motor revolution; 0: its encoder's increments."""
        return next((int(self.values[name]) for name in self.values if name in _UNITS), 0)

    @property
    def lacking(self) -> frozenset[int]:
        """Indices of the objects that are not there."""
        found = self.values.get("lacks", "")
        return frozenset(int(_OBJECT.fullmatch(text)[1], 16) for text in found.split("+") if text)  # type: ignore[index]


NONE = Habits({})


def habits_of(texts: Iterable[str]) -> Habits:
    """NAME or NAME=VALUE, several; raises UsageError, UnknownName."""
    values: dict[str, str] = {}
    for text in texts:
        name, given, value = text.partition("=")
        if name not in HABITS:
            raise UnknownName("habit of a virtual drive", name, list(HABITS))
        if name in values:
            raise UsageError(f"--habit {text}: '{name}' is given twice")
        default = HABITS[name].default
        values[name] = value if given else default
        if given and not default:
            raise UsageError(f"--habit {text}: '{name}' takes no value")
        if name == "lacks":
            if not all(_OBJECT.fullmatch(part) for part in values[name].split("+")):
                raise UsageError(f"--habit {text}: must be objects, as lacks=6502h+6076h")
        elif name in _UNITS or name in _COUNTS:
            if not re.fullmatch(r"[1-9][0-9]{1,8}", values[name]):
                raise UsageError(f"--habit {text}: must be a whole number of counts, from 10 on")
        elif default and not _is_time(values[name]):
            raise UsageError(f"--habit {text}: must be a time from 0 to 60 s")
    if len(_UNITS & values.keys()) > 1:
        raise UsageError("--habit: feed, gear and old-factor exclude each other")
    return Habits(values)


def _is_time(text: str) -> bool:
    try:
        return 0 <= float(text) <= 60
    except ValueError:
        return False
