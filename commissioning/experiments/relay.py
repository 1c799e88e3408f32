"""The relay with hysteresis, sampled.

A relay that is sampled can only switch on samples, so its period comes in steps and its limit cycle
wanders. Here the switching sample is fractional: when the position will cross the threshold
within the coming cycle, that cycle gets the mean of both torques that is equal in area.
"""

from __future__ import annotations

from drivers.sample import Sample

__all__ = ["Relay"]


class Relay:
    """Position in, torque out.

    Parameters
    ----------
    amplitude : d, half of the relay's swing, N.m or N
    hysteresis : ε, half-width about `reference`, rad or m
    reference : rad or m
    bias : N.m or N, centre of the output
    cycle : s
    fractional : area-equal torque in the switching sample
    """

    __slots__ = (
        "_just_switched", "_position", "_time", "amplitude", "bias", "cycle", "fractional",
        "hysteresis", "reference", "sign",
    )  # fmt: skip

    def __init__(
        self,
        amplitude: float,
        hysteresis: float,
        reference: float,
        cycle: float,
        bias: float = 0.0,
        *,
        fractional: bool = True,
    ) -> None:
        self.amplitude = amplitude
        self.hysteresis = hysteresis
        self.reference = reference
        self.bias = bias
        self.cycle = cycle
        self.fractional = fractional
        self.sign = 1
        self._just_switched = False
        self._position = 0.0
        self._time = -1.0

    def switch(self, sample: Sample) -> float:
        """Torque for the coming cycle, N.m or N."""
        sign = self.sign
        position = sample.position - self.reference
        beyond = sign * position - self.hysteresis  # how far past the threshold
        advance = sign * (position - self._position)
        elapsed = sample.time - self._time
        self._position, self._time = position, sample.time
        if self._just_switched:
            self._just_switched = False
        elif beyond >= 0:
            self.sign = sign = -sign
        elif self.fractional and advance > 0 and 0 < elapsed < 10 * self.cycle:
            advance *= self.cycle / elapsed
            if beyond + advance > 0:
                share = -beyond / advance  # of the coming cycle until the crossing
                self.sign = -sign
                self._just_switched = True
                return self.bias + sign * (2 * share - 1) * self.amplitude
        return self.bias + sign * self.amplitude
