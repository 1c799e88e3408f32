"""A rigid axis without viscous friction and delay under a relay, in closed form.

Between two switchings the acceleration is constant, so the limit cycle is made of parabolas
(method.md 2): eps/A = f/d, and T = 4 sqrt(2 A J d / (d^2 - f^2)).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Parabolas:
    """The limit cycle of inertia `j`, friction `f`, relay amplitude `d`, hysteresis `eps`."""

    j: float
    f: float
    d: float
    eps: float

    @property
    def half_swing(self) -> float:
        return self.eps * self.d / self.f

    @property
    def period(self) -> float:
        d, f = self.d, self.f
        return 4 * sqrt(2 * self.half_swing * self.j * d / (d * d - f * f))

    def sample(self, cycle: float, periods: float) -> tuple[NDArray[Any], ...]:
        """Time, position and command, sampled."""
        n = round(periods * self.period / cycle)
        time = np.arange(n) * cycle
        half, a = self.period / 2, self.half_swing
        up = (self.d - self.f) / self.j
        down = (self.d + self.f) / self.j
        switch = sqrt(2 * (a + self.eps) / up)
        phase = (time + 0.123 * self.period) % self.period
        sign = np.where(phase < half, 1.0, -1.0)
        within = phase % half
        rising = np.where(
            within < switch, -a + up * within**2 / 2, a - down * (half - within) ** 2 / 2
        )
        command = sign * np.where(within < switch, self.d, -self.d)
        return time, sign * rising, command


def matched(j: float, f: float, d1: float, eps1: float, d2: float) -> tuple[Parabolas, Parabolas]:
    """Two limit cycles of one period: eps2/eps1 = (1 - (f/d2)^2) / (1 - (f/d1)^2)."""
    ratio = (1 - (f / d2) ** 2) / (1 - (f / d1) ** 2)
    return Parabolas(j, f, d1, eps1), Parabolas(j, f, d2, eps1 * ratio)
