"""A step of the loop on a virtual axis with the friction that was found: what margins do not show.

The axis is the virtual drive's own, in closed form; the position is rounded to the encoder's
resolution.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from commissioning.tuning.controllers import Gains, law
from commissioning.tuning.plant import LoopPlant
from drivers.virtual.plant import Plant, PlantParameters

__all__ = ["Friction", "StepCourse", "step"]

Array = NDArray[np.float64]

_CROSSOVERS, _MOVES = 80.0, 6.0  # that a step is followed for: of the loop, and of the torque limit
_FEWEST, _MOST = 400, 8000  # samples
_BAND = 0.02  # of the step: settled
_TAIL = 1 / 3  # of the record, in which the axis should stand
_COUNTS = 2.5  # encoder counts of half-swing that are no hunting
_SHOWN = 300  # points of the picture
_RUNAWAY = 20.0  # times the step: the loop is unstable


@dataclass(frozen=True, slots=True)
class Friction:
    """What resists, and what the drive can do about it.

    Attributes
    ----------
    coulomb, breakaway, offset : N.m or N
    limit : largest torque, N.m or N
    resolution : of the position, rad or m
    """

    coulomb: float
    breakaway: float
    offset: float
    limit: float
    resolution: float


@dataclass(frozen=True, slots=True)
class StepCourse:
    """What the axis does after a step of the reference.

    Attributes
    ----------
    size : of the step, rad or m
    overshoot : share of the step
    settling : s, until the position stays within 2 % of the step; None: it never does
    error : mean distance from the goal at the end, rad or m
    hunting : half-swing at the end, rad or m; 0 within what the encoder resolves
    time, position : the picture, s and rad or m
    """

    size: float
    overshoot: float
    settling: float | None
    error: float
    hunting: float
    time: Array
    position: Array


def step(
    plant: LoopPlant, gains: Gains, friction: Friction, size: float, crossover: float
) -> StepCourse:
    """Follow a step of `size` (rad or m) for some periods of `crossover` (rad/s)."""
    axis = Plant(
        PlantParameters(
            plant.inertia,
            max(plant.viscous, 0.0),
            friction.coulomb,
            max(friction.breakaway, friction.coulomb),
            friction.offset,
        )
    )
    cycle, resolution = plant.cycle, friction.resolution
    spare = max(friction.limit - friction.coulomb - abs(friction.offset), 0.05 * friction.limit)
    move = 2 * sqrt(size * plant.inertia / spare)  # as fast as the torque allows
    duration = _CROSSOVERS / crossover + _MOVES * move
    if duration > _MOST * cycle:  # a loop that is slow against its cycle: fewer, longer cycles do
        cycle = duration / _MOST
        plant = replace(plant, cycle=cycle)
    count = int(max(duration / cycle, _FEWEST))
    controller = law(gains, cycle, friction.limit, 0.0, friction.offset)
    waiting = deque([friction.offset] * max(plant.cycles - 1, 0))
    late = plant.split
    positions = np.empty(count)
    before = friction.offset
    for k in range(count):
        seen = round(axis.position / resolution) * resolution
        positions[k] = axis.position
        if abs(axis.position) > _RUNAWAY * size:
            positions[k:] = axis.position
            break
        waiting.append(controller(size, seen))
        if late > 0:
            axis.advance(late, before)
        before = waiting.popleft()
        if cycle > late:
            axis.advance(cycle - late, before)
    return _told(positions, size, cycle, resolution)


def _told(positions: Array, size: float, cycle: float, resolution: float) -> StepCourse:
    time = np.asarray(np.arange(len(positions)) * cycle, np.float64)
    tail = positions[-max(int(_TAIL * len(positions)), 2) :]
    swing = float(np.ptp(tail)) / 2
    band = max(_BAND * size, 2 * resolution)
    outside = np.flatnonzero(np.abs(positions - size) > band)
    last = int(outside[-1]) + 1 if len(outside) else 0
    stride = max(len(positions) // _SHOWN, 1)
    return StepCourse(
        size,
        max(float(positions.max()) / size - 1, 0.0),
        float(time[last]) if last < len(positions) - len(tail) // 2 else None,
        float(np.mean(tail)) - size,
        swing if swing > _COUNTS * resolution else 0.0,
        time[::stride],
        positions[::stride],
    )
