"""A number and how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Estimate"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its interval, same unit; `low` ≤ truth ≤ `high` in 19 of 20 cases.

    The interval is the scatter of the data and a stated systematic part.
    """

    value: float
    low: float
    high: float

    @classmethod
    def around(cls, value: float, scatter: float, systematic: float) -> Estimate:
        """`value` ± (twice the standard error `scatter`, and `systematic` on top)."""
        half = 2 * scatter + systematic
        return cls(value, value - half, value + half)

    @property
    def half_width(self) -> float:
        """Half of the interval as a share of the value; infinite for 0."""
        if self.value == 0:
            return float("inf")
        return (self.high - self.low) / (2 * abs(self.value))
