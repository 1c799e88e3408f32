"""What friction depends on beside wear: temperature, time since power-up, place."""

from __future__ import annotations

from typing import Literal

from commissioning.result.experiment import Conditions
from drivers.drive import Drive
from drivers.errors import AccessDenied
from profiles.axis import Axis

__all__ = ["conditions"]


def conditions(
    drive: Drive, axis: Axis, position: float, motor_temperature: float | None
) -> Conditions:
    """The conditions now, rad or m, °C, as far as the drive tells them.

    `motor_temperature` : as somebody measured it, °C; it is taken before the drive's own

    Raises LinkError.
    """
    seen = {name: _told(drive, parameter) for name, parameter in drive.conditions.items()}
    if motor_temperature is not None:
        seen["motor_temperature"] = motor_temperature
    third = None if axis.limits.ends is None else _third(axis.limits.ends, position)
    return Conditions(**seen, position=position, third=third, cycle=drive.cycle)


def _told(drive: Drive, parameter: str) -> float | None:
    """What a drive says of itself; None where this one does not."""
    try:
        return drive.read(parameter).si
    except AccessDenied:
        return None


def _third(ends: tuple[float, float], position: float) -> Literal[0, 1, 2]:
    """Which third of the travel a position lies in."""
    share = (position - ends[0]) / (ends[1] - ends[0])
    return 0 if share < 1 / 3 else 1 if share < 2 / 3 else 2
