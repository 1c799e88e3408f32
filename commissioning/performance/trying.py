"""Values that try a profile: set-points, and raw values that are taken, or must not be."""

from __future__ import annotations

from commissioning.experiments.plan import Plan
from commissioning.journal import Journal
from commissioning.result.found import Found, Quantity
from drivers.sample import Sample
from profiles.address import WIDTH_BITS
from profiles.parameter import Parameter, Protection
from profiles.procedures import Condition

__all__ = [
    "CYCLES",
    "FRACTION",
    "FRICTION",
    "WornJournal",
    "another",
    "like",
    "not_allowed",
    "to_both_sides",
    "unlike",
]

CYCLES = 6  # with one set-point
FRACTION = 0.85
FRICTION = Found(  # of an axis that the twin does not have: its torques fit every motor's range
    coulomb=Quantity(0.2, 0.19, 0.21, "N.m"),
    offset=Quantity(0.15, 0.14, 0.16, "N.m"),
    viscous=Quantity(2e-3, 1.9e-3, 2.1e-3, "N.m.s/rad"),
)


def to_both_sides(size: float, at: float = 0.0) -> Plan[None]:
    """A little to one side, a little to the other, and back."""
    for value in (size, -size, 0.0):
        for _ in range(CYCLES):
            _sample: Sample = yield at + value


def another(parameter: Parameter, raw: int) -> int:
    """A raw value beside `raw` that may be written."""
    return next((value for value in (raw + 1, raw - 1) if parameter.allows(value)), raw)


def not_allowed(parameter: Parameter) -> list[int]:
    """Raw values that the type holds, and that must not be written."""
    if parameter.protection in (Protection.READ, Protection.COMMAND, Protection.MAINTENANCE):
        return [1] if parameter.protection is Protection.READ else []
    found = list(parameter.forbidden)
    if not parameter.is_float:
        low, high = parameter.range
        least, most = parameter.address.raw_range
        found += [int(high) + 1] * (high < most) + [int(low) - 1] * (low > least)
    return found


def _bits(condition: Condition, parameter: Parameter) -> list[int]:
    """The bits that a condition is about, as the type holds them."""
    width = WIDTH_BITS[parameter.address.type] - parameter.address.type.startswith("i")
    return [1 << n for n in range(width) if condition.mask >> n & 1]


def unlike(condition: Condition, parameter: Parameter) -> int:
    """A raw value with which a condition does not hold."""
    if condition.differs is not None:
        return condition.differs
    bits = _bits(condition, parameter)
    return next(raw for raw in (0, sum(bits), *bits) if not condition.holds(raw))


def like(condition: Condition, parameter: Parameter) -> int:
    """A raw value with which a condition holds that names the one with which it does not."""
    assert condition.differs is not None
    return condition.differs ^ _bits(condition, parameter)[0]


class WornJournal:
    """A journal by which the drive has stored as often as its memory takes."""

    def __init__(self, journal: Journal, most: int) -> None:
        self._journal = journal
        self._most = most

    def stores(self, run: str) -> int:
        """How often."""
        return self._most

    def note_stored(self, run: str, text: str) -> None:
        """It is not to come so far."""
