"""Coulomb friction from two relay tests at one frequency: the thesis' method (Blaha 2001, 4.3).

Two limit cycles of one period see the same plant, so their equivalent nonlinearities are equal,
N1 = N2, and the plant drops out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt

from commissioning.identification.errors import NotShown
from commissioning.identification.estimate import Estimate
from commissioning.identification.limit_cycle import LimitCycle

__all__ = ["FrictionEstimate", "from_cycles", "solve"]

# The first harmonic stands for the whole wave. Over the axes of benchmarks/accuracy.md, with the
# relay settings that tworelay chooses, the value is off by this share of the truth.
SYSTEMATIC_LOW, SYSTEMATIC_HIGH = -0.03, 0.06


@dataclass(frozen=True, slots=True)
class FrictionEstimate:
    """What two matched relay tests tell.

    Attributes
    ----------
    coulomb : f, N.m or N, mean of both directions
    complex_coulomb : f̄ of (4.14), N.m or N
    offset : N.m or N, from the DC balance (method.md 4)
    first, second : the limit cycles
    """

    coulomb: Estimate
    complex_coulomb: complex
    offset: Estimate
    first: LimitCycle
    second: LimitCycle


def solve(d1: float, eps1: float, a1: float, d2: float, eps2: float, a2: float) -> complex:
    """Complex Coulomb friction f̄ = f_re + j·f_im by (4.14), N.m or N; f = |f̄| by (4.16).

    Parameters
    ----------
    d1, d2 : relay amplitudes (half of the relay's swing), N.m or N
    eps1, eps2 : hysteresis half-widths, rad or m
    a1, a2 : half-swings of the position, rad or m; different from each other
    """
    if a1 == a2:
        raise NotShown("both limit cycles have the same half-swing: they tell nothing apart")
    if not (0 <= eps1 <= a1 and 0 <= eps2 <= a2):
        raise NotShown("a hysteresis lies outside 0…half-swing: such a relay never switches")
    f_re = (a1 / a2 * d2 * eps2 - a2 / a1 * d1 * eps1) / (a1 - a2)
    f_im = (a1 / a2 * d2 * sqrt(a2**2 - eps2**2) - a2 / a1 * d1 * sqrt(a1**2 - eps1**2)) / (a1 - a2)
    return complex(f_re, f_im)


def from_cycles(first: LimitCycle, second: LimitCycle, sampling: float = 0.0) -> FrictionEstimate:
    """Friction and offset from two limit cycles of (nearly) one period.

    The interval is the scatter of the half-swings and of the match of the periods, propagated
    through (4.14), and the systematic part: the stated share of the first-harmonic method, and
    `sampling` (s), the cycle of the sampled relay, as a share of the period.
    """
    args = (
        first.relay_amplitude, first.hysteresis, first.half_swing,
        second.relay_amplitude, second.hysteresis, second.half_swing,
    )  # fmt: skip
    value = solve(*args)
    f = abs(value)
    variance = 0.0
    for position, error in ((2, first.half_swing_error), (5, second.half_swing_error)):
        moved = list(args)
        moved[position] += max(error, 1e-9 * moved[position])
        variance += (abs(solve(*moved)) - f) ** 2
    # a period off by dT moves the half-swing by about twice its share (A ~ T^2)
    mismatch = abs(second.period - first.period) / first.period
    mismatch = hypot(mismatch, second.period_error / second.period)
    moved = list(args)
    moved[5] *= 1 + 2 * mismatch
    variance += (abs(solve(*moved)) - f) ** 2
    scatter = 2 * sqrt(variance)
    steps = sampling / first.period
    low = f / (1 + SYSTEMATIC_HIGH + steps) - scatter
    high = f / (1 + SYSTEMATIC_LOW - steps) + scatter
    return FrictionEstimate(
        Estimate(f, max(low, 0.0), high), value, _offset(first, second, f), first, second
    )


def _offset(first: LimitCycle, second: LimitCycle, f: float) -> Estimate:
    """Offset from the DC balance of each test: mean(u) = offset + f·mean(sign v)."""
    values = [cycle.command - f * cycle.direction for cycle in (first, second)]
    value = sum(values) / 2
    spread = abs(values[0] - values[1]) + 0.01 * f
    return Estimate(value, value - spread, value + spread)
