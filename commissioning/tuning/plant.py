"""The axis as a sampled loop sees it: rigid, behind a hold and a dead time.

Exact at the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, expm1

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
        """Dead time and the half cycle of the hold, s.

        What a rule for a continuous loop has to know.
        """
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

    def response(self, frequency: Array) -> Complex:
        """y/u at ω up to the Nyquist frequency, rad/s, (n,) rad/(N.m) or m/N.

        Zero-order hold and dead time exactly (Åström and Wittenmark, Computer-Controlled Systems,
        2.3): y/u = C·(zI − Φ)⁻¹·(Γ0·z + Γ1)·z⁻ⁿ. z − 1 is taken by expm1, so that nothing cancels
        near z = 1.
        """
        angle = 1j * np.asarray(frequency, np.float64) * self.cycle
        z, near = np.exp(angle), np.expm1(angle)
        late = self.split
        _, a1, _ = self._kernels(self.cycle)
        _, f1, f2 = self._kernels(late)
        rest_decay, r1, r2 = self._kernels(self.cycle - late)
        # position and velocity after a cycle, per torque of the older and of the newer command
        position = f2 + r1 * f1 + (r2 * z if self.cycles else r2)
        velocity = rest_decay * f1 + (r1 * z if self.cycles else r1)
        beside = near - expm1(-self.viscous / self.inertia * self.cycle)  # z − e^(−b·Ts)
        value = (beside * position + a1 * velocity) / (self.inertia * near * beside)
        return np.asarray(value * np.exp(-angle * self.cycles), np.complex128)
