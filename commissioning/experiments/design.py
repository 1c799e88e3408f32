"""How large and how long the oscillations are, chosen from the first look and the limits."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context
from commissioning.experiments.stopping import Stopping
from profiles.errors import MeasurementRejected, PreflightRefused

__all__ = ["LONG", "SHORT", "Pace", "RelayDesign", "design", "travel_needed"]

# Comfortable conditioning (method.md 2): f/d1 in 0.4–0.6, d2/d1 at least 1.5
_D1_FRICTION, _D1_BREAKAWAY = 1.7, 1.3
_RATIO, _LEAST_RATIO = 1.8, 1.4
_SHORTEST_PERIOD = 0.1  # s
_FEWEST_COUNTS = 300  # encoder counts of half-swing, by what the first look knows
_TORQUE_SHARE = 0.97  # of the limit; the rest is for the bias to move
_TRAVEL_SHARE = 0.7  # of the travel: what the worst stop may take
_SPEED_SHARE = 0.5  # of the speed limit, at the peak of the larger test


@dataclass(frozen=True, slots=True)
class Pace:
    """What the reading of the oscillations asks of them.

    Attributes
    ----------
    dead_times, cycles : a period is at least this many of them
    overdrive : largest torque over d2: what a centring loop may add
    """

    dead_times: float
    cycles: float
    overdrive: float


LONG = Pace(40, 40, 1.0)  # the thesis: a relay that is sampled and late has no clean limit cycle
SHORT = Pace(12, 24, 1.15)  # modulating functions and the exact balance know sampling and dead time


@dataclass(frozen=True, slots=True)
class RelayDesign:
    """What the two tests are run with, chosen from the first look and the limits.

    Attributes
    ----------
    d1, d2 : relay amplitudes (half of the swing), N.m or N
    most : largest torque about the bias that may be commanded, N.m or N
    hysteresis : ε1 to begin with, rad or m; staged upwards from there
    period : s, goal of test 1; reached unless travel or speed end the staging before
    half_swing_1 : rad or m, of test 1 at that period, by what the first look knows
    half_swing : rad or m, largest that test 1 may grow to
    bias : N.m or N, first guess of the offset
    """

    d1: float
    d2: float
    most: float
    hysteresis: float
    period: float
    half_swing_1: float
    half_swing: float
    bias: float


def design(
    context: Context,
    known: FirstLook,
    stopping: Stopping,
    pace: Pace = LONG,
    *,
    longest_period: float = 2.0,
) -> RelayDesign:
    """Choose the tests from what is known.

    The larger test is kept so small that the axis, told to stop at its worst instant, still stops
    within the travel, and that it reaches at most half of the speed limit.

    Raises
    ------
    MeasurementRejected
        The torque limit leaves no well-conditioned pair of tests.
    PreflightRefused
        The travel leaves no room for them.
    """
    unit = context.effort_unit
    d1 = max(_D1_FRICTION * known.coulomb, _D1_BREAKAWAY * known.breakaway)
    most = _TORQUE_SHARE * context.torque - abs(known.offset)
    d2 = min(_RATIO * d1, most)
    if d2 < _LEAST_RATIO * d1:
        raise MeasurementRejected(
            f"friction {known.breakaway:.4g} {unit} and offset {known.offset:.4g} {unit} need "
            f"relay amplitudes of {d1:.4g} and {_RATIO * d1:.4g} {unit}, but the torque limit of "
            f"{context.torque:.4g} {unit} leaves {most:.4g} {unit}; raise --max-torque"
        )
    f, inertia = min(known.coulomb, 0.8 * d1), known.inertia

    def half_swing(period: float, d: float) -> float:
        return period**2 * (d * d - f * f) / (32 * inertia * d)  # rigid axis, no viscous friction

    period = max(pace.dead_times * known.dead_time, pace.cycles * context.cycle, _SHORTEST_PERIOD)
    counts = _FEWEST_COUNTS * context.resolution
    period = max(period, sqrt(counts * 32 * inertia * d1 / (d1 * d1 - f * f)))
    period = min(period, longest_period)
    room = _room(context, stopping, d2, f, inertia, pace.overdrive)
    by_travel = sqrt(room * 32 * inertia * d2 / (d2 * d2 - f * f))
    by_speed = _SPEED_SHARE * context.speed * 4 * inertia * d2 / (d2 * d2 - f * f)
    period = min(period, by_travel, by_speed)
    first = half_swing(period, d1)
    if room <= 0 or first < 20 * context.resolution or period < 8 * context.cycle:
        raise PreflightRefused(
            f"the travel of ±{context.travel:.4g} {context.position_unit} is too small: it allows a "
            f"swing of ±{room:.3g} {context.position_unit} and a period of {period * 1000:.3g} ms, "
            f"against a cycle of {context.cycle * 1000:g} ms; give more --travel or a shorter --cycle"
        )
    growth = half_swing(period, d2) / first
    return RelayDesign(
        d1, d2, _overdrive(context, known, pace, d2), 0.3 * first * f / d1, period, first,
        room / growth, known.offset,
    )  # fmt: skip


def _overdrive(context: Context, known: FirstLook, pace: Pace, d2: float) -> float:
    """Largest torque about the bias, N.m or N."""
    most = context.torque - abs(known.offset) - context.torque_resolution
    return max(min(pace.overdrive * d2, most), d2)


def _room(
    context: Context, stopping: Stopping, d: float, f: float, inertia: float, overdrive: float
) -> float:
    """Largest half-swing whose worst stop stays inside the travel."""

    def needed(half_swing: float) -> float:
        peak = sqrt(2 * half_swing * (d * d - f * f) / (inertia * d))
        return travel_needed(stopping, half_swing, f / d, peak, overdrive * d)

    low, high = 0.0, _TRAVEL_SHARE * context.travel
    for _ in range(60):
        middle = (low + high) / 2
        if needed(middle) <= context.travel:
            low = middle
        else:
            high = middle
    return low


def travel_needed(
    stopping: Stopping, half_swing: float, switching: float, peak_speed: float, torque: float
) -> float:
    """Travel that an oscillation asks for, rad or m: its worst stop, at full speed past the switching.

    Parameters
    ----------
    half_swing : rad or m
    switching : where the torque switches, as a share of the half-swing
    peak_speed : rad/s or m/s
    torque : largest about the bias, N.m or N
    """
    reach = half_swing * switching + stopping.distance(peak_speed, torque)
    return max(reach, half_swing) / _TRAVEL_SHARE
