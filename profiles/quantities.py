"""Numbers as people write them: a value, a decimal comma if they like, and a unit.

Everything inside is SI; what comes in may be in the units of the shop floor.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

__all__ = ["UNITS", "InUnit", "Kind", "UnitOfUse", "number", "parse", "unit_named", "units_of"]

Kind = Literal[
    "time", "position", "velocity", "torque", "current", "share", "frequency", "temperature",
    "torque constant",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class UnitOfUse:
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
class InUnit:
    """A number in SI, and what its unit says of the axis; None: there was no unit."""

    si: float
    unit: UnitOfUse | None


_TURN = 2 * math.pi


def _many() -> dict[str, UnitOfUse]:
    found: dict[str, UnitOfUse] = {}

    def put(
        spellings: str, kind: Kind, factor: float, linear: bool | None = None, base: str = ""
    ) -> None:
        names = spellings.split()
        unit = UnitOfUse(names[0], kind, factor, linear, base)  # type: ignore[arg-type]
        found.update(dict.fromkeys(names, unit))

    put("s sec second seconds sek", "time", 1.0)
    put("ms msec", "time", 1e-3)
    put("us µs μs usec", "time", 1e-6)
    put("min minute minutes", "time", 60.0)
    put("rad", "position", 1.0, linear=False)
    put("mrad", "position", 1e-3, linear=False)
    put("deg ° degree degrees grad", "position", math.pi / 180, linear=False)
    put("rev turn turns revs U Umdr r", "position", _TURN, linear=False)
    put("m", "position", 1.0, linear=True)
    put("cm", "position", 1e-2, linear=True)
    put("mm", "position", 1e-3, linear=True)
    put("um µm μm", "position", 1e-6, linear=True)
    put("nm", "position", 1e-9, linear=True)
    put("inch in", "position", 0.0254, linear=True)
    put(
        "counts count cnt cnts inc incs increments incr Inkr ink pulses pul",
        "position",
        1.0,
        None,
        "encoder",
    )
    put("rad/s", "velocity", 1.0, linear=False)
    put("deg/s °/s", "velocity", math.pi / 180, linear=False)
    put("rpm 1/min min-1 min^-1 U/min r/min rev/min", "velocity", _TURN / 60, linear=False)
    put("rev/s rps U/s 1/s", "velocity", _TURN, linear=False)
    put("m/s", "velocity", 1.0, linear=True)
    put("mm/s", "velocity", 1e-3, linear=True)
    put("m/min", "velocity", 1 / 60, linear=True)
    put("mm/min", "velocity", 1e-3 / 60, linear=True)
    put("counts/s count/s cnt/s inc/s incr/s pulses/s", "velocity", 1.0, None, "encoder")
    put("N.m Nm", "torque", 1.0, linear=False)
    put("mN.m mNm", "torque", 1e-3, linear=False)
    put("kN.m kNm", "torque", 1e3, linear=False)
    put("N.cm Ncm", "torque", 1e-2, linear=False)
    put("N", "torque", 1.0, linear=True)
    put("kN", "torque", 1e3, linear=True)
    put("A Arms A_rms Aeff", "current", 1.0, None, "torque constant")
    put("mA", "current", 1e-3, None, "torque constant")
    put("% pct percent", "share", 1e-2, None, "rated torque")
    put("‰ permille 0.1%", "share", 1e-3, None, "rated torque")
    put("Hz", "frequency", _TURN)
    put("kHz", "frequency", 1e3 * _TURN)
    put("°C degC C", "temperature", 1.0)
    put("N.m/A Nm/A", "torque constant", 1.0)
    put("mN.m/A mNm/A", "torque constant", 1e-3)
    return found


UNITS = _many()
_ORDINARY = str.maketrans({"·": ".", "⋅": ".", "*": ".", "−": "-", "\u00a0": " ", "\u202f": " "})
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")


def unit_named(text: str) -> UnitOfUse | None:
    """The unit of that name in any of its spellings; None: there is none."""
    name = text.strip().translate(_ORDINARY)
    return UNITS.get(name) or UNITS.get(name.replace(" ", ".")) or _any_case(name)


def _any_case(name: str) -> UnitOfUse | None:
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


def parse(text: str) -> InUnit:
    """'0,5', '12 deg', '3000rpm', '85 %': the number in SI; raises ValueError.

    In a unit that takes a base it is in that unit's SI part: counts, A, a share of 1.
    """
    plain = text.strip().translate(_ORDINARY)
    found = _NUMBER.match(plain)
    if not found:
        raise ValueError(f"'{text.strip():.40}' is no number with a unit")
    value, rest = number(found[0]), plain[found.end() :].strip()
    if not rest:
        return InUnit(value, None)
    unit = unit_named(rest)
    if unit is None:
        raise ValueError(f"'{rest:.40}' is no unit that is known")
    return InUnit(value * unit.factor, unit)
