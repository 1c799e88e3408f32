"""The plain types that travel from a drive upwards. Experiments see nothing else of the drivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["Sample", "Status"]


@dataclass(frozen=True, slots=True)
class Status:
    """What the drive says of itself with a sample.

    `stopping`: quick stop or fault reaction under way. `limit`: an internal limit acts, so that
    the command is not what the axis gets.
    """

    enabled: bool
    fault: bool
    stopping: bool
    limit: bool
    word: int


class Sample(NamedTuple):
    """One cyclic exchange.

    A tuple because there are thousands a second.

    Attributes
    ----------
    time : s, when the position was latched, by the best clock the link has
    position : rad or m
    torque : N.m or N, measured by the drive; nan where it is not
    command : set-point in force after rounding and limits, in the unit of the enabled mode
    sent : s, same clock, when that command left
    status : what the drive says of itself
    lateness : s, against the deadline of the cycle
    missed : cycles without a fresh sample just before this one
    """

    time: float
    position: float
    torque: float
    command: float
    sent: float
    status: Status
    lateness: float
    missed: int
