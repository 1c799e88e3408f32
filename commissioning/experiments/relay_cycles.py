"""One relay test: staging, 50 % duty, settling, and an end where the axis turns."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np

from commissioning.errors import MeasurementRejected
from commissioning.experiments.design import RelayDesign
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context, Plan, come_to_rest
from commissioning.experiments.relay import Relay
from commissioning.identification.limit_cycle import (
    FEWEST,
    LimitCycle,
    Periods,
    measure,
    periods_of,
    settled,
)
from drivers.sample import Sample

__all__ = ["RelayTest", "Span", "balanced", "end_at_reversal", "limit_cycle", "settle", "stage"]

Span = tuple[float, float]  # begin and end, s

MOST_PERIODS = 60  # of one test
_GROWTH = 1.35  # of the hysteresis from stage to stage
_PATIENCE = 30  # periods, for enough of them that no late sample has disturbed
_RECOVERY = (4, 2, 1, 0)  # periods after a late sample that are not averaged, if there are others
_TRANSIENT = 3  # periods after a change that are not averaged


class RelayTest:
    """A relay on the axis, and the periods that it makes."""

    def __init__(self, context: Context, relay: Relay, longest: float) -> None:
        self.context = context
        self.relay = relay
        self.longest = longest
        self.periods_run = 0

    def run(self, enough: Callable[[Periods], bool], most: int, longest: float) -> Plan[Periods]:
        """Run until `enough(periods)` or `most` periods, each of at most `longest` s."""
        relay, record = self.relay, _Columns()
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
            "axis is blocked",
            code="measurement.no-oscillation",
            hint="raise --max-torque",
        )


class _Columns:
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


def stage(test: RelayTest, design: RelayDesign) -> Plan[None]:
    """Smallest oscillation first; the hysteresis grows until period or half-swing is reached."""
    context, relay = test.context, test.relay
    while True:
        periods = yield from test.run(lambda p: len(p) >= 2, MOST_PERIODS, test.longest)
        period, swing = float(periods.period[-1]), float(periods.half_swing[-1])
        context.detail(
            f"staging: period {period * 1000:.3g} of {design.period * 1000:.3g} ms, half-swing "
            f"{swing:.3g} of at most {design.half_swing:.3g} {context.position_unit}"
        )
        # on a rigid axis T ~ knob^power, and A ~ T²
        room = min(design.half_swing / swing, (design.period / period) ** 2) ** (0.5 / relay.power)
        if room <= 1.1:
            return
        relay.knob *= min(_GROWTH, room)


def balanced(test: RelayTest, known: FirstLook) -> Plan[tuple[LimitCycle, Span]]:
    """Move the bias until both directions take the same time (50 % duty), then settle."""
    relay, context = test.relay, test.context
    for _ in range(8):
        periods = yield from test.run(
            lambda p: len(_recent(p, context.cycle)) >= 4, _PATIENCE, test.longest
        )
        recent = _recent(periods, context.cycle).last(4)
        direction = float(np.mean(recent.direction))
        # DC balance: mean(u) = offset + f * mean(sign v)
        offset = float(np.mean(recent.command)) - known.coulomb * direction
        limit = context.torque - relay.amplitude
        bias = max(-limit, min(limit, offset))
        moved = abs(bias - relay.bias)
        relay.bias = bias
        if moved <= max(0.01 * relay.amplitude, context.torque_resolution):
            break
    return (yield from settle(test, 1))


def settle(test: RelayTest, number: int) -> Plan[tuple[LimitCycle, Span]]:
    """Run until period and half-swing repeat; average the last periods."""
    relay, cycle = test.relay, test.context.cycle

    def enough(periods: Periods) -> bool:
        last = _recent(periods, cycle)
        return (
            len(last) >= FEWEST
            and settled(last.period, 0.02 * cycle)
            and settled(last.half_swing, 2e-3 * float(last.half_swing[-1]))
        )

    periods = yield from test.run(enough, MOST_PERIODS, test.longest)
    last = _recent(periods, cycle)
    if len(last) < FEWEST:
        raise MeasurementRejected(
            f"relay test {number} gave only {len(periods)} whole periods",
            code="measurement.periods",
        )
    return limit_cycle(relay, last, is_settled=enough(periods))


def _recent(periods: Periods, cycle: float) -> Periods:
    """The last periods that may be averaged: undisturbed by late samples where these can be had."""
    for recovery in _RECOVERY:
        last = periods.settling(_TRANSIENT, cycle, recovery).last(2 * FEWEST)
        if len(last) >= FEWEST or len(periods) < _PATIENCE:
            return last
    return periods.last(len(periods) - _TRANSIENT)


def limit_cycle(relay: Relay, periods: Periods, *, is_settled: bool) -> tuple[LimitCycle, Span]:
    """Mean of whole periods under `relay`, and where they lie."""
    hysteresis = relay.hysteresis_of(
        float(np.mean(periods.half_swing)), float(np.mean(periods.period))
    )
    cycle = measure(periods, relay.amplitude, hysteresis, relay.bias, is_settled=is_settled)
    return cycle, (float(periods.start[0]), float(periods.start[-1] + periods.period[-1]))


def end_at_reversal(test: RelayTest) -> Plan[None]:
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
