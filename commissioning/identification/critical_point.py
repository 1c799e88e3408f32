"""The point of the plant that a relay test shows, and how friction distorts it (method.md 6).

The plant is the one between torque in force and position.
"""

from __future__ import annotations

from cmath import phase, rect
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan, cos, degrees, exp, hypot, inf, log, pi, radians, sin, sqrt

from commissioning.identification.describing_function import equivalent, relay
from commissioning.identification.estimate import Estimate
from commissioning.identification.limit_cycle import LimitCycle

__all__ = [
    "CriticalPoint",
    "Lag",
    "at_its_phase",
    "at_phase",
    "autotuned",
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
    gain_error : half-width of the gain's interval as a share of it; None: nothing is known of it
    phase_error : half-width of the phase's interval, degrees
    measured : read from an oscillation's own phasors, not from a model or a describing function
    """

    gain: float
    phase_deg: float
    period: float
    gain_error: float | None = None
    phase_error: float | None = None
    measured: bool = False

    @property
    def ku(self) -> float | None:
        """Ultimate gain 1/gain where the point lies at −180° within half a degree, else None."""
        return 1 / self.gain if abs(self.phase_deg + 180) < 0.5 else None

    @property
    def value(self) -> complex:
        """The point as a complex number."""
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


@dataclass(frozen=True, slots=True)
class Lag:
    """What of a dead time is a lag of the torque, 1/(1 + s·T).

    Attributes
    ----------
    time_constant : T, s
    period : of the oscillation at which the dead time delays as much as both, s
    """

    time_constant: float = 0.0
    period: float = inf

    def response(self, dead_time: float, w: float) -> tuple[float, float]:
        """Gain, and phase in rad, of the torque at `w` rad/s."""
        lag, at = self.time_constant, 2 * pi / self.period
        pure = dead_time - (atan(at * lag) / at if at else lag)
        return 1 / hypot(1, w * lag), -w * pure - atan(w * lag)


_NO_LAG = Lag()


def from_model(
    inertia: Estimate, viscous: Estimate, dead_time: Estimate, period: float, lag: Lag = _NO_LAG
) -> CriticalPoint:
    """The point of the identified rigid axis, e^(−jωτ)/(−J·ω² + j·ω·B), at a period, s."""
    w = 2 * pi / period
    known = (inertia, viscous, dead_time)
    gain, turned = _rigid([e.value for e in known], w, lag)
    by_gain = by_phase = 0.0
    for which in range(len(known)):
        ends = [
            _rigid(
                [getattr(e, end if n == which else "value") for n, e in enumerate(known)], w, lag
            )
            for end in ("low", "high")
        ]
        by_gain += max(abs(other / gain - 1) for other, _ in ends) ** 2
        by_phase += max(abs(other - turned) for _, other in ends) ** 2
    return CriticalPoint(gain, turned % -360, period, sqrt(by_gain), sqrt(by_phase))


def _rigid(axis: Sequence[float], w: float, lag: Lag) -> tuple[float, float]:
    """Gain, rad/(N.m) or m/N, and phase, degrees, of a rigid axis at `w` rad/s.

    `axis` : inertia, viscous friction, dead time.
    """
    inertia, viscous, dead_time = axis
    stiffness = complex(-inertia * w * w, max(viscous, 0.0) * w)
    gain, turned = lag.response(dead_time, w)
    return gain / abs(stiffness), degrees(turned - phase(stiffness))


def at_phase(
    inertia: Estimate,
    viscous: Estimate,
    dead_time: Estimate,
    phase_deg: float,
    lag: Lag = _NO_LAG,
) -> CriticalPoint | None:
    """The point of the identified rigid axis at a phase in (−270, −90)°, None where it has none.

    The phase falls from −90° at standstill to −180°, and on only by the dead time: without viscous
    friction there is nothing above −180°, without dead time nothing from there on. The gain's
    interval is of where the phase is truly that (`at_its_phase`).
    """
    w = _where((inertia.value, viscous.value, dead_time.value), phase_deg, lag)
    if w is None:
        return None
    point = from_model(inertia, viscous, dead_time, 2 * pi / w, lag)
    return at_its_phase(point, inertia.value, viscous.value, dead_time.value, lag)


def at_its_phase(
    point: CriticalPoint, inertia: float, viscous: float, dead_time: float, lag: Lag = _NO_LAG
) -> CriticalPoint:
    """The point with an interval of the gain where the phase is truly the one that it says.

    A phase that is a little off lies at another frequency, on a flat phase far away: how far the
    gain is another one there says the model. No interval where the model has no such phase.
    """
    if point.gain_error is None or point.phase_error is None:
        return point
    axis = inertia, viscous, dead_time
    gains = []
    for off in (0.0, -point.phase_error, point.phase_error):
        w = _where(axis, point.phase_deg + off, lag)
        if w is None:
            return replace(point, gain_error=None)
        gains.append(_rigid(axis, w, lag)[0])
    moved = max(abs(gain / gains[0] - 1) for gain in gains[1:])
    return replace(point, gain_error=hypot(point.gain_error, moved))


def _where(axis: tuple[float, float, float], phase_deg: float, lag: Lag) -> float | None:
    """Frequency, rad/s, at which a rigid axis has a phase; None: it has none."""
    j, b, tau = axis
    if not b > 0 or (phase_deg <= -180 and not tau > 0):
        return None
    from scipy.optimize import brentq

    try:
        found = brentq(  # in the logarithm: the range is as wide as axes are different
            lambda x: _rigid(axis, exp(x), lag)[1] - phase_deg, log(1e-6 * b / j), log(1e6 * b / j)
        )
    except ValueError:  # beyond any frequency that an axis has
        return None
    return exp(float(found))


def autotuned(
    inertia: float,
    viscous: float,
    dead_time: float,
    friction_share: float,
    hysteresis_deg: float,
) -> CriticalPoint | None:
    """What a relay autotuner concludes on a rigid axis with friction.

    By describing functions: the limit cycle lies where arg G = arg(−1/N), N = d·e^(−jα) + j·f; the
    autotuner takes N = d·e^(−jα) alone and so |G| for |G|·|N|/d at −180° + α. None where the axis
    has no such limit cycle.

    Parameters
    ----------
    friction_share : f/d
    hysteresis_deg : α = asin(ε/A), degrees
    """
    alpha = radians(hysteresis_deg)
    both = complex(cos(alpha), friction_share - sin(alpha))
    j, b, tau = (Estimate(v, v, v) for v in (inertia, viscous, dead_time))
    truth = at_phase(j, b, tau, -180 - degrees(phase(both)))
    if truth is None:
        return None
    return CriticalPoint(truth.gain * abs(both), hysteresis_deg - 180, truth.period)


def of_plant(value: complex, period: float) -> CriticalPoint:
    """A point of the frequency response that is known as a complex number."""
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
