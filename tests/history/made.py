"""Runs as the index has them, made for a test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity
from commissioning.result.history import IndexedRun

DAY = 86400.0
MARCH_3 = 1_772_500_000.0  # 3 March 2026, s since 1970


def run(number: int, value: float, *, half: float = 0.002, **about: object) -> IndexedRun:
    """A run that measured Coulomb friction; `half` of its 95 % interval, N.m."""
    conditions = about.pop("conditions", Conditions(motor_temperature=40.0, third=1))
    made = IndexedRun(
        f"r{number}", number, MARCH_3 + 7 * DAY * number, "x", "0x1", "modbus-tcp://a", False,
        host="here", version="1.0.0", method="modulating", verdict="good",
        quantities={"coulomb": Quantity(value, value - half, value + half, "N.m")},
        conditions=conditions,
    )  # fmt: skip
    return replace(made, **about)


def runs(values: Sequence[float], **about: object) -> list[IndexedRun]:
    """Runs a week apart."""
    return [run(n, value, **about) for n, value in enumerate(values, 1)]
