"""What a limit cycle is: period, half-swing, fundamental, duty; and whether it has settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["LimitCycle", "Periods", "measure", "periods_of", "reversal", "settled"]

Array = NDArray[np.float64]

FEWEST = 6  # periods for a mean: a sampled relay wanders by some samples (method.md 2)
_SAMPLES_A_PERIOD = 8  # below this a period is no period
_FEWEST_POINTS = 3  # for a parabola
_TORQUE_SETTLES = 2  # samples after a change of the command until the axis feels it
_LATE = 1.5  # cycles between two samples: a period with more is disturbed
_PEAK_SHARE = 0.05  # of a period: samples on each side of a reversal that are fitted


@dataclass(frozen=True, slots=True)
class Periods:
    """Every whole period of a record, one array element each.

    Attributes
    ----------
    start : s, upward crossing of the reference
    period : s
    half_swing : rad or m
    fundamental : rad or m, amplitude (half-swing) of the first harmonic
    direction : mean of sign(velocity)
    command : mean of the torque command, N.m or N
    duty : share of the period with the relay high
    peak_speed : largest speed, rad/s or m/s
    gap : longest time between two samples, s
    """

    start: Array
    period: Array
    half_swing: Array
    fundamental: Array
    direction: Array
    command: Array
    duty: Array
    peak_speed: Array
    gap: Array

    def __len__(self) -> int:
        return len(self.period)

    def followed_by(self, other: Periods) -> Periods:
        """These and then the `other` periods."""
        return Periods(
            *(
                np.concatenate((getattr(self, name), getattr(other, name)))
                for name in self.__slots__
            )
        )

    def last(self, count: int) -> Periods:
        """The last `count` periods."""
        return self._part(slice(max(len(self) - count, 0), None))

    def settling(self, transient: int, cycle: float, recovery: int) -> Periods:
        """Without the first `transient`, and those with a late sample.

        Nor the `recovery` after each of these.

        A relay that is asked too late switches too late: the axis swings further, and again back.
        """
        late = self.gap > _LATE * cycle
        for _ in range(recovery):
            late[1:] |= late[:-1].copy()
        late[:transient] = True
        return self._part(~late)

    def _part(self, which: slice | NDArray[np.bool_]) -> Periods:
        return Periods(*(getattr(self, name)[which] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """Means over whole periods with their standard errors.

    Attributes
    ----------
    relay_amplitude, hysteresis, bias : of the relay that made it (N.m or N, rad or m, N.m or N)
    period, period_error : s
    half_swing, half_swing_error : rad or m
    fundamental : rad or m, half-swing of the first harmonic
    direction : mean of sign(velocity), 0 when both directions take the same time
    command : mean torque command, N.m or N
    duty : share of time with the relay high
    peak_speed : rad/s or m/s
    periods : how many were averaged
    settled : whether the record says that it repeats
    """

    relay_amplitude: float
    hysteresis: float
    bias: float
    period: float
    period_error: float
    half_swing: float
    half_swing_error: float
    fundamental: float
    direction: float
    command: float
    duty: float
    peak_speed: float
    periods: int
    settled: bool

    @property
    def frequency(self) -> float:
        """Angular frequency, rad/s."""
        return 2 * np.pi / self.period


def periods_of(
    time: ArrayLike, position: ArrayLike, command: ArrayLike, reference: float, bias: float = 0.0
) -> Periods:
    """Cut a record into whole periods at the upward crossings of `reference`.

    Parameters
    ----------
    time : (n,) s, increasing
    position : (n,) rad or m, latched at `time`
    command : (n,) N.m or N, in force before `time`
    reference : rad or m
    bias : N.m or N, centre of the relay's output
    """
    t = np.asarray(time, float)
    y = np.asarray(position, float) - reference
    u = np.asarray(command, float)
    rising = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    crossings = t[rising] - y[rising] * (t[rising + 1] - t[rising]) / (y[rising + 1] - y[rising])
    rows = []
    for k in range(len(rising) - 1):
        first, last = rising[k] + 1, rising[k + 1] + 1
        if last - first < _SAMPLES_A_PERIOD:
            continue
        row = _one(
            t[first:last], y[first:last], u[first:last], crossings[k], crossings[k + 1], bias
        )
        rows.append((*row, np.diff(t[first - 1 : last + 1]).max()))
    columns = np.array(rows, float).reshape(len(rows), 9).T
    return Periods(*columns)


def _one(t: Array, y: Array, u: Array, begin: float, end: float, bias: float) -> tuple[float, ...]:
    period = end - begin
    top_time, top = reversal(t, y, u, int(y.argmax()))
    bottom_time, bottom = reversal(t, y, u, int(y.argmin()))
    falling = bottom_time - top_time  # the record begins rising
    steps = np.empty(len(t) + 1)
    steps[0], steps[1:-1], steps[-1] = t[0] - begin, t[1:] - t[:-1], end - t[-1]
    weights = 0.5 * (steps[:-1] + steps[1:])
    fundamental = 2 / period * abs(np.exp(t * (-2j * np.pi / period)) @ (weights * y))
    speed = np.abs((y[1:] - y[:-1]) / steps[1:-1]).max()
    mean = float(u.sum()) / len(u)
    swing = max(float(u.max()) - bias, bias - float(u.min()), 1e-300)
    return (
        begin,
        period,
        (top - bottom) / 2,
        fundamental,
        1 - 2 * falling / period,
        mean,
        0.5 + 0.5 * (mean - bias) / swing,
        speed,
    )


def reversal(t: Array, y: Array, u: Array, at: int) -> tuple[float, float]:
    """Instant and position of a reversal: each side of it is a parabola of its own.

    Deceleration (d+f)/J before, (d−f)/J after: a fit across the reversal would smear it, and so
    would one across the switching of the torque before it.
    """
    width = max(4, round(_PEAK_SHARE * len(t)))
    turn = 1.0 if y[at] >= 0 else -1.0
    begin = float(t[at])
    first = max(0, at - width)
    changed = np.flatnonzero(np.diff(u[first:at]))
    if len(changed):
        first += int(changed[-1]) + _TORQUE_SETTLES
    instants, peaks = [], []
    for side in (slice(first, at), slice(at + 1, at + 1 + width)):
        ts, ys = t[side].tolist(), y[side].tolist()
        if len(ts) < _FEWEST_POINTS:
            continue
        scale = max(abs(ts[0] - begin), abs(ts[-1] - begin))
        c2, c1, c0 = _quadratic([(x - begin) / scale for x in ts], ys)
        if c2 * turn >= 0:
            continue
        vertex = -c1 / (2 * c2)
        if abs(vertex) <= 1:
            instants.append(begin + vertex * scale)
            peaks.append(c0 - c1**2 / (4 * c2))
    if not instants:
        return begin, float(y[at])
    return sum(instants) / len(instants), sum(peaks) / len(peaks)


def _quadratic(x: list[float], y: list[float]) -> tuple[float, float, float]:
    """Least-squares parabola c2·x² + c1·x + c0; a handful of points, x of order one.

    Normal equations about the mean of x, solved by hand: an array call costs more than the sums.
    """
    n = len(x)
    centre, level = sum(x) / n, sum(y) / n
    s2 = s3 = s4 = t1 = t2 = 0.0
    for xi, yi in zip(x, y, strict=True):
        v, w = xi - centre, yi - level
        v2 = v * v
        s2 += v2
        s3 += v2 * v
        s4 += v2 * v2
        t1 += v * w
        t2 += v2 * w
    determinant = s2 * (s4 - s2 * s2 / n) - s3 * s3
    if determinant <= 0:
        return 0.0, 0.0, level
    c2 = (t2 * s2 - t1 * s3) / determinant
    c1 = (t1 - c2 * s3) / s2
    c0 = level - c2 * s2 / n
    return c2, c1 - 2 * c2 * centre, c0 - c1 * centre + c2 * centre * centre


def settled(values: Array, resolution: float) -> bool:
    """Whether the last values repeat: no trend beyond twice the scatter of the means.

    Judged on two halves of at least six values, so that the wander of a sampled relay, which never
    ends, does not count as a transient.

    Parameters
    ----------
    values : (n,) period or half-swing of successive periods
    resolution : a difference of means this small is no trend, same unit
    """
    n = len(values)
    if n < FEWEST:
        return False
    half = n // 2
    before, after = values[-2 * half : -half], values[-half:]
    first, second = before.sum() / half, after.sum() / half
    variance = (((before - first) ** 2).sum() + ((after - second) ** 2).sum()) / (half - 1)
    scatter = float(variance / half) ** 0.5
    return bool(abs(second - first) <= max(resolution, 2 * scatter))


def measure(
    periods: Periods, relay_amplitude: float, hysteresis: float, bias: float, *, is_settled: bool
) -> LimitCycle:
    """Average whole periods into one limit cycle."""
    n = len(periods)

    def error(values: Array) -> float:
        return float(np.std(values, ddof=1) / np.sqrt(n)) if n > 1 else float("inf")

    return LimitCycle(
        relay_amplitude,
        hysteresis,
        bias,
        float(np.mean(periods.period)),
        error(periods.period),
        float(np.mean(periods.half_swing)),
        error(periods.half_swing),
        float(np.mean(periods.fundamental)),
        float(np.mean(periods.direction)),
        float(np.mean(periods.command)),
        float(np.mean(periods.duty)),
        float(np.max(periods.peak_speed)),
        n,
        is_settled,
    )
