"""How large and how long the oscillations are, chosen from the first look and the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, floor, log10, sqrt

from commissioning.errors import MeasurementRejected
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context
from commissioning.experiments.stopping import Stopping
from drivers.errors import PreflightRefused

__all__ = ["LONG", "SHORT", "PeriodNeeds", "RelayDesign", "design", "travel_needed"]

# Comfortable conditioning (method.md 2): f/d1 in 0.4–0.6, d2/d1 at least 1.5
_D1_FRICTION, _D1_BREAKAWAY = 1.7, 1.3
_RATIO, _LEAST_RATIO = 1.8, 1.4
_SHORTEST_PERIOD = 0.1  # s
_SHORTEST_WATCHDOG = 0.005  # s, that can be asked for
_FEWEST_COUNTS = 300  # encoder counts of half-swing, by what the first look knows
_TORQUE_SHARE = 0.97  # of the limit; the rest is for the bias to move
_TRAVEL_SHARE = 0.7  # of the travel: what the worst stop may take
_SPARE = 1.3  # of what is recommended: the next first look finds a little less, or more
_MOST_TIMES = 1000  # of the travel: what is looked for at most
_SPEED_SHARE = 0.5  # of the speed limit, at the peak of the larger test


@dataclass(frozen=True, slots=True)
class PeriodNeeds:
    """What the reading of the oscillations asks of them.

    Attributes
    ----------
    dead_times, cycles : a period is at least this many of them
    overdrive : largest torque over d2: what a centring loop may add
    """

    dead_times: float
    cycles: float
    overdrive: float


# the thesis: a relay that is sampled and late has no clean limit cycle
LONG = PeriodNeeds(40, 40, 1.0)
# modulating functions and the exact balance know sampling and dead time
SHORT = PeriodNeeds(12, 24, 1.15)


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
    pace: PeriodNeeds = LONG,
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
            f"{context.torque:.4g} {unit} leaves {most:.4g} {unit}",
            code="measurement.torque",
            hint="raise --max-torque",
        )
    f = min(known.coulomb, 0.8 * d1)
    pair = _Pair(context, pace, d1, d2, f, known.inertia, known.dead_time, longest_period)
    fit = pair.fit(context.travel, stopping)
    if fit is None:
        raise PreflightRefused(_no_room(context, stopping, pair), code="preflight.room")
    period, room = fit
    first = pair.half_swing(period, d1)
    growth = pair.half_swing(period, d2) / first
    return RelayDesign(
        d1, d2, _overdrive(context, known, pace, d2), 0.3 * first * f / d1, period, first,
        room / growth, known.offset,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Pair:
    """Both tests with amplitudes that are chosen; which period fits where."""

    context: Context
    pace: PeriodNeeds
    d1: float
    d2: float
    friction: float
    inertia: float
    dead_time: float
    longest: float

    def half_swing(self, period: float, d: float) -> float:
        """Half-swing of a rigid axis without viscous friction, rad or m."""
        return period**2 * (d * d - self.friction**2) / (32 * self.inertia * d)

    def _period(self, half_swing: float, d: float) -> float:
        return sqrt(half_swing * 32 * self.inertia * d / (d * d - self.friction**2))

    def fit(self, travel: float, stopping: Stopping) -> tuple[float, float] | None:
        """Period (s) and largest half-swing (rad or m) with so much travel; None: nothing fits."""
        context, pace = self.context, self.pace
        period = max(
            pace.dead_times * self.dead_time, pace.cycles * context.cycle, _SHORTEST_PERIOD
        )
        period = max(period, self._period(_FEWEST_COUNTS * context.resolution, self.d1))
        room = _room(travel, stopping, self.d2, self.friction, self.inertia, pace.overdrive)
        force = self.d2**2 - self.friction**2
        by_speed = _SPEED_SHARE * context.speed * 4 * self.inertia * self.d2 / force
        period = min(period, self.longest, self._period(room, self.d2), by_speed)
        first = self.half_swing(period, self.d1)
        if room <= 0 or first < 20 * context.resolution or period < 8 * context.cycle:
            return None
        return period, room


def _no_room(context: Context, stopping: Stopping, pair: _Pair) -> str:
    """Why nothing fits the travel.

    Also which of travel, watchdog and cycle would mend it, with numbers.
    """
    p = context.position_unit
    goes = stopping.distance(0.0, pair.pace.overdrive * pair.d2)
    ways = []
    travel = _least(
        lambda x: pair.fit(x, stopping) is not None, context.travel, _MOST_TIMES * context.travel
    )
    if travel is not None:
        ways.append(f"--travel {_up(_SPARE * travel)}")
    by_watchdog = stopping.watchdog > 0
    quickest = replace(stopping, reaction=stopping.delay)
    if pair.fit(context.travel, quickest) is not None:
        slower = _least(
            lambda x: (
                pair.fit(context.travel, replace(stopping, reaction=stopping.reaction - x))
                is not None
            ),
            0.0,
            stopping.reaction - stopping.delay,
        )
        left = stopping.reaction - stopping.delay - (slower or 0.0)
        if by_watchdog and left / _SPARE >= max(3 * context.cycle / _SPARE, _SHORTEST_WATCHDOG):
            ways.append(f"--watchdog {left / _SPARE:.2g}")
        elif not by_watchdog:
            ways.append(f"a shorter --cycle (now {context.cycle * 1000:g} ms)")
    if not ways:
        speed = _least(
            lambda x: (
                replace(pair, context=replace(context, speed=x)).fit(context.travel, stopping)
                is not None
            ),
            context.speed,
            _MOST_TIMES * context.speed,
        )
        if speed is not None:
            return (
                f"a speed of {context.speed:.4g} {p}/s is too small for an oscillation of both "
                f"tests ({pair.d1:.4g} and {pair.d2:.4g} {context.effort_unit}) at a cycle of "
                f"{context.cycle * 1000:g} ms; --max-speed {_up(_SPARE * speed)} would do"
            )
    notices = (
        f"the drive's watchdog notices a dead link only after {stopping.watchdog * 1000:g} ms"
        if by_watchdog
        else f"a dead link is noticed after {(stopping.reaction - stopping.delay) * 1000:.3g} ms"
    )
    return (
        f"the travel of ±{context.travel:.4g} {p} is too small: {notices}, and by then the larger "
        f"test's {pair.d2:.4g} {context.effort_unit} have moved an axis at rest by {goes:.3g} {p}; "
        + (
            f"{' or '.join(ways)} would do"
            if ways
            else "give much more --travel, or less --max-torque"
        )
    )


def _least(holds: Callable[[float], bool], low: float, high: float) -> float | None:
    """The smallest value at which it holds, from low to high; None: not even there."""
    if not holds(high):
        return None
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _up(value: float) -> str:
    """Two digits, no less than the value."""
    step = 10.0 ** (floor(log10(value)) - 1)
    return f"{ceil(value / step) * step:.6g}"


def _overdrive(context: Context, known: FirstLook, pace: PeriodNeeds, d2: float) -> float:
    """Largest torque about the bias, N.m or N."""
    most = context.torque - abs(known.offset) - context.torque_resolution
    return max(min(pace.overdrive * d2, most), d2)


def _room(
    travel: float, stopping: Stopping, d: float, f: float, inertia: float, overdrive: float
) -> float:
    """Largest half-swing whose worst stop stays inside the travel."""

    def needed(half_swing: float) -> float:
        peak = sqrt(2 * half_swing * (d * d - f * f) / (inertia * d))
        return travel_needed(stopping, half_swing, f / d, peak, overdrive * d)

    low, high = 0.0, _TRAVEL_SHARE * travel
    for _ in range(60):
        middle = (low + high) / 2
        if needed(middle) <= travel:
            low = middle
        else:
            high = middle
    return low


def travel_needed(
    stopping: Stopping, half_swing: float, switching: float, peak_speed: float, torque: float
) -> float:
    """Travel that an oscillation asks for, rad or m.

    Its worst stop, at full speed past the switching.

    Parameters
    ----------
    half_swing : rad or m
    switching : where the torque switches, as a share of the half-swing
    peak_speed : rad/s or m/s
    torque : largest about the bias, N.m or N
    """
    reach = half_swing * switching + stopping.distance(peak_speed, torque)
    return max(reach, half_swing) / _TRAVEL_SHARE
