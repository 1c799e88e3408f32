"""Two relay tests at one frequency: the experiment of the thesis (Blaha 2001, 4.3 and 4.5).

Test 1 runs with (d1, ε1) until it settles. Test 2 runs with d2 and moves its hysteresis until its
period is that of test 1.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from math import log, sqrt
from typing import Literal

import numpy as np

from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context, Plan, come_to_rest
from commissioning.experiments.relay import Relay
from commissioning.experiments.stopping import Stopping
from commissioning.identification.limit_cycle import (
    FEWEST,
    LimitCycle,
    Periods,
    measure,
    periods_of,
    settled,
)
from drivers.sample import Sample
from profiles.errors import MeasurementRejected, PreflightRefused

__all__ = ["RelayDesign", "TwoRelay", "design", "two_relay"]

Solver = Literal["bracket", "thesis", "none"]

# Comfortable conditioning (method.md 2): f/d1 in 0.4–0.6, d2/d1 at least 1.5
_D1_FRICTION, _D1_BREAKAWAY = 1.7, 1.3
_RATIO, _LEAST_RATIO = 1.8, 1.4
_DEAD_TIMES = 40  # a period must be this many
_FEWEST_CYCLES = 40  # samples a period
_SHORTEST_PERIOD = 0.1  # s
_FEWEST_COUNTS = 200  # encoder counts of half-swing
_MOST_PERIODS = 60  # of one test
_GROWTH = 1.35  # of the hysteresis from stage to stage
_MOST_TESTS = 14
_CLOSE = 0.006  # of the period: a mismatch that the interval can carry
_TORQUE_SHARE = 0.97  # of the limit; the rest is for the bias to move
_FROM_BELOW = 0.8  # of the first guess of the second hysteresis
_TRAVEL_SHARE = 0.7  # of the travel: what the worst stop may take
_SPEED_SHARE = 0.5  # of the speed limit, at the peak of the larger test
_TRANSIENT = 3  # periods after a change that are not averaged


@dataclass(frozen=True, slots=True)
class RelayDesign:
    """What the two tests are run with, chosen from the first look and the limits.

    Attributes
    ----------
    d1, d2 : relay amplitudes (half of the swing), N.m or N
    hysteresis : ε1 to begin with, rad or m; staged upwards from there
    period : s, goal of test 1; reached unless travel or speed end the staging before
    half_swing : rad or m, largest that test 1 may grow to
    bias : N.m or N, first guess of the offset
    """

    d1: float
    d2: float
    hysteresis: float
    period: float
    half_swing: float
    bias: float


@dataclass(frozen=True, slots=True)
class TwoRelay:
    """Both limit cycles, and where in the record they lie.

    `first_span`, `second_span`: begin and end in s of the averaged periods.
    `tests`: relay tests that the search for equal periods took.
    """

    first: LimitCycle
    second: LimitCycle
    first_span: tuple[float, float]
    second_span: tuple[float, float]
    tests: int
    periods: int


def design(
    context: Context, known: FirstLook, stopping: Stopping, *, longest_period: float = 2.0
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

    period = max(_DEAD_TIMES * known.dead_time, _FEWEST_CYCLES * context.cycle, _SHORTEST_PERIOD)
    counts = _FEWEST_COUNTS * context.resolution
    period = max(period, sqrt(counts * 32 * inertia * d1 / (d1 * d1 - f * f)))
    period = min(period, longest_period)
    room = _room(context, stopping, d2, f, inertia)
    by_travel = sqrt(room * 32 * inertia * d2 / (d2 * d2 - f * f))
    by_speed = _SPEED_SHARE * context.speed * 4 * inertia * d2 / (d2 * d2 - f * f)
    period = min(period, by_travel, by_speed)
    growth = half_swing(period, d2) / half_swing(period, d1)
    first = half_swing(period, d1)
    if first < 20 * context.resolution or period < 8 * context.cycle:
        raise PreflightRefused(
            f"the travel of ±{context.travel:.4g} {context.position_unit} is too small: it allows a "
            f"swing of ±{room:.3g} {context.position_unit} and a period of {period * 1000:.3g} ms, "
            f"against a cycle of {context.cycle * 1000:g} ms; give more --travel or a shorter --cycle"
        )
    return RelayDesign(d1, d2, 0.3 * first * f / d1, period, room / growth, known.offset)


def _room(context: Context, stopping: Stopping, d: float, f: float, inertia: float) -> float:
    """Largest half-swing whose worst stop, at full speed past the switching point, stays inside."""
    allowed = _TRAVEL_SHARE * context.travel

    def reach(half_swing: float) -> float:
        peak = sqrt(2 * half_swing * (d * d - f * f) / (inertia * d))
        return half_swing * f / d + stopping.distance(peak, d)

    low, high = 0.0, allowed
    for _ in range(60):
        middle = (low + high) / 2
        if max(reach(middle), middle) <= allowed:
            low = middle
        else:
            high = middle
    return low


def two_relay(
    context: Context,
    plan: RelayDesign,
    known: FirstLook,
    *,
    solver: Solver = "bracket",
    k_epsilon: float = 0.1,
) -> Plan[TwoRelay]:
    """Both tests; returns the two limit cycles. Raises MeasurementRejected.

    `solver`: how the second test finds the period of the first; "none" leaves it at its own, which is
    enough for modulating functions, and short.
    """
    relay = Relay(plan.d1, plan.hysteresis, context.start, context.cycle, plan.bias)
    test = _Test(context, relay, longest=4 * plan.period + 0.5)
    yield from _stage(test, plan)
    first, first_span = yield from _balanced(test, known)
    context.tell(
        f"relay test 1: period {first.period * 1000:.4g} ms, half-swing "
        f"{first.half_swing:.4g} {context.position_unit}"
    )
    test.relay.amplitude = min(plan.d2, context.torque - abs(test.relay.bias) - _one_step(context))
    friction = min(known.coulomb, 0.9 * plan.d1)
    ratio = (1 - (friction / plan.d2) ** 2) / (1 - (friction / plan.d1) ** 2)
    if solver == "thesis":
        second, span, tests = yield from _match_by_rule(test, first, k_epsilon)
    elif solver == "none":
        test.relay.hysteresis = _FROM_BELOW * first.hysteresis * ratio
        second, span = yield from _short(test)
        tests = 1
    else:
        # delay lowers the ratio, and from below the larger swing cannot overshoot the travel
        test.relay.hysteresis = _FROM_BELOW * first.hysteresis * ratio
        second, span, tests = yield from _match_by_bracket(test, first)
    yield from _end_at_reversal(test)
    return TwoRelay(first, second, first_span, span, tests, test.periods_run)


def _end_at_reversal(test: _Test) -> Plan[None]:
    """Take the torque away where the axis turns: friction alone then keeps it there."""
    relay = test.relay
    before = yield relay.bias + relay.sign * relay.amplitude
    moved, begun = 0.0, before.time
    while before.time < begun + test.longest:
        sample = yield relay.switch(before)
        step = sample.position - before.position
        if step * moved < 0:
            break
        moved, before = step or moved, sample
    yield from come_to_rest(relay.bias, test.context)


def _one_step(context: Context) -> float:
    """Margin for the rounding of the command, N.m or N."""
    return context.torque_resolution


class _Test:
    """A relay on the axis, and the periods that it makes."""

    def __init__(self, context: Context, relay: Relay, longest: float) -> None:
        self.context = context
        self.relay = relay
        self.longest = longest
        self.periods_run = 0

    def run(self, enough: Callable[[Periods], bool], most: int, longest: float) -> Plan[Periods]:
        """Run until `enough(periods)` or `most` periods, each of at most `longest` s."""
        relay, record = self.relay, _Record()
        sign, crossings, since = relay.sign, 0, 0.0
        sample = yield relay.switch((yield relay.bias + relay.sign * relay.amplitude))
        since = sample.time
        while True:
            record.append(sample)
            torque = relay.switch(sample)
            if relay.sign != sign:
                sign = relay.sign
                since = sample.time
                if sign > 0:
                    crossings += 1
                    periods = record.periods(relay)
                    if len(periods) >= most or enough(periods):
                        self.periods_run += len(periods)
                        return periods
            elif sample.time - since > longest:
                raise self._stalled(longest)
            if crossings > most + 3:
                raise self._stalled(longest)
            sample = yield torque

    def _stalled(self, longest: float) -> MeasurementRejected:
        relay, context = self.relay, self.context
        return MeasurementRejected(
            f"the relay of ±{relay.amplitude:.4g} {context.effort_unit} does not oscillate: no "
            f"reversal within {longest:.3g} s. Breakaway and offset are too large for it, or the "
            "axis is blocked; raise --max-torque"
        )


class _Record:
    """Samples of one test as growing columns."""

    def __init__(self) -> None:
        self._periods: Periods | None = None
        self._from = 0
        self.time: list[float] = []
        self.position: list[float] = []
        self.command: list[float] = []

    def append(self, sample: Sample) -> None:
        self.time.append(sample.time)
        self.position.append(sample.position)
        self.command.append(sample.command)

    def periods(self, relay: Relay) -> Periods:
        """Every whole period so far; only what is new is evaluated."""
        tail = slice(self._from, None)
        fresh = periods_of(
            self.time[tail], self.position[tail], self.command[tail], relay.reference, relay.bias
        )
        if len(fresh):
            end = float(fresh.start[-1] + fresh.period[-1])
            self._from = max(bisect_left(self.time, end) - 2, 0)
        self._periods = fresh if self._periods is None else self._periods.followed_by(fresh)
        return self._periods


def _stage(test: _Test, plan: RelayDesign) -> Plan[None]:
    """Smallest oscillation first; the hysteresis grows until period or half-swing is reached."""
    context, relay = test.context, test.relay
    while True:
        periods = yield from test.run(lambda p: len(p) >= 2, _MOST_PERIODS, test.longest)
        period, swing = float(periods.period[-1]), float(periods.half_swing[-1])
        context.tell(
            f"staging: period {period * 1000:.3g} of {plan.period * 1000:.3g} ms, half-swing "
            f"{swing:.3g} of at most {plan.half_swing:.3g} {context.position_unit}"
        )
        room = min(
            plan.half_swing / swing,
            (plan.period / period) ** 2,
        )
        if room <= 1.1:
            return
        relay.hysteresis *= min(_GROWTH, room)


def _balanced(test: _Test, known: FirstLook) -> Plan[tuple[LimitCycle, tuple[float, float]]]:
    """Move the bias until both directions take the same time (50 % duty), then settle."""
    relay, context = test.relay, test.context
    for _ in range(8):
        periods = yield from test.run(
            lambda p: len(p) >= _TRANSIENT + 4, _MOST_PERIODS, test.longest
        )
        recent = periods.last(4)
        direction = float(np.mean(recent.direction))
        # DC balance: mean(u) = offset + f * mean(sign v)
        offset = float(np.mean(recent.command)) - known.coulomb * direction
        limit = context.torque - relay.amplitude
        bias = max(-limit, min(limit, offset))
        moved = abs(bias - relay.bias)
        relay.bias = bias
        if moved <= max(0.01 * relay.amplitude, context.torque_resolution):
            break
    return (yield from _settle(test, 1))


def _settle(test: _Test, number: int) -> Plan[tuple[LimitCycle, tuple[float, float]]]:
    """Run until period and half-swing repeat; average the last periods."""
    relay, cycle = test.relay, test.context.cycle

    def enough(periods: Periods) -> bool:
        if len(periods) < _TRANSIENT + FEWEST:
            return False
        last = periods.last(max(FEWEST, min(len(periods) - _TRANSIENT, 2 * FEWEST)))
        return settled(last.period, 0.02 * cycle) and settled(
            last.half_swing, 2e-3 * float(last.half_swing[-1])
        )

    periods = yield from test.run(enough, _MOST_PERIODS, test.longest)
    count = max(FEWEST, min(len(periods) - _TRANSIENT, 2 * FEWEST))
    if len(periods) < FEWEST:
        raise MeasurementRejected(f"relay test {number} gave only {len(periods)} whole periods")
    is_settled = enough(periods)
    last = periods.last(count)
    cycle_found = measure(
        last, relay.amplitude, relay.hysteresis, relay.bias, is_settled=is_settled
    )
    span = (float(last.start[0]), float(last.start[-1] + last.period[-1]))
    return cycle_found, span


def _short(test: _Test) -> Plan[tuple[LimitCycle, tuple[float, float]]]:
    """Some periods, settled or not."""
    relay = test.relay
    periods = yield from test.run(lambda p: len(p) >= FEWEST, FEWEST, test.longest)
    cycle = measure(periods, relay.amplitude, relay.hysteresis, relay.bias, is_settled=False)
    return cycle, (float(periods.start[0]), float(periods.start[-1] + periods.period[-1]))


def _tolerance(first: LimitCycle, second: LimitCycle, cycle: float) -> float:
    """Difference of periods that counts as none, s: their scatter, and a share of the cycle."""
    return max(
        2 * sqrt(first.period_error**2 + second.period_error**2),
        0.02 * cycle,
        1e-3 * first.period,
    )


def _match_by_bracket(
    test: _Test, first: LimitCycle
) -> Plan[tuple[LimitCycle, tuple[float, float], int]]:
    """Find ε2 with T2 = T1 by a bracketing secant (Illinois) in log ε2."""
    relay, context = test.relay, test.context
    low: tuple[float, float] | None = None  # (log ε2, T2 - T1) with T2 < T1
    high: tuple[float, float] | None = None
    last_side = 0
    best: tuple[float, LimitCycle, tuple[float, float]] | None = None
    for number in range(1, _MOST_TESTS + 1):
        second, span = yield from _settle(test, 2)
        x, gap = log(relay.hysteresis), second.period - first.period
        if best is None or abs(gap) < best[0]:
            best = (abs(gap), second, span)
        context.tell(
            f"relay test 2, try {number}: period {second.period * 1000:.4g} of "
            f"{first.period * 1000:.4g} ms"
        )
        if abs(gap) <= _tolerance(first, second, context.cycle):
            return second, span, number
        side = -1 if gap < 0 else 1
        if side < 0:
            low = (x, gap)
            if high is not None and last_side == side:
                high = (high[0], high[1] / 2)
        else:
            high = (x, gap)
            if low is not None and last_side == side:
                low = (low[0], low[1] / 2)
        last_side = side
        if low is None or high is None:
            # T grows about as the square root of ε: aim beyond the goal to bracket it
            step = 2.5 * abs(gap) / first.period + 0.02
            x = x + step if gap < 0 else x - step
        else:
            x = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        relay.hysteresis = float(np.exp(x))
        _check_feasible(context, relay, first)
    if best is not None and best[0] <= _CLOSE * first.period:
        return best[1], best[2], _MOST_TESTS  # the interval carries the mismatch
    raise MeasurementRejected(
        f"the second relay test does not reach the period of the first within {_MOST_TESTS} tries "
        f"(it is off by {gap * 1000:.3g} ms of {first.period * 1000:.4g} ms); the axis changes "
        "while it is measured, or is not rigid"
    )


def _check_feasible(context: Context, relay: Relay, first: LimitCycle) -> None:
    if relay.hysteresis < max(0.02 * first.hysteresis, 0.5 * context.resolution):
        raise MeasurementRejected(
            f"the hysteresis of the second relay test runs into zero before its period reaches "
            f"{first.period * 1000:.4g} ms: with dead time this large the tests cannot be matched; "
            "give more --travel, so that the period is long against the dead time"
        )


def _match_by_rule(
    test: _Test, first: LimitCycle, k_epsilon: float
) -> Plan[tuple[LimitCycle, tuple[float, float], int]]:
    """The thesis' own rule (4.21): ε ← ε + k_ε·A2·(T1 − T2)/T2, every settled stretch."""
    relay, context = test.relay, test.context
    for number in range(1, 400):
        second, span = yield from _settle(test, 2)
        gap = first.period - second.period
        if number % 10 == 1:
            context.tell(
                f"relay test 2, step {number} of rule (4.21): period {second.period * 1000:.4g} of "
                f"{first.period * 1000:.4g} ms"
            )
        if abs(gap) <= _tolerance(first, second, context.cycle):
            return second, span, number
        relay.hysteresis += k_epsilon * second.half_swing * gap / second.period
        _check_feasible(context, relay, first)
    raise MeasurementRejected(
        f"rule (4.21) with k = {k_epsilon:g} does not converge within 400 steps (still "
        f"{gap * 1000:.3g} ms off); use the bracketing solver"
    )
