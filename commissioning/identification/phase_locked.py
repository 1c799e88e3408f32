"""Friction from two sine excitations of one frequency: the variant of the thesis' conclusion.

With a sine in place of the relay the first harmonic of the torque is the torque, so (4.14) holds
with d → π/4 times the sine's amplitude and the measured phase in place of the hysteresis:

    −U1/Y1 + 4j·f̄/(π·A1) = −U2/Y2 + 4j·f̄/(π·A2)

Friction is still described by its first harmonic alone, 4f/(πA). On a rigid axis without dead time
the phase of U/Y does not depend on the frequency, so it is the frequency that is locked, to the one
that a relay has found, and the phase that is measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from commissioning.identification.estimate import Estimate
from commissioning.identification.lock_in import Phasors

__all__ = ["PhaseLocked", "phase_locked", "solve"]

# the first harmonic stands for friction's whole wave, as in `two_relay`
_SYSTEMATIC = 0.04
_OFFSET = 0.01  # of f


@dataclass(frozen=True, slots=True)
class PhaseLocked:
    """What two sine excitations tell.

    Attributes
    ----------
    coulomb, offset : with intervals, N.m or N
    complex_coulomb : f̄, N.m or N
    plant : G(jω), rad/(N.m) or m/N, input dynamics and dead time included
    period : s
    half_swing, fundamental : of both, rad or m
    phase_deg : of the torque against −position, of both
    periods : of both
    """

    coulomb: Estimate
    offset: Estimate
    complex_coulomb: complex
    plant: complex
    period: float
    half_swing: tuple[float, float]
    fundamental: tuple[float, float]
    phase_deg: tuple[float, float]
    periods: tuple[int, int]


def solve(u1: complex, y1: complex, u2: complex, y2: complex) -> complex:
    """Complex friction f̄ from the fundamentals of torque (N.m or N) and position (rad or m)."""
    return (u1 / y1 - u2 / y2) / (4j / pi * (1 / abs(y1) - 1 / abs(y2)))


def phase_locked(first: Phasors, second: Phasors) -> PhaseLocked:
    """From all periods of both excitations."""
    pair = (first, second)
    u, y = ([complex(np.mean(v[:, 0])) for v in (p.torque for p in pair)],
            [complex(np.mean(v[:, 0])) for v in (p.position for p in pair)])  # fmt: skip
    value = solve(u[0], y[0], u[1], y[1])
    f = abs(value)
    variance = 0.0
    for n, phasor in enumerate(pair):
        count = len(phasor.mean_sign)
        for k in range(count):
            rest = np.arange(count) != k
            moved_u, moved_y = list(u), list(y)
            moved_u[n] = complex(np.mean(phasor.torque[rest, 0]))
            moved_y[n] = complex(np.mean(phasor.position[rest, 0]))
            found = abs(solve(moved_u[0], moved_y[0], moved_u[1], moved_y[1]))
            variance += (count - 1) / count * (found - f) ** 2
    offset = float(np.mean(np.concatenate([p.mean_torque - f * p.mean_sign for p in pair])))
    return PhaseLocked(
        Estimate.around(f, variance**0.5, _SYSTEMATIC * f),
        Estimate.around(offset, 0.0, _OFFSET * f),
        value,
        1 / (u[0] / y[0] - 4j / pi * value / abs(y[0])),
        first.period,
        (first.half_swing, second.half_swing),
        (abs(y[0]), abs(y[1])),
        tuple(float(np.degrees(np.angle(-a / b))) for a, b in zip(u, y, strict=True)),  # type: ignore[arg-type]
        (len(first.mean_sign), len(second.mean_sign)),
    )
