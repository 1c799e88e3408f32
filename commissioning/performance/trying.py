"""Values that try a profile: set-points, and raw values that are taken, or must not be."""

from __future__ import annotations

from commissioning.experiments.plan import Plan
from drivers.sample import Sample
from profiles.parameter import Parameter, Protection
from profiles.procedures import Condition, Step

__all__ = ["CYCLES", "another", "like", "not_allowed", "to_both_sides", "unlike", "writes_of"]

CYCLES = 6  # with one set-point


def to_both_sides(size: float, at: float = 0.0) -> Plan[None]:
    """A little to one side, a little to the other, and back."""
    for value in (size, -size, 0.0):
        for _ in range(CYCLES):
            _sample: Sample = yield at + value


def another(parameter: Parameter, raw: int) -> int:
    """A raw value beside `raw` that may be written."""
    low, high = parameter.range
    return next(value for value in (raw + 1, raw - 1) if low <= parameter.number(value) <= high)


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


def unlike(condition: Condition) -> int:
    """A raw value with which a condition does not hold."""
    if condition.differs is not None:
        return condition.differs
    every = condition.mask & 0x7FFF
    bits = [1 << n for n in range(15) if every >> n & 1]
    candidates = [0, every, *bits]
    return next(raw for raw in candidates if not condition.holds(raw))


def like(condition: Condition) -> int:
    """A raw value with which a condition holds that names the one with which it does not."""
    assert condition.differs is not None
    every = condition.mask & 0x7FFF
    return condition.differs ^ (every & -every)


def writes_of(steps: tuple[Step, ...]) -> set[tuple[str, int]]:
    """Names and raw values that the steps write."""
    return {
        (step.write, step.raw) for step in steps if step.write is not None and step.raw is not None
    }
