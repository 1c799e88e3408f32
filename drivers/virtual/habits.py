"""Habits of real drives that a virtual one takes on when it is asked to.

Each was seen on a drive, a stack or in a bug report that nobody here wrote. Without any the virtual
drive keeps its standards to the letter.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from profiles.errors import UnknownName, UsageError

__all__ = ["HABITS", "NONE", "Habit", "Habits", "habits_of"]


@dataclass(frozen=True, slots=True)
class Habit:
    """What a drive does.

    `default` is its value where none is given ('': it takes none), and says of which kind it is.
    `buses` can show it; 'virtual' is virtual://, in this process.
    """

    text: str
    default: str = ""
    buses: tuple[str, ...] = ("canopen",)

    def refuses(self, value: str) -> str:
        """What a value must be; '' where it is so."""
        for mark, shape, words in _KINDS:
            if re.search(mark, self.default):
                return "" if re.fullmatch(shape, value) else words
        return "takes no value"


_KINDS = (
    ("h", r"[0-9A-Fa-f]{4}h?(\+[0-9A-Fa-f]{4}h?)*", "must be objects, as 6502h+6076h"),
    (r"\.", r"(60|[1-5]?[0-9](\.[0-9]{1,6})?)", "must be a time from 0 to 60 s"),
    ("[0-9]", r"[1-9][0-9]{0,8}", "must be a whole number from 1 on"),
)
_EVERYWHERE, _SERVED, _MODBUS = ("canopen", "modbus", "virtual"), ("canopen", "modbus"), ("modbus",)

HABITS: dict[str, Habit] = {
    # what it says of itself, on any bus
    "slow-reset": Habit("the fault bit goes so many s after the reset edge", "0.05", _EVERYWHERE),
    "slow-mode": Habit("its mode display follows the mode after so many s", "4.0", _EVERYWHERE),
    "slow-enable": Habit("enabling takes so many s (brake, phasing)", "1.5", _EVERYWHERE),
    "same-mode": Habit("to be told the mode that is set is an error to it", "", _EVERYWHERE),
    "halt": Habit(
        "refuses a mode while the controlword's HALT is set, as delivered", "", _EVERYWHERE
    ),
    "wrap": Habit(
        "its counter stands so many counts below its end, where it wraps", "648", _EVERYWHERE
    ),
    "unsigned-torque": Habit("tells its torque without a sign", "", _EVERYWHERE),
    "limit-bit": Habit("always says that an internal limit is active", "", _EVERYWHERE),
    "zero-limit": Habit(
        "its torque limit reads 0 as delivered, which limits nothing", "", _EVERYWHERE
    ),
    "quick-stop-stays": Habit(
        "holds the axis after a quick stop (605Ah is 6 as delivered)", "", _EVERYWHERE
    ),
    # in what it counts
    "feed": Habit("counts so many position units a revolution, and says so by 6092h", "65536"),
    "gear": Habit("counts so behind a gear 10:1, and says so by 6091h and 6092h", "65536"),
    "old-factor": Habit("counts so, and says so by 6093h, the position factor of old", "65536"),
    "delivered": Habit("has 6091h, 6092h as delivered, 1/1, whatever it counts in"),
    "modulo": Habit("its position wraps at each of so many counts, and says so by 607Bh", "131072"),
    "polarity": Habit("counts position and velocity the other way round, and says so by 607Eh"),
    # its object dictionary
    "lacks": Habit("has none of these objects", "6502h"),
    "wide": Habit("has 32-bit integers where others have 16", "6072h+60B2h"),
    "sub1": Habit("has the values of these objects behind sub-index 1", "6076h"),
    "one-limit": Habit("6072h and 6073h are one limit: to write one is to write the other"),
    "low-current": Habit("6073h limits the torque, too, to so many per mille of rated", "400"),
    "needs-period": Habit("faults when enabled unless 60C2h says the period of the cycle"),
    # its answers
    "slow-answer": Habit("SDO, or a request, is answered after so many s", "0.05", _SERVED),
    "busy": Habit(
        "every so many-th access is refused for now (0800 0022h, exception 6)", "7", _SERVED
    ),
    "slow-save": Habit("'save' is answered after so many s", "1.5", _SERVED),
    "silent-save": Habit(
        "for so many s after 'save' nothing is answered, the 'save' neither", "3.0", _SERVED
    ),
    "busy-save": Habit(
        "for so many s after 'save' every access is refused for now", "2.0", _SERVED
    ),
    "slow-boot": Habit("nothing is answered for so many s after the first request", "1.5", _SERVED),
    "short-sdo": Habit("SDO answers are as long as they need to be, not 8 bytes"),
    "unsized": Habit("SDO answers do not tell how many bytes count"),
    "segmented": Habit("every SDO answer comes in segments"),
    # on Modbus, its own, its gateway's and its adapter's
    "mute43": Habit("function 43 is never answered", "", _MODBUS),
    "no-target": Habit("every so many-th request gets a gateway's exception 0Bh", "50", _MODBUS),
    "acknowledge": Habit(
        "every so many-th write is done, and answered by exception 05", "9", _MODBUS
    ),
    "duplicate": Habit("every answer comes twice", "", _MODBUS),
    "other-unit": Habit("answers carry this unit (256: 0)", "256", _MODBUS),
    "echo": Habit("a two-wire adapter that hears itself", "", _MODBUS),
    "fragments": Habit("answers come in pieces of three bytes", "", _MODBUS),
    "noise": Habit("three bytes of noise before every so many-th answer", "50", _MODBUS),
    "lost-answer": Habit("every so many-th request is done, and not answered", "50", _MODBUS),
    "irregular": Habit("answers come after any time up to so many s", "0.02", _MODBUS),
    "low-first": Habit("32-bit values have their low word first", "", _MODBUS),
    "off-by-one": Habit("register addresses are counted from 1", "", _MODBUS),
    # its network management, errors and PDOs
    "lenient": Habit("stays operational when the heartbeat of its master is lost (1029h:01 = 1)"),
    "refuses-start": Habit("is not started while the communication bit of 1001h stands"),
    "operational": Habit("has started itself (1F80h), and is operational when it is found"),
    "guarding": Habit("has no heartbeat (1016h, 1017h), but life guarding (100Ch, 100Dh)"),
    "mute-reset": Habit("no EMCY says that an error is gone"),
    "warnings": Habit("an EMCY about nothing that matters comes every so many s", "0.5"),
    "chatty": Habit("other nodes on its bus send PDOs, heartbeats, EMCYs"),
    "fixed-pdo": Habit("its PDO mapping is read-only: 607Ah 6040h 6071h; 6041h 6077h 6064h"),
    "locked-pdo": Habit("PDO parameters are written in pre-operational only"),
    "needs-torque": Habit("faults when it is started without 6071h in its RxPDO"),
    "own-ids": Habit("its PDOs have COB-IDs of its own, which cannot be changed"),
    "lost-tpdo": Habit("every so many-th TPDO is not sent", "50"),
}
_MOST_UNITS = 256
_UNITS = {"feed", "gear", "old-factor"}


@dataclass(frozen=True, slots=True)
class Habits:
    """Habits by name, each with its value as text."""

    values: dict[str, str]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def seconds(self, name: str) -> float:
        """Value of a habit, s; 0 where the drive does not have it."""
        return float(self.values.get(name, "0"))

    def number(self, name: str) -> int:
        """Value of a habit, counts; 0 where the drive does not have it."""
        return int(self.values.get(name, "0"))

    def objects(self, name: str) -> frozenset[int]:
        """Indices that are a habit's value; empty where the drive does not have it."""
        found = self.values.get(name, "")
        return frozenset(int(text.rstrip("h"), 16) for text in found.split("+") if text)

    @property
    def units(self) -> int:
        """Position units a motor revolution; 0: its encoder's increments."""
        return next((int(self.values[name]) for name in self.values if name in _UNITS), 0)

    def for_bus(self, bus: str) -> Habits:
        """The same; raises UsageError where one cannot be shown on `bus`."""
        for name in self.values:
            if bus not in HABITS[name].buses:
                others = " and ".join(HABITS[name].buses)
                raise UsageError(f"habit '{name}' is one of drives on {others}, not on {bus}")
        return self


NONE = Habits({})


def habits_of(texts: Iterable[str]) -> Habits:
    """NAME or NAME=VALUE, several; raises UsageError, UnknownName."""
    values: dict[str, str] = {}
    for text in texts:
        name, given, value = text.partition("=")
        if name not in HABITS:
            raise UnknownName("habit of a virtual drive", name, list(HABITS))
        if name in values:
            raise UsageError(f"habit {text}: '{name}' is given twice")
        wrong = HABITS[name].refuses(value) if given else ""
        if wrong:
            raise UsageError(f"habit {text}: {wrong}")
        values[name] = value if given else HABITS[name].default
    if int(values.get("other-unit", "256")) > _MOST_UNITS:
        raise UsageError("habit other-unit: must be 1 to 256 (which is 0)")
    if len(_UNITS & values.keys()) > 1:
        raise UsageError("habits feed, gear and old-factor exclude each other")
    return Habits(values)
