"""The point of the plant that a relay test shows, and how friction distorts it (method.md 6).

The plant is the one between torque in force and position.
"""

from __future__ import annotations

from cmath import phase
from dataclasses import dataclass
from math import degrees, pi

from commissioning.identification.describing_function import equivalent, relay
from commissioning.identification.limit_cycle import LimitCycle

__all__ = [
    "CriticalPoint",
    "corrected",
    "friction_of",
    "from_model",
    "hysteresis_only",
    "naive",
    "of_plant",
]


@dataclass(frozen=True, slots=True)
class CriticalPoint:
    """One point of the plant's frequency response.

    Attributes
    ----------
    gain : |position/torque|, rad/(N.m) or m/N
    phase_deg : in (−360, 0]
    period : s, of the oscillation that it was read at
    """

    gain: float
    phase_deg: float
    period: float

    @property
    def ku(self) -> float | None:
        """Ultimate gain 1/gain where the point lies at −180° within half a degree, else None."""
        return 1 / self.gain if abs(self.phase_deg + 180) < 0.5 else None

    @property
    def value(self) -> complex:
        """The point as a complex number."""
        from cmath import rect
        from math import radians

        return rect(self.gain, radians(self.phase_deg))


def naive(cycle: LimitCycle) -> CriticalPoint:
    """What every relay autotuner concludes: Ku = 4d/(πA), at −180°."""
    return CriticalPoint(pi * cycle.half_swing / (4 * cycle.relay_amplitude), -180.0, cycle.period)


def hysteresis_only(cycle: LimitCycle) -> CriticalPoint:
    """With the relay's hysteresis taken into account, friction not."""
    n = relay(cycle.half_swing, cycle.relay_amplitude, cycle.hysteresis)
    return _point(-1 / complex(n), cycle.period)


def corrected(cycle: LimitCycle, complex_coulomb: complex) -> CriticalPoint:
    """With hysteresis and the complex friction f̄, which carries the loop's dead time."""
    n = equivalent(cycle.half_swing, cycle.relay_amplitude, cycle.hysteresis, complex_coulomb)
    return _point(-1 / complex(n), cycle.period)


def from_model(inertia: float, viscous: float, dead_time: float, period: float) -> CriticalPoint:
    """The point of the identified rigid axis, e^(−jωτ)/(−J·ω² + j·ω·B), at a period."""
    w = 2 * pi / period
    value = 1 / complex(-inertia * w * w, viscous * w)
    point = _point(value, period)
    phase_deg = (point.phase_deg - degrees(w * dead_time)) % -360
    return CriticalPoint(point.gain, phase_deg, period)


def of_plant(value: complex, period: float) -> CriticalPoint:
    """A measured point of the frequency response."""
    return _point(value, period)


def friction_of(cycle: LimitCycle, point: CriticalPoint) -> complex:
    """Complex friction f̄ with which (4.7) puts the limit cycle on `point`: −1/N = G, solved for f̄.

    It differs from f·e^(jωτ) by what the first harmonic leaves out.
    """
    outer = complex(relay(cycle.half_swing, cycle.relay_amplitude, cycle.hysteresis))
    return (-1 / point.value - outer) * pi * cycle.half_swing / 4 / 1j


def _point(value: complex, period: float) -> CriticalPoint:
    angle = degrees(phase(value))
    return CriticalPoint(abs(value), angle - 360 if angle > 0 else angle, period)
