"""Options that are a number and its unit: '0,5', '12 deg', '3000 rpm', '4ms', '85 %'."""

from __future__ import annotations

from typing import Any

import click

from profiles.errors import UsageError
from profiles.quantities import Kind, UnitOfUse, parse, units_of

__all__ = [
    "DURATION", "FREQUENCY", "PER_CENT", "POSITION", "SHARE", "SPEED", "TEMPERATURE", "TORQUE",
    "Given", "Measure", "of_the_axis",
]  # fmt: skip


class Given(float):
    """A number in SI with the unit that it was written in; None: none was."""

    unit: UnitOfUse | None = None


class Measure(click.ParamType[Given]):
    """A number in a range, in SI where it has no unit.

    Parameters
    ----------
    kinds : of the units that are meant
    low, high : SI, None: none
    above : `low` itself is too little
    """

    name = "quantity"

    def __init__(
        self,
        *kinds: Kind,
        low: float | None = None,
        high: float | None = None,
        above: bool = False,
    ) -> None:
        self.kinds, self.low, self.high, self.above = kinds, low, high, above

    def convert(self, value: Any, param: Any, ctx: Any) -> Given:
        """Text to SI."""
        text = str(value).strip()
        if self.kinds[:1] == ("position",):
            text = text.removeprefix("±").removeprefix("+-").strip()
        try:
            found = parse(text)
        except ValueError as error:
            self.fail(f"{error}; a number, as it is or in {units_of(*self.kinds)}.", param, ctx)
        unit = found.unit
        is_other = unit is not None and unit.kind not in self.kinds
        if unit is not None and (is_other or (unit.base and unit.kind != "share")):
            self.fail(f"'{text}' is in {unit.name}; it takes {units_of(*self.kinds)}.", param, ctx)
        si = found.si
        if not abs(si) < float("inf"):
            self.fail(f"{text} is no finite number.", param, ctx)
        is_low = self.low is not None and (si <= self.low if self.above else si < self.low)
        if is_low or (self.high is not None and si > self.high):
            self.fail(f"'{text}' is not in the range {self._range()}.", param, ctx)
        given = Given(si)
        given.unit = unit
        return given

    def _range(self) -> str:
        sign = "<" if self.above else "<="
        low = "" if self.low is None else f"{self.low:g}{sign}"
        return f"{low}x" + ("" if self.high is None else f"<={self.high:g}")


class _PerCent(Measure):
    """A number of per cent, with or without the sign."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Given:
        """Text to per cent."""
        text = str(value).strip()
        return super().convert(text.removesuffix("%"), param, ctx)


PER_CENT = _PerCent("share", low=0, high=1000)
POSITION = Measure("position", low=0, above=True)
TORQUE = Measure("torque", low=0, above=True)
SPEED = Measure("velocity", low=0, above=True)
DURATION = Measure("time", low=0, above=True)
FREQUENCY = Measure("frequency", "velocity", low=0, above=True)
SHARE = Measure("share", low=0, high=1)
TEMPERATURE = Measure("temperature", low=-100, high=300)


def of_the_axis(value: float | None, option: str, *, linear: bool) -> float | None:
    """A quantity of a rotary or a linear axis; raises UsageError where its unit is of the other."""
    unit = getattr(value, "unit", None)
    if value is None or unit is None or unit.linear is None or unit.linear is linear:
        return None if value is None else float(value)
    kind = "linear" if linear else "rotary"
    raise UsageError(
        f"{option} in {unit.name}: the axis is {kind}, and {unit.name} is of the other kind"
    )
