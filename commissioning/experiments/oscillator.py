"""A torque that oscillates at a given period about a centre (method.md 3).

A relay is good at finding a period, an oscillator at holding it. The axis has no centre of its own,
so a weak PD loop on position holds it where it is; what it adds is part of the measured torque.
"""

from __future__ import annotations

from cmath import exp
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi
from typing import Literal

import numpy as np

from commissioning.experiments.plan import Context, Plan
from commissioning.identification.limit_cycle import settled
from drivers.sample import Sample

__all__ = ["Held", "Oscillator", "Wave", "hold", "stop_at_reversal"]

Wave = Literal["square", "sine"]

_CROSSOVER = 1 / 6  # of the oscillation's frequency: a stronger loop eats the excitation
_DAMPING = 0.7
_SLOPE = 1 / 12  # of a period: samples that the velocity is taken from
_REPEATS, _CHANGE = 4, 3e-3  # periods whose fundamental changes by less than this are settled


class Oscillator:
    """Time and position in, torque out.

    Parameters
    ----------
    amplitude : d, half of the torque's swing, N.m or N
    period : s, any: the switching sample is fractional
    centre : rad or m
    bias : N.m or N
    gain : |position/torque| of the axis at this frequency, rad/(N.m) or m/N
    most : largest torque about the bias, N.m or N
    cycle : s
    lead : phase at the first call, periods
    """

    def __init__(
        self,
        amplitude: float,
        period: float,
        centre: float,
        bias: float,
        gain: float,
        cycle: float,
        most: float,
        wave: Wave = "square",
        lead: float = 0.0,
    ) -> None:
        self.amplitude = amplitude
        self.period = period
        self.bias = bias
        self.wave = wave
        self.lead = lead
        self.centre = centre
        self._cycle = cycle
        self._most = most
        crossover = _CROSSOVER * 2 * pi / period
        inertia = 1 / (gain * (2 * pi / period) ** 2)  # as seen at this frequency
        self._stiffness = inertia * crossover**2
        self._damping = 2 * _DAMPING * crossover * inertia
        self._begin: float | None = None
        self._seen: deque[tuple[float, float]] = deque()

    def phase(self, time: float) -> float:
        """Periods since the first call of `torque`, and the lead."""
        begin = time if self._begin is None else self._begin
        return self.lead + (time - begin) / self.period

    def torque(self, sample: Sample) -> float:
        """Torque for the coming cycle, N.m or N: the wave's mean over it, and the centring."""
        if self._begin is None:
            self._begin = sample.time
        phase, width = self.phase(sample.time), self._cycle / self.period
        mean = (self._area(phase + width) - self._area(phase)) / width
        torque = self.amplitude * mean + self._centring(sample)
        return self.bias + max(-self._most, min(self._most, torque))

    def _area(self, phase: float) -> float:
        """Integral of the wave over its phase in periods."""
        part = phase % 1.0
        if self.wave == "sine":
            return (1 - cos(2 * pi * part)) / (2 * pi)
        return min(part, 1 - part)

    def _centring(self, sample: Sample) -> float:
        seen = self._seen
        seen.append((sample.time, sample.position))
        while len(seen) > 2 and sample.time - seen[1][0] >= _SLOPE * self.period:
            seen.popleft()
        elapsed = sample.time - seen[0][0]
        speed = (sample.position - seen[0][1]) / elapsed if elapsed > 0 else 0.0
        return -self._stiffness * (sample.position - self.centre) - self._damping * speed


@dataclass(frozen=True, slots=True)
class Held:
    """One stretch of oscillation.

    Attributes
    ----------
    amplitude : d, half of the torque's swing, N.m or N
    period : s
    begin, end : s, of the whole periods that count as settled, or of all where none do
    periods : that were run
    settled : whether the fundamental repeats
    """

    amplitude: float
    period: float
    begin: float
    end: float
    periods: int
    settled: bool


def hold(
    context: Context, oscillator: Oscillator, sample: Sample, measure: int, most: int
) -> Plan[tuple[Held, Sample]]:
    """Run until the fundamental repeats and `measure` periods came after that, or `most` periods.

    `measure` = `most`: just so many periods, settled or not. Returns also the last sample, so that
    the next stretch goes on from it.
    """
    began = sample.time
    fundamentals: list[complex] = []
    starts = [began]
    since: int | None = None
    total, whole, before = 0j, 0, sample
    while True:
        sample = yield oscillator.torque(sample)
        phase = oscillator.phase(sample.time)
        middle = 0.5 * (phase + oscillator.phase(before.time))
        total += (
            (sample.position - oscillator.centre)
            * exp(-2j * pi * middle)
            * (sample.time - before.time)
        )
        before = sample
        if int(phase + 1e-6) == whole:
            continue
        whole = int(phase + 1e-6)
        fundamentals.append(2 * total / oscillator.period)
        starts.append(sample.time)
        total = 0j
        done = len(fundamentals)
        if since is None and _repeats(fundamentals, context.resolution):
            since = max(done - _REPEATS, 1)
        if done >= most or (since is not None and done - since >= measure):
            break
    first = since if since is not None else (0 if measure >= most else max(done - measure, 0))
    if oscillator.lead:  # the wave began within a period
        first = max(first, 1)
    held = Held(
        oscillator.amplitude, oscillator.period, starts[first], starts[-1], done, since is not None
    )
    return held, sample


def _repeats(fundamentals: list[complex], resolution: float) -> bool:
    """Whether the last periods have one fundamental.

    By their changes or, on a bad link, their means.
    """
    last = np.array(fundamentals[-_REPEATS - 1 :])
    if len(last) > _REPEATS:
        size = abs(last[-1])
        if np.all(np.abs(np.diff(last)) < max(_CHANGE * size, 0.5 * resolution)):
            return True
    recent = np.array(fundamentals[-2 * _REPEATS :])
    if len(recent) < 2 * _REPEATS:
        return False
    tolerance = _CHANGE * float(np.abs(recent[-1]))
    return settled(recent.real, tolerance) and settled(recent.imag, tolerance)


def stop_at_reversal(
    torque: Callable[[Sample], float], sample: Sample, rest: float, longest: float
) -> Plan[Sample]:
    """Go on with `torque` until the axis turns, then take it away: friction keeps it there."""
    begun, moved, before = sample.time, 0.0, sample
    while sample.time < begun + longest:
        sample = yield torque(sample)
        step = sample.position - before.position
        if step * moved < 0:
            break
        moved, before = step or moved, sample
    return (yield rest)
