"""Numbers as people write them: a value, a decimal comma if they like, and a unit.

Everything inside is SI; what comes in may be in the units of the shop floor.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

__all__ = ["UNITS", "Kind", "Unit", "Value", "number", "parse", "unit_named", "units_of"]

Kind = Literal[
    "time", "position", "velocity", "torque", "current", "share", "frequency", "temperature",
    "torque constant",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit.

    Attributes
    ----------
    name : as it is printed in messages
    factor : to SI; of a count, of an ampere and of per cent it takes a base
    linear : of a linear axis (True), a rotary one (False), or either
    base : what one has to know beside, '' where nothing
    """

    name: str
    kind: Kind
    factor: float
    linear: bool | None = None
    base: Literal["", "encoder", "torque constant", "rated torque"] = ""


@dataclass(frozen=True, slots=True)
class Value:
    """A number in SI, and what its unit says of the axis; None: there was no unit."""

    si: float
    unit: Unit | None


_TURN = 2 * math.pi


def _many() -> dict[str, Unit]:
    found: dict[str, Unit] = {}

    def add(
        spellings: str, kind: Kind, factor: float, linear: bool | None = None, base: str = ""
    ) -> None:
        names = spellings.split()
        unit = Unit(names[0], kind, factor, linear, base)  # type: ignore[arg-type]
        found.update(dict.fromkeys(names, unit))

    add("s sec second seconds sek", "time", 1.0)
    add("ms msec", "time", 1e-3)
    add("us µs μs usec", "time", 1e-6)
    add("min minute minutes", "time", 60.0)
    add("rad", "position", 1.0, linear=False)
    add("mrad", "position", 1e-3, linear=False)
    add("deg ° degree degrees grad", "position", math.pi / 180, linear=False)
    add("rev turn turns revs U Umdr r", "position", _TURN, linear=False)
    add("m", "position", 1.0, linear=True)
    add("cm", "position", 1e-2, linear=True)
    add("mm", "position", 1e-3, linear=True)
    add("um µm μm", "position", 1e-6, linear=True)
    add("inch in", "position", 0.0254, linear=True)
    add(
        "counts count cnt cnts inc incs increments incr Inkr ink pulses pul",
        "position",
        1.0,
        None,
        "encoder",
    )
    add("rad/s", "velocity", 1.0, linear=False)
    add("deg/s °/s", "velocity", math.pi / 180, linear=False)
    add("rpm 1/min min-1 min^-1 U/min r/min rev/min", "velocity", _TURN / 60, linear=False)
    add("rev/s rps U/s 1/s", "velocity", _TURN, linear=False)
    add("m/s", "velocity", 1.0, linear=True)
    add("mm/s", "velocity", 1e-3, linear=True)
    add("m/min", "velocity", 1 / 60, linear=True)
    add("mm/min", "velocity", 1e-3 / 60, linear=True)
    add("counts/s count/s cnt/s inc/s incr/s pulses/s", "velocity", 1.0, None, "encoder")
    add("N.m Nm", "torque", 1.0, linear=False)
    add("mN.m mNm", "torque", 1e-3, linear=False)
    add("kN.m kNm", "torque", 1e3, linear=False)
    add("N.cm Ncm", "torque", 1e-2, linear=False)
    add("N", "torque", 1.0, linear=True)
    add("kN", "torque", 1e3, linear=True)
    add("A Arms A_rms Aeff", "current", 1.0, None, "torque constant")
    add("mA", "current", 1e-3, None, "torque constant")
    add("% pct percent", "share", 1e-2, None, "rated torque")
    add("‰ permille 0.1%", "share", 1e-3, None, "rated torque")
    add("Hz", "frequency", _TURN)
    add("kHz", "frequency", 1e3 * _TURN)
    add("°C degC C", "temperature", 1.0)
    add("N.m/A Nm/A", "torque constant", 1.0)
    add("mN.m/A mNm/A", "torque constant", 1e-3)
    return found


UNITS = _many()
_ORDINARY = str.maketrans({"·": ".", "⋅": ".", "*": ".", "−": "-", "\u00a0": " ", "\u202f": " "})
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")


def unit_named(text: str) -> Unit | None:
    """The unit of that name in any of its spellings; None: there is none."""
    name = text.strip().translate(_ORDINARY)
    return UNITS.get(name) or UNITS.get(name.replace(" ", ".")) or _any_case(name)


def _any_case(name: str) -> Unit | None:
    """A unit that only capitals tell from what is written, where those do not change its size."""
    found = {
        id(unit): unit
        for key, unit in UNITS.items()
        if key.lower() == name.lower() and (key[:1], name[:1]) != ("m", "M")  # milli is not mega
    }
    return next(iter(found.values())) if len(found) == 1 and len(name) > 1 else None


def units_of(*kinds: Kind) -> str:
    """Names of the units of some kinds, for messages."""
    return ", ".join(dict.fromkeys(u.name for u in UNITS.values() if u.kind in kinds))


def number(text: str) -> float:
    """A number with a point or a comma; raises ValueError."""
    plain = text.strip().translate(_ORDINARY)
    if not _NUMBER.fullmatch(plain):
        raise ValueError(f"'{text.strip():.40}' is no number")
    return float(plain.replace(",", "."))


def parse(text: str) -> Value:
    """'0,5', '12 deg', '3000rpm', '85 %': the number in SI; raises ValueError.

    In a unit that takes a base it is in that unit's SI part: counts, A, a share of 1.
    """
    plain = text.strip().translate(_ORDINARY)
    found = _NUMBER.match(plain)
    if not found:
        raise ValueError(f"'{text.strip():.40}' is no number with a unit")
    value, rest = number(found[0]), plain[found.end() :].strip()
    if not rest:
        return Value(value, None)
    unit = unit_named(rest)
    if unit is None:
        raise ValueError(f"'{rest:.40}' is no unit that is known")
    return Value(value * unit.factor, unit)
