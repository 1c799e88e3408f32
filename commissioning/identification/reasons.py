"""What speaks about a measurement, and what that makes of its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

__all__ = ["Reason", "Verdict", "Weight", "verdict", "weightiest_first"]

Verdict = Literal["good", "usable", "rejected", "curve-only"]


class Weight(StrEnum):
    """What a reason does to the verdict, the lightest first."""

    NOTE = "note"
    DOUBT = "doubt"
    CONTRADICTION = "contradiction"


@dataclass(frozen=True, slots=True)
class Reason:
    """What speaks about a measurement.

    Attributes
    ----------
    code : stable name, for programs
    text : one line for people
    """

    code: str
    weight: Weight
    text: str


def verdict(reasons: Sequence[Reason]) -> Verdict:
    """What the weightiest of the reasons makes of the numbers."""
    weights = {reason.weight for reason in reasons}
    if Weight.CONTRADICTION in weights:
        return "rejected"
    return "usable" if Weight.DOUBT in weights else "good"


def weightiest_first(reasons: Sequence[Reason]) -> list[Reason]:
    """The reasons by weight, else in their order."""
    order = list(Weight)
    return sorted(reasons, key=lambda reason: -order.index(reason.weight))
