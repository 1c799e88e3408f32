"""How much better friction that bends with the speed would explain positions: no fit, one pass.

A law that may take on its shape – drag, a share of the torque – explains a Stribeck curve in part,
and gives another level. So the curve itself is tried beside it: the small torque that it would add
along the motion, and how positions answer to that. A reversal that comes earlier or later leaves
the speed behind it larger or smaller by the ratio of the accelerations before and after it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.position_fit import NUMBER, PositionFit

__all__ = ["SPEEDS", "stribeck_columns"]

Array = NDArray[np.float64]

_A_PERIOD = 240  # points of integration
SPEEDS = np.geomspace(0.003, 0.6, 9)  # of the peak speed, at which the curve has fallen by 1/e
_STEEPEST = 20.0  # ratio of accelerations about a reversal


def stribeck_columns(fit: PositionFit) -> Array:
    """Answers of the positions (s, n, k) to curves that fall within k different speeds.

    Projected beyond what first states can take; each per N.m or N of the curve's height.
    """
    segments, p = fit.segments, fit.axis
    begin, end = segments.time[:, :1], segments.time[:, -1:]
    count = max(int(np.ceil(float((end - begin).max()) / segments.period * _A_PERIOD)), 8)
    time = begin + (end - begin) * np.linspace(0, 1, count)
    x = segments.positions_at(p, fit.states, time)
    h = (end - begin)[:, 0] / (count - 1)
    v = np.gradient(x, axis=1) / h[:, None]
    push = _pushes(v, SPEEDS * segments.speed) / p[NUMBER["inertia"]]
    moved = _moved(push, v, h, p[NUMBER["viscous"]] / p[NUMBER["inertia"]])
    columns = np.zeros((*segments.time.shape, len(SPEEDS)))
    for k in range(len(time)):
        for n in range(len(SPEEDS)):
            columns[k, :, n] = np.interp(segments.time[k], time[k], moved[k, :, n])
    return fit.projected(np.where(segments.is_there[:, :, None], columns, 0.0))


def _pushes(v: Array, falls: Array) -> Array:
    """Mean of −sign(v)·e^(−|v|/fall) over each step of speeds (s, m), (s, m−1, k)."""
    before, after = v[:, :-1, None], v[:, 1:, None]
    # its integral over the speed, which is even and grows from 0
    whole = [falls * (1 - np.exp(-np.abs(one) / falls)) for one in (before, after)]
    change = after - before
    steady = np.abs(change) < 1e-3 * falls
    level = np.sign(before) * np.exp(-np.abs(before) / falls)
    mean = (whole[1] - whole[0]) / np.where(steady, 1.0, change)
    result: Array = -np.where(steady, level, mean)
    return result


def _moved(push: Array, v: Array, h: Array, rate: float) -> Array:
    """Positions that accelerations (s, m−1, k) add to a motion with the speeds `v` (s, m)."""
    faded = np.exp(-rate * h)[:, None]
    jumps = _jumps(v)
    speed = np.zeros((push.shape[0], push.shape[2]))
    moved = np.zeros((*v.shape, push.shape[2]))
    for i in range(1, v.shape[1]):
        before = speed
        speed = faded * speed + h[:, None] * push[:, i - 1]
        speed = speed * jumps[:, i, None]
        moved[:, i] = moved[:, i - 1] + 0.5 * h[:, None] * (before + speed)
    return moved


def _jumps(v: Array) -> Array:
    """By which a difference of the speed is larger after each point than before: at reversals."""
    jumps = np.ones_like(v)
    rows, at = np.nonzero(v[:, :-1] * v[:, 1:] < 0)
    inside = (at >= 3) & (at < v.shape[1] - 4)
    rows, at = rows[inside], at[inside]
    before, after = v[rows, at - 1] - v[rows, at - 3], v[rows, at + 4] - v[rows, at + 2]
    ratio = after / np.where(before == 0, np.inf, before)
    jumps[rows, at + 1] = np.clip(ratio, 1 / _STEEPEST, _STEEPEST)
    return jumps
