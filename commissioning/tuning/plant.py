"""The axis as a sampled loop sees it: rigid, behind a hold and a dead time. Exact at the samples."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, expm1
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LoopPlant"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SMALL = 1e-5  # of a time constant: below, a series is more exact than a quotient


@dataclass(frozen=True, slots=True)
class LoopPlant:
    """J·ÿ + B·ẏ = u(t − τ), u held over a cycle.

    Attributes
    ----------
    inertia : J, kg.m2 or kg
    viscous : B, N.m.s/rad or N.s/m
    dead_time : τ, s, from the sample of the position to the torque, the hold left out
    cycle : Ts, s
    """

    inertia: float
    viscous: float
    dead_time: float
    cycle: float

    @property
    def delay(self) -> float:
        """Dead time and the half cycle of the hold, s: what a rule for a continuous loop has to know."""
        return self.dead_time + self.cycle / 2

    @property
    def cycles(self) -> int:
        """Whole cycles until a command acts, rounded up."""
        return ceil(self.dead_time / self.cycle - 1e-9)

    @property
    def split(self) -> float:
        """Time into a cycle at which the next command begins to act, s; 0 where none is late."""
        return self.dead_time - (self.cycles - 1) * self.cycle if self.cycles else 0.0

    def _kernels(self, time: float) -> tuple[float, float, float]:
        """e^(−bt), its integral and its double integral, b = B/J."""
        b = self.viscous / self.inertia
        z = b * time
        if z < _SMALL:
            return exp(-z), time * (1 - z / 2), time**2 / 2 * (1 - z / 3)
        first = -expm1(-z) / b
        return exp(-z), first, (time - first) / b

    def polynomials(self) -> tuple[Array, Array]:
        """Numerator and denominator of y/u in z, highest power first.

        Zero-order hold and dead time exactly (Åström and Wittenmark, Computer-Controlled Systems, 2.3).
        """
        ts, j = self.cycle, self.inertia
        decay, a1, _ = self._kernels(ts)
        late = self.split
        _, f1, f2 = self._kernels(late)
        rest_decay, r1, r2 = self._kernels(ts - late)
        # position and velocity after a cycle, per torque of the older and of the newer command
        old = np.array([f2 + r1 * f1, rest_decay * f1]) / j
        new = np.array([r2, r1]) / j
        # C·adj(zI − Φ) = [z − decay, a1]
        numerator = np.zeros(3)
        for power, (y, v) in ((0, new), (1, old)):
            numerator[power] += y
            numerator[power + 1] += a1 * v - decay * y
        denominator = np.array([1.0, -(1 + decay), decay])
        lag = self.cycles
        if lag == 0:
            return numerator[:2], denominator
        return numerator, np.concatenate((denominator, np.zeros(lag)))

    def response(self, frequency: Array) -> Complex:
        """y/u at ω below the Nyquist frequency, (n,) rad/(N.m) or m/N."""
        numerator, denominator = self.polynomials()
        z: Any = np.exp(1j * np.asarray(frequency) * self.cycle)
        return np.asarray(np.polyval(numerator, z) / np.polyval(denominator, z), np.complex128)
