"""Two runs side by side: quantity by quantity, parameter by parameter."""

from __future__ import annotations

from typing import cast

from commissioning.result.changes import Change
from commissioning.result.document import RunResult
from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity
from commissioning.result.history import INDEXED, Compared, ComparedParameter, Comparison
from commissioning.result.words import change_state, number
from profiles.errors import UsageError

__all__ = ["compare", "compared"]

_ALIKE = 10.0  # K


def compare(first: RunResult, second: RunResult) -> Comparison:
    """The second run against the first; raises UsageError where one is linear, one rotary."""
    if first.units.position != second.units.position:
        raise UsageError(
            f"run {first.run} is in {first.units.effort}, run {second.run} in "
            f"{second.units.effort}: a rotary and a linear axis have nothing to compare"
        )
    quantities = (
        compared(name, getattr(first.friction, name), getattr(second.friction, name))
        for name in INDEXED
    )
    return Comparison(
        str(first.run),
        str(second.run),
        tuple(one for one in quantities if one is not None),
        _parameters(first, second),
        tuple(_remarks(first, second)),
    )


def compared(name: str, first: Quantity | None, second: Quantity | None) -> Compared | None:
    """A quantity of two runs; None where neither measured it."""
    unit = first.unit if first else second.unit if second else None
    if unit is None:
        return None
    if first is None or second is None or first.unit != second.unit:
        return Compared(name, unit, first, second, None, None)
    change = None
    if not _may_be_zero(first):
        change = 100 * (second.value - first.value) / abs(first.value)
    excluded: bool | None = None
    ends = first.low, first.high, second.low, second.high
    if None not in ends:
        first_low, first_high, second_low, second_high = cast("tuple[float, ...]", ends)
        excluded = second_low > first_high or first_low > second_high
    return Compared(name, unit, first, second, change, excluded)


def _may_be_zero(found: Quantity) -> bool:
    """Whether a change of it is no share of anything."""
    if found.low is None or found.high is None:
        return not found.value
    return found.low <= 0 <= found.high


# -- parameters -----------------------------------------------------------------------------------


def _parameters(first: RunResult, second: RunResult) -> tuple[ComparedParameter, ...]:
    ones, others = _changes(first), _changes(second)
    left = {w.parameter: w.raw for w in (*first.written, *second.written)}
    found = []
    for name in dict.fromkeys((*ones, *others, *left)):
        a, b = ones.get(name), others.get(name)
        one = a or b
        found.append(
            ComparedParameter(
                name, one.raw_unit if one else "", *_values(first, name, a),
                *_values(second, name, b),
            )
        )  # fmt: skip
    return tuple(found)


def _values(
    result: RunResult, name: str, change: Change | None
) -> tuple[int | None, int | None, str]:
    """What was there before, what the run has of it, and what became of that."""
    there = next((w.raw for w in result.written if w.parameter == name), None)
    if change is None:
        return None, there, "in the drive" if there is not None else ""
    return change.old_raw, change.new_raw, change_state(change, result)


def _changes(result: RunResult) -> dict[str, Change]:
    """What a run would change: compensation, and the gains that it proposes or has written."""
    found = {change.parameter: change for change in result.compensation}
    for gains in result.tuning:
        if gains.proposed or result.wrote(gains.parameters):
            for change in gains.parameters:
                found.setdefault(change.parameter, change)
    return found


# -- what else is not the same --------------------------------------------------------------------


def _remarks(first: RunResult, second: RunResult) -> list[str]:
    pairs = [
        ("axis", first.axis, second.axis),
        ("drive", _serial(first), _serial(second)),
        ("profile", _profile(first), _profile(second)),
        ("method", first.friction.method, second.friction.method),
        ("tworelay", _version(first), _version(second)),
        ("computer", first.host, second.host),
        ("link", first.link, second.link),
        ("cycle", _cycle(first), _cycle(second)),
        ("travel", _travel(first), _travel(second)),
    ]
    found = [
        f"another {what}: {a or 'not known'} and {b or 'not known'}"
        for what, a, b in pairs
        if a != b
    ]
    if first.quality.verdict != second.quality.verdict:
        found.append(
            f"verdicts: {first.quality.verdict or 'none'} and {second.quality.verdict or 'none'}"
        )
    return found + _conditions(first, second)


def _conditions(first: RunResult, second: RunResult) -> list[str]:
    here, there = first.conditions or Conditions(), second.conditions or Conditions()
    a, b = here.motor_temperature, there.motor_temperature
    found = []
    if a is None or b is None:
        found.append(
            "the motor's temperature is not known in "
            + ("both runs" if a is b else "one of the runs")
            + ": friction falls with it, by a percent a kelvin or so"
        )
    elif abs(a - b) > _ALIKE:
        found.append(
            f"the motor was at {number(a)} °C and at {number(b)} °C: that alone changes friction"
        )
    if here.third != there.third:
        known = None not in (here.third, there.third)
        found.append(
            "not in the same third of the travel"
            if known
            else "the place in the travel is known in one of the runs only"
        )
    return found


def _serial(result: RunResult) -> str | None:
    return result.identity.serial if result.identity else None


def _profile(result: RunResult) -> str | None:
    return f"{result.profile.name} {result.profile.version}" if result.profile else None


def _cycle(result: RunResult) -> str | None:
    return f"{1000 * result.experiment.cycle:.3g} ms" if result.experiment else None


def _travel(result: RunResult) -> str | None:
    if result.experiment is None or result.experiment.limits is None:
        return None
    return f"±{result.experiment.limits.travel:.4g} {result.units.position}"


def _version(result: RunResult) -> str | None:
    return result.tool.version if result.tool else None
