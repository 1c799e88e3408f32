"""The relay, sampled: with hysteresis, or ideal with a delay.

A relay that is sampled can only switch on samples, so its period comes in steps and its limit cycle
wanders. Here the switching sample is fractional: when the torque is to change within the coming
cycle, that cycle gets the mean of both torques that is equal in area.
"""

from __future__ import annotations

from math import pi, sin
from typing import Literal

from drivers.sample import Sample

__all__ = ["Relay", "Switching"]

Switching = Literal["hysteresis", "delay"]


class Relay:
    """Position in, torque out.

    Parameters
    ----------
    amplitude : d, half of the relay's swing, N.m or N
    knob : what sets the period: ε, half-width of the hysteresis about `reference`, rad or m; or τ,
        the delay from the crossing of `reference` to the switching, s
    reference : rad or m
    bias : N.m or N, centre of the output
    cycle : s
    switching : what `knob` is
    fractional : area-equal torque in the switching sample
    """

    __slots__ = (
        "_due", "_just_switched", "_position", "_time", "amplitude", "bias", "cycle", "fractional",
        "knob", "reference", "sign", "switching",
    )  # fmt: skip

    def __init__(
        self,
        amplitude: float,
        knob: float,
        reference: float,
        cycle: float,
        bias: float = 0.0,
        *,
        switching: Switching = "hysteresis",
        fractional: bool = True,
    ) -> None:
        self.amplitude = amplitude
        self.knob = knob
        self.reference = reference
        self.bias = bias
        self.cycle = cycle
        self.switching = switching
        self.fractional = fractional
        self.sign = 1
        self._just_switched = False
        self._due: float | None = None
        self._position = 0.0
        self._time = -1.0

    @property
    def power(self) -> float:
        """How the period goes with the knob on a rigid axis: T ~ knob^power."""
        return 0.5 if self.switching == "hysteresis" else 1.0

    def hysteresis_of(self, half_swing: float, period: float) -> float:
        """ε of this relay at a limit cycle, A·sin(ωτ) for a delay (4.24), rad or m."""
        if self.switching == "hysteresis":
            return min(self.knob, half_swing)  # it looks ahead, and may switch short of its knob
        return half_swing * sin(2 * pi / period * self.knob)

    def switch(self, sample: Sample) -> float:
        """Torque for the coming cycle, N.m or N."""
        position = sample.position - self.reference
        advance = self.sign * (position - self._position)
        elapsed = sample.time - self._time
        self._position, self._time = position, sample.time
        if not 0 < elapsed < 10 * self.cycle:
            advance = 0.0
        if self.switching == "delay":
            return self._switch_late(sample.time, self.sign * position, advance, elapsed)
        return self._switch_at(self.sign * position - self.knob, advance, elapsed)

    def _switch_at(self, beyond: float, advance: float, elapsed: float) -> float:
        """At a threshold that the position is `beyond`; it advanced by `advance` in `elapsed` s."""
        sign = self.sign
        if self._just_switched:
            self._just_switched = False
        elif beyond >= 0:
            self.sign = sign = -sign
        elif self.fractional and advance > 0:
            advance *= self.cycle / elapsed
            if beyond + advance > 0:
                return self._split(-beyond / advance)
        return self.bias + sign * self.amplitude

    def _switch_late(self, now: float, beyond: float, advance: float, elapsed: float) -> float:
        """`knob` s after the position went beyond the reference."""
        if self._due is None and beyond >= 0 and advance > 0:
            since = min(beyond / advance, 1.0) * elapsed
            self._due = now - since + self.knob
        if self._due is not None:
            left = (self._due - now) / self.cycle
            if left <= 0 or (left < 1 and not self.fractional):
                self._due = None
                self.sign = -self.sign
            elif left < 1:
                self._due = None
                return self._split(left)
        return self.bias + self.sign * self.amplitude

    def _split(self, share: float) -> float:
        """Switch after this share of the coming cycle: the torque of equal area."""
        sign = self.sign
        self.sign = -sign
        self._just_switched = True
        return self.bias + sign * (2 * share - 1) * self.amplitude
