"""What a limit cycle is: period, half-swing, fundamental, duty; and whether it has settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["LimitCycle", "Periods", "measure", "periods_of", "settled"]

Array = NDArray[np.float64]

FEWEST = 6  # periods for a mean: a sampled relay wanders by some samples (method.md 2)
_SAMPLES_A_PERIOD = 8  # below this a period is no period
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
    """

    start: Array
    period: Array
    half_swing: Array
    fundamental: Array
    direction: Array
    command: Array
    duty: Array
    peak_speed: Array

    def __len__(self) -> int:
        return len(self.period)

    def last(self, count: int) -> Periods:
        """The last `count` periods."""
        return Periods(*(getattr(self, name)[-count:] for name in self.__slots__))


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
        rows.append(row)
    columns = np.array(rows, float).reshape(len(rows), 8).T
    return Periods(*columns)


def _one(
    t: Array, y: Array, u: Array, begin: float, end: float, bias: float
) -> tuple[float, ...]:
    period = end - begin
    top_time, top = _reversal(t, y, int(np.argmax(y)))
    bottom_time, bottom = _reversal(t, y, int(np.argmin(y)))
    falling = bottom_time - top_time  # the record begins rising
    w = 2 * np.pi / period
    steps = np.diff(np.concatenate(([begin], t, [end])))
    weights = 0.5 * (steps[:-1] + steps[1:])
    fundamental = 2 / period * abs(np.sum(weights * y * np.exp(-1j * w * t)))
    speed = np.max(np.abs(np.diff(y) / np.diff(t)))
    high = np.clip((u - bias) / max(np.max(np.abs(u - bias)), 1e-300), -1, 1)
    return (
        begin,
        period,
        (top - bottom) / 2,
        fundamental,
        1 - 2 * falling / period,
        float(np.mean(u)),
        float(np.mean(0.5 + 0.5 * high)),
        speed,
    )


def _reversal(t: Array, y: Array, at: int) -> tuple[float, float]:
    """Instant and position of a reversal: each side of it is a parabola of its own.

    Deceleration (d+f)/J before, (d−f)/J after: a fit across the reversal would smear it.
    """
    width = max(4, round(_PEAK_SHARE * len(t)))
    found = []
    for side in (slice(max(0, at - width), at), slice(at + 1, at + 1 + width)):
        ts, ys = t[side] - t[at], y[side]
        if len(ts) < 4:
            continue
        scale = max(abs(ts[0]), abs(ts[-1]))
        c2, c1, c0 = np.polyfit(ts / scale, ys, 2)
        if c2 * (1 if y[at] >= 0 else -1) >= 0:
            continue
        vertex = -c1 / (2 * c2)
        if abs(vertex) <= 1:
            found.append((t[at] + vertex * scale, c0 - c1**2 / (4 * c2)))
    if not found:
        return float(t[at]), float(y[at])
    instants, peaks = zip(*found, strict=True)
    return float(np.mean(instants)), float(np.mean(peaks))


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
    scatter = np.sqrt((np.var(before, ddof=1) + np.var(after, ddof=1)) / half)
    return bool(abs(np.mean(after) - np.mean(before)) <= max(resolution, 2 * scatter))


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
