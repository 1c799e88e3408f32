"""Where a record oscillates steadily, and with what period and swing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from commissioning.identification.record import Kinematics, Record

__all__ = ["Steady", "pair", "steady_oscillations"]

_SAME_PERIOD, _SAME_SWING = 0.03, 0.08  # of the mean: a sampled relay wanders by so much
_FEWEST = 5  # periods
_ONE_PERIOD = 0.006  # of it: two oscillations that count as of one period
_APART = 1.15  # ratio of half-swings that tells two oscillations apart
_AFTER_REVERSAL = 1 / 16  # of a period


@dataclass(frozen=True, slots=True)
class Steady:
    """One steady oscillation.

    Attributes
    ----------
    begin : s, a little after a reversal
    period : s
    periods : whole ones
    half_swing : rad or m
    """

    begin: float
    period: float
    periods: int
    half_swing: float


def steady_oscillations(record: Record, kinematics: Kinematics) -> list[Steady]:
    """Stretches of periods that repeat, in the order of time."""
    at = kinematics.instants
    if len(at) < 2 * _FEWEST + 1:
        return []
    swings = np.abs(np.diff(np.interp(at, record.time, record.position))) / 2
    periods = at[2:] - at[:-2]
    found = []
    first = 0
    while first < len(periods):
        last = first + 1
        while last < len(periods):
            period, swing = periods[first:last].mean(), swings[first:last].mean()
            if abs(periods[last] / period - 1) > _SAME_PERIOD:
                break
            if abs(swings[last] / swing - 1) > _SAME_SWING:
                break
            last += 1
        whole = (last - first) // 2
        if whole >= _FEWEST:
            period = float((at[first + 2 * whole] - at[first]) / whole)
            found.append(
                Steady(
                    float(at[first] + _AFTER_REVERSAL * period),
                    period,
                    whole - 1,
                    float(swings[first:last].mean()),
                )
            )
        first = last
    return found


def pair(found: list[Steady]) -> tuple[Steady, Steady] | None:
    """Two oscillations of one period and different swing, those with most periods.

    None: there are none.
    """
    best = None
    for a in found:
        for b in found:
            same = abs(a.period / b.period - 1) <= _ONE_PERIOD
            apart = b.half_swing >= _APART * a.half_swing
            if same and apart:
                size = min(a.periods, b.periods)
                if best is None or size > best[0]:
                    best = (size, a, b)
    return None if best is None else (best[1], best[2])
