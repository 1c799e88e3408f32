"""A record of an axis in torque mode, and where its velocity changes sign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commissioning.identification.limit_cycle import reversal

__all__ = [
    "Kinematics", "Record", "kinematics", "resolution_of", "rests", "reversals", "trusted",
    "unfiltered",
]  # fmt: skip

Array = NDArray[np.float64]

_STALL = 1.5  # cycles
_WHOLE = 0.05  # of a count
_TURN_COUNTS = 4  # a reversal counts when the axis then moves by more than this many counts
_FEW_SAMPLES = 30  # in half a period: below, a spline finds reversals better than parabolas
_STILL, _STILL_SAMPLES = 0.02, 8  # s and samples within which an axis that moves leaves its place
_TURN_SHARE = 0.02  # … and by this share of its whole swing


@dataclass(frozen=True, slots=True)
class Record:
    """One uninterrupted record.

    Attributes
    ----------
    time : (n,) s, increasing, when each position was latched
    position : (n,) rad or m
    sent : (m,) s, increasing, when each command left; it holds until the next one
    command : (m,) N.m or N
    resolution : of the position, rad or m
    """

    time: Array
    position: Array
    sent: Array
    command: Array
    resolution: float

    @classmethod
    def of(
        cls,
        time: ArrayLike,
        position: ArrayLike,
        sent: ArrayLike,
        command: ArrayLike,
        resolution: float,
    ) -> Record:
        """From anything that looks like arrays."""
        return cls(
            np.asarray(time, float),
            np.asarray(position, float),
            np.asarray(sent, float),
            np.asarray(command, float),
            resolution,
        )

    def between(self, begin: float, end: float) -> Record:
        """Positions of begin ≤ time ≤ end (s), with all commands."""
        cut = (self.time >= begin) & (self.time <= end)
        return Record(self.time[cut], self.position[cut], self.sent, self.command, self.resolution)


def trusted(lateness: Array, cycle: float) -> NDArray[np.bool_]:
    """Samples whose stamps are right, (n,).

    A host that stalls within an exchange stamps it wrongly; the next one's lateness shows it.

    Parameters
    ----------
    lateness : (n,) s, of each exchange
    cycle : s
    """
    return np.append(lateness[1:], lateness[-1:]) <= _STALL * cycle


def resolution_of(position: Array) -> float:
    """Of positions that are whole counts the count, else about the smallest step; rad or m."""
    steps = np.abs(np.diff(position))
    moving = steps[steps > 1e-9 * float(np.ptp(position))]
    if not len(moving):
        return 0.0
    least = float(moving.min())
    counts = moving / least
    if np.all(np.abs(counts - np.round(counts)) < _WHOLE * np.maximum(1.0, 1e-3 * counts)):
        return least
    return float(np.quantile(moving, 0.01))


def unfiltered(record: Record, corner: float) -> Record:
    """The record with a first-order filter in its position undone, y + ẏ/corner (G_out, 4.4).

    Parameters
    ----------
    corner : rad/s
    """
    from scipy.interpolate import make_lsq_spline

    # behind a filter the position has no kinks: a spline through every third sample keeps it
    t = record.time
    inner = t[3 : len(t) - 3 : 3]
    knots = np.concatenate(([t[0]] * 4, inner, [t[-1]] * 4))
    smooth = make_lsq_spline(t, record.position, knots, 3)
    position = record.position + smooth.derivative()(t) / corner
    return Record(t, position, record.sent, record.command, record.resolution)


@dataclass(frozen=True, slots=True)
class Kinematics:
    """What is known of the velocity.

    Attributes
    ----------
    instants : (m,) s, of its sign changes
    begins : its sign before the first
    speed : velocity at instants of any shape, rad/s or m/s
    """

    instants: Array
    begins: int
    speed: Callable[[Array], Array]


def kinematics(record: Record) -> Kinematics:
    """From the samples alone: parabolas at the reversals, a cubic spline elsewhere."""
    from scipy.interpolate import CubicSpline

    instants, begins = reversals(record)
    return Kinematics(instants, begins, CubicSpline(record.time, record.position).derivative())


def rests(record: Record) -> Array:
    """Begin and end of the stretches in which the axis stands still, (m, 2) s.

    Still: within two counts, or a millionth of the swing, for longer than 20 ms and eight samples.
    """
    t, y = record.time, record.position
    near = max(2 * record.resolution, 1e-6 * float(np.ptp(y)))
    step = float(np.median(np.diff(t)))
    span = max(round(_STILL / step), _STILL_SAMPLES)
    if len(y) <= span:
        return np.zeros((0, 2))
    windows = np.lib.stride_tricks.sliding_window_view(y, span)
    still = np.ptp(windows, axis=1) <= near
    change = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    begins, ends = change[::2], np.minimum(change[1::2] + span - 2, len(t) - 1)
    return np.column_stack((t[begins], t[ends]))


def reversals(record: Record) -> tuple[Array, int]:
    """Instants of the velocity reversals (s), and the sign of the velocity before the first.

    Good to a fraction of a sample.
    """
    y = record.position
    least = max(_TURN_COUNTS * record.resolution, _TURN_SHARE * float(np.ptp(y)))
    turning: list[int] = []
    low = high = 0
    direction = 0
    values = y.tolist()
    for k, value in enumerate(values):
        if value > values[high]:
            high = k
        if value < values[low]:
            low = k
        if direction >= 0 and values[high] - value > least:
            if direction > 0:
                turning.append(high)
            direction, low = -1, k
            high = k
        elif direction <= 0 and value - values[low] > least:
            if direction < 0:
                turning.append(low)
            direction, high = 1, k
            low = k
    begins = 1 if turning and values[turning[0]] > values[0] else -1
    samples = len(y) / max(len(turning), 1)  # of half a period
    locate = _by_spline if samples < _FEW_SAMPLES else _by_parabolas
    found = locate(record, turning)
    # neighbours must not pass each other
    return np.maximum.accumulate(found) if len(found) else found, begins


def _by_parabolas(record: Record, turning: list[int]) -> Array:
    """Mean of a parabola before and one after each reversal: noise averages out."""
    y = record.position
    at_samples = np.searchsorted(record.sent, record.time, side="right") - 1
    command = record.command[np.maximum(at_samples, 0)]
    instants = []
    for n, at in enumerate(turning):
        first = turning[n - 1] if n else 0
        last = turning[n + 1] if n + 1 < len(turning) else len(y)
        span = slice(first, last)
        top = y[at] > y[first] if at > first else y[at] > y[min(at + 1, len(y) - 1)]
        turned = y[span] - 0.5 * (y[at] + y[first])
        turned = turned if top else -turned
        instants.append(reversal(record.time[span], turned, command[span], at - first)[0])
    return np.array(instants)


def _by_spline(record: Record, turning: list[int]) -> Array:
    """Zero of the derivative of a cubic spline next to each turning sample.

    Few samples are enough.
    """
    from scipy.interpolate import CubicSpline

    time, y = record.time, record.position
    slope = CubicSpline(time, y).derivative()
    at = np.asarray(turning, int)
    low, high = time[np.maximum(at - 1, 0)], time[np.minimum(at + 1, len(time) - 1)]
    fine = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, 41)
    values = slope(fine)
    change = (values[:, :-1] * values[:, 1:] <= 0).argmax(axis=1)
    rows = np.arange(len(at))
    before, after = values[rows, change], values[rows, change + 1]
    share = np.where(before != after, before / np.where(before == after, 1, before - after), 0.5)
    result: Array = fine[rows, change] + share * (fine[rows, change + 1] - fine[rows, change])
    return result
