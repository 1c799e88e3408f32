"""How well an axis follows its position command.

Friction at reversals, at low speed and at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["TrackingError", "at_rest", "creeping", "reversal_error"]

Array = NDArray[np.float64]

_MIDDLE = 0.9  # of the greatest speed: from here on the lag is read
_SETTLED = 0.5  # of the rest: what comes before is not looked at
_COUNTS = 2.5  # of swing at rest: less is the encoder
_TURNS = 3  # of an axis at rest: it hunts


@dataclass(frozen=True, slots=True)
class TrackingError:
    """One run along the path, rad or m.

    Attributes
    ----------
    reversal : peak of the error after a reversal, about the velocity lag; mean of all reversals
    low_speed : rms of the error while it creeps, about its mean one way
    rest : half-swing of the position while the command stands still
    hunts : it turned around at rest, time and again
    """

    reversal: float
    low_speed: float
    rest: float
    hunts: bool


def reversal_error(command: Array, position: Array, turns: int) -> tuple[float, Array]:
    """Peak error after the reversals of a sinusoidal command, and the whole error, without lag.

    The peak is the mean of all.

    Where the speed is greatest the loop has settled, and what error is left is its lag; that is
    taken away in proportion to speed. Arrays (n,) of equally spaced samples over whole `turns`, the
    first of which begins at a reversal; rad or m.
    """
    error = command - position
    speed = np.sin(2 * np.pi * turns * np.arange(1, len(error) + 1) / len(error))
    up, down = error[speed > _MIDDLE].mean(), error[speed < -_MIDDLE].mean()
    lag = (up - down) / 2 / speed[speed > _MIDDLE].mean()
    left = error - lag * speed - (up + down) / 2
    peaks = [float(np.abs(part).max()) for part in np.array_split(left, 2 * turns)]
    return float(np.mean(peaks)), np.asarray(left, np.float64)


def creeping(command: Array, position: Array) -> float:
    """RMS error at a low speed out and back, each way about its own mean: what sticks and slips."""
    ways = np.array_split(command - position, 2)
    return float(np.sqrt(np.mean(np.concatenate([way - way.mean() for way in ways]) ** 2)))


def at_rest(position: Array, resolution: float) -> tuple[float, bool]:
    """Half-swing at rest, and whether the axis hunts: it turns around again and again."""
    settled = position[int(_SETTLED * len(position)) :]
    swing = float(np.ptp(settled)) / 2
    least = _COUNTS * resolution
    turns, direction, extreme = 0, 0, float(settled[0])
    for value in settled:
        moved = float(value) - extreme
        if direction == 0 and abs(moved) > least:
            direction, extreme = (1 if moved > 0 else -1), float(value)
        elif moved * direction > 0:
            extreme = float(value)
        elif -moved * direction > least:
            turns, direction, extreme = turns + 1, -direction, float(value)
    return swing, turns >= _TURNS
