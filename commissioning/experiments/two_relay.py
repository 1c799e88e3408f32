"""Two relay tests at one frequency: the experiment of the thesis (Blaha 2001, 4.3 to 4.6).

Test 1 runs with (d1, ε1) until it settles. Test 2 runs with d2 and moves its hysteresis until its
period is that of test 1. The alternative has ideal relays with a delay τ in place of the
hysteresis.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log, sqrt
from typing import Literal

from commissioning.errors import MeasurementRejected
from commissioning.experiments.design import RelayDesign
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context, Plan
from commissioning.experiments.relay import Relay, Switching
from commissioning.experiments.relay_cycles import (
    RelayTest,
    Span,
    balanced,
    end_at_reversal,
    settle,
    stage,
)
from commissioning.identification.limit_cycle import LimitCycle

__all__ = ["Solver", "TwoRelay", "two_relay"]

Solver = Literal["bracket", "thesis"]

_MOST_TESTS = 14
_MOST_STEPS = 400  # of the thesis' own rules
_CLOSE = 0.006  # of the period: a mismatch that the interval can carry
_FROM_BELOW = 0.8  # of the first guess of the second hysteresis
_K_EPSILON, _K_TAU = 0.1, 0.2  # gains of (4.21) and (4.25)


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


def two_relay(
    context: Context,
    design: RelayDesign,
    known: FirstLook,
    *,
    solver: Solver = "bracket",
    switching: Switching = "hysteresis",
) -> Plan[TwoRelay]:
    """Both tests; returns the two limit cycles. Raises MeasurementRejected.

    `solver`: how the second test finds the period of the first, by a bracketing secant or by the
    rules of the thesis, (4.21) and (4.25).
    """
    friction = min(known.coulomb, 0.9 * design.d1)
    knob = design.hysteresis
    if switching == "delay":
        knob = max(
            _delay_for(0.5 * design.period, friction / design.d1) - known.dead_time, context.cycle
        )
    relay = Relay(design.d1, knob, context.start, context.cycle, design.bias, switching=switching)
    test = RelayTest(context, relay, longest=4 * design.period + 0.5)
    yield from stage(test, design)
    first, first_span = yield from balanced(test, known)
    context.tell(
        f"relay test 1: period {first.period * 1000:.4g} ms, half-swing "
        f"{first.half_swing:.4g} {context.position_unit}"
    )
    relay.amplitude = min(design.d2, context.torque - abs(relay.bias) - context.torque_resolution)
    # from below the larger swing cannot overshoot the travel
    if switching == "delay":
        ratio = _delay_for(1.0, friction / relay.amplitude) / _delay_for(1.0, friction / design.d1)
    else:
        # exact without viscous friction and delay; delay lowers it
        ratio = (1 - (friction / relay.amplitude) ** 2) / (1 - (friction / design.d1) ** 2)
    test_1_knob = relay.knob
    relay.knob *= _FROM_BELOW * ratio
    match = _match_by_rule if solver == "thesis" else _match_by_bracket
    second, span, tests = yield from match(test, first, test_1_knob)
    yield from end_at_reversal(test)
    return TwoRelay(first, second, first_span, span, tests, test.periods_run)


def _delay_for(period: float, share: float) -> float:
    """Delay with which an ideal relay makes `period` on a rigid axis, s; `share` = f/d.

    The axis passes the reference and accelerates on with (d − f)/J until it is switched at A·f/d.
    """
    root = sqrt(1 + share)
    return period / 4 * root * (root - 1)


def _tolerance(first: LimitCycle, second: LimitCycle, cycle: float) -> float:
    """Difference of periods that counts as none, s: their scatter, and a share of the cycle."""
    return max(
        2 * sqrt(first.period_error**2 + second.period_error**2),
        0.02 * cycle,
        1e-3 * first.period,
    )


def _match_by_bracket(
    test: RelayTest, first: LimitCycle, first_knob: float
) -> Plan[tuple[LimitCycle, Span, int]]:
    """Find ε2 or τ2 with T2 = T1 by a bracketing secant (Illinois) in its logarithm."""
    relay, context = test.relay, test.context
    low: tuple[float, float] | None = None  # (log knob, T2 - T1) with T2 < T1
    high: tuple[float, float] | None = None
    last_side = 0
    best: tuple[float, LimitCycle, Span] | None = None
    for number in range(1, _MOST_TESTS + 1):
        second, span = yield from settle(test, 2)
        x, gap = log(relay.knob), second.period - first.period
        if best is None or abs(gap) < best[0]:
            best = (abs(gap), second, span)
        context.detail(
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
            # aim beyond the goal to bracket it
            step = (1.25 * abs(gap) / first.period + 0.01) / relay.power
            x = x + step if gap < 0 else x - step
        else:
            x = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        relay.knob = exp(x)
        _check_feasible(context, relay, first, first_knob)
    if best is not None and best[0] <= _CLOSE * first.period:
        return best[1], best[2], _MOST_TESTS  # the interval carries the mismatch
    raise MeasurementRejected(
        f"the second relay test does not reach the period of the first within {_MOST_TESTS} tries "
        f"(it is off by {gap * 1000:.3g} ms of {first.period * 1000:.4g} ms); the axis changes "
        "while it is measured, or is not rigid",
        code="measurement.period",
    )


def _check_feasible(context: Context, relay: Relay, first: LimitCycle, first_knob: float) -> None:
    least = 0.02 * first_knob
    if relay.switching == "hysteresis":
        least = max(least, 0.5 * context.resolution)
    if relay.knob < least:
        raise MeasurementRejected(
            f"the {relay.switching} of the second relay test runs into zero before its period "
            f"reaches {first.period * 1000:.4g} ms: with dead time this large the tests cannot be "
            "matched",
            code="measurement.period",
            hint="give more --travel, so that the period is long against the dead time",
        )


def _match_by_rule(
    test: RelayTest, first: LimitCycle, first_knob: float
) -> Plan[tuple[LimitCycle, Span, int]]:
    """The thesis' own rules, every settled stretch.

    ε ← ε + k_ε·A2·(T1 − T2)/T2   (4.21)        τ ← τ + k_τ·(T1 − T2)   (4.25)
    """
    relay, context = test.relay, test.context
    rule, k = ("(4.21)", _K_EPSILON) if relay.switching == "hysteresis" else ("(4.25)", _K_TAU)
    for number in range(1, _MOST_STEPS):
        second, span = yield from settle(test, 2)
        gap = first.period - second.period
        if number % 10 == 1:
            context.detail(
                f"relay test 2, step {number} of rule {rule}: period {second.period * 1000:.4g} of "
                f"{first.period * 1000:.4g} ms"
            )
        if abs(gap) <= _tolerance(first, second, context.cycle):
            return second, span, number
        if relay.switching == "hysteresis":
            relay.knob += k * second.half_swing * gap / second.period
        else:
            relay.knob += k * gap
        _check_feasible(context, relay, first, first_knob)
    raise MeasurementRejected(
        f"rule {rule} with k = {k:g} does not converge within {_MOST_STEPS} steps (still "
        f"{gap * 1000:.3g} ms off)",
        code="measurement.period",
        hint="use the bracketing solver",
    )
