"""Whether the axis did what it was told: its torque, its rests, the counts of its position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import Record, reversals

__all__ = ["dwell_share", "is_unsigned", "of_torque", "torque_gain"]

Array = NDArray[np.float64]

_COARSE, _TOO_COARSE = 150, 30  # counts of half-swing
_DWELL, _MUCH_DWELL = 0.02, 0.15  # of the time
_TORQUE_OFF = 0.08  # of the command


def of_torque(
    gain: float | None, dwell: float, half_swing: float, resolution: float
) -> list[Reason]:
    """Reasons that the raw record gives: torque followed, rests, counts (half-swing in counts)."""
    reasons = []
    if gain is not None and abs(gain - 1) > _TORQUE_OFF:
        weight = Weight.CONTRADICTION if abs(gain - 1) > 0.3 else Weight.DOUBT
        reasons.append(
            Reason(
                "torque.scale",
                weight,
                f"the drive measures {100 * gain:.0f} % of the torque that is commanded: it "
                "limits, or its torque scale is wrong",
            )
        )
    if dwell > _DWELL:
        weight = Weight.CONTRADICTION if dwell > _MUCH_DWELL else Weight.DOUBT
        reasons.append(
            Reason(
                "axis.sticks",
                weight,
                f"the axis rests at its reversals for {100 * dwell:.0f} % of the time: it sticks; "
                "a larger torque (--max-torque) takes it through",
            )
        )
    counts = half_swing / resolution if resolution else np.inf
    if counts < _COARSE:
        reasons.append(
            Reason(
                "position.coarse",
                Weight.CONTRADICTION if counts < _TOO_COARSE else Weight.DOUBT,
                f"the smaller oscillation has a half-swing of {counts:.0f} encoder counts; "
                f"{_COARSE} are needed for a fine result: give more --travel",
            )
        )
    return reasons


def dwell_share(record: Record, inertia: float, coulomb: float) -> float:
    """Share of the time that the axis rests at its reversals, beyond what turning takes."""
    y, t = record.position, record.time
    instants, _ = reversals(record)
    if not len(instants) or not inertia > 0:
        return 0.0
    swing = record.command - np.median(record.command)
    pull = max(float(np.quantile(np.abs(swing), 0.5)) - coulomb, 0.1 * coulomb)
    reach = 1.5 * max(record.resolution, 1e-6 * float(np.ptp(y)))
    step = float(np.median(np.diff(t)))
    turning = 2 * np.sqrt(2 * reach * inertia / pull) + 3 * step
    rested = 0.0
    for at in np.searchsorted(t, instants):
        k = min(max(int(at), 0), len(y) - 1)
        first = last = k
        while first > 0 and abs(y[first - 1] - y[k]) <= reach:
            first -= 1
        while last < len(y) - 1 and abs(y[last + 1] - y[k]) <= reach:
            last += 1
        rested += max(t[last] - t[first] - turning, 0.0)
    return float(rested / (t[-1] - t[0]))


_AHEAD = 2  # cycles
_A_PUSH = 0.05  # of the largest command


def is_unsigned(measured: Array, command: Array) -> bool:
    """Whether a drive tells its torque without a sign.

    A command that pushes both ways, and never below zero.

    Parameters
    ----------
    measured, command : (n,) N.m or N, one a cycle
    """
    least = _A_PUSH * float(np.abs(command).max(initial=0.0))
    pushes_both_ways = min(-command.min(initial=0.0), command.max(initial=0.0)) > least
    return bool(
        pushes_both_ways
        and measured.min(initial=0.0) > -least
        and measured.max(initial=0.0) > least
    )


def torque_gain(measured: Array, command: Array) -> float | None:
    """Measured torque over commanded, at the lag that fits best; None where nothing is measured.

    A drive that always tells 0 measures nothing.

    Of a torque without a sign: mean size over mean size.

    A drive that is read some time after it was commanded shows the torque before the command is
    said to be in force: the lag may be a cycle or two the other way.

    Parameters
    ----------
    measured, command : (n,) N.m or N, one a cycle
    """
    if not np.isfinite(measured).all() or len(measured) < 50 or not np.any(measured):
        return None
    if is_unsigned(measured, command):
        return float(np.abs(measured).mean() / max(np.abs(command).mean(), 1e-300))
    m, c = measured - measured.mean(), command - command.mean()
    gains, misses = [], []
    for lag in range(-_AHEAD, min(40, len(c) // 8)):
        a, b = (m[lag:], c[: len(c) - lag]) if lag >= 0 else (m[:lag], c[-lag:])
        gain = float(a @ b) / max(float(b @ b), 1e-300)
        gains.append(gain)
        misses.append(float(np.mean((a - gain * b) ** 2)))
    return gains[int(np.argmin(misses))]
