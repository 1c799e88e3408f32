"""A relay finds a period, an oscillator holds it: the record for modulating functions and lock-in.

`auto` and `modulating`: some periods of a relay at d1, some of the oscillator at d2, nothing
settled. `lock-in`: the oscillator at d1 and at d2, each until its fundamental repeats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from commissioning.errors import MeasurementRejected
from commissioning.experiments.design import RelayDesign
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.oscillator import Held, Oscillator, Wave, hold, stop_at_reversal
from commissioning.experiments.plan import Context, Plan, come_to_rest
from commissioning.experiments.relay import Relay
from commissioning.experiments.relay_cycles import Span, limit_cycle
from commissioning.identification.limit_cycle import LimitCycle, periods_of
from drivers.sample import Sample

__all__ = ["Oscillations", "Stretch", "oscillations"]

_FIRST_KNOB = 0.5  # of the hysteresis that the first look promises for the wanted period
_GROWTH = 1.7  # of the hysteresis from period to period
_AVERAGED = 2  # last periods of the relay
_TRUST = 0.7  # share of a seen change of the offset that the bias follows


@dataclass(frozen=True, slots=True)
class Stretch:
    """What the oscillator is to do.

    `amplitude` 1 or 2 of the design, periods to measure, at most.
    """

    amplitude: int
    measure: int
    most: int


@dataclass(frozen=True, slots=True)
class Oscillations:
    """One uninterrupted record of oscillations.

    Attributes
    ----------
    begin, end : s
    relay : limit cycle of the relay's last periods
    relay_span : where they lie, s
    held : the stretches of the oscillator
    periods : of all
    """

    begin: float
    end: float
    relay: LimitCycle
    relay_span: Span
    held: tuple[Held, ...]
    periods: int


def oscillations(
    context: Context,
    design: RelayDesign,
    known: FirstLook,
    relay_periods: int,
    stretches: tuple[Stretch, ...],
    *,
    wave: Wave = "square",
    knob: float | None = None,
    staged: bool = True,
    period: float | None = None,
) -> Plan[Oscillations]:
    """From rest: relay, then the oscillator at the relay's period; raises MeasurementRejected.

    Parameters
    ----------
    relay_periods : how many, staging included
    knob : hysteresis to begin with, where an earlier record knows it, rad or m
    staged : whether the hysteresis grows from there, as far as the design has room
    period : of the oscillator, s; None: the relay's
    """
    context.tell(f"relay at ±{design.d1:.4g} {context.effort_unit}: finds a period")
    goal = design.half_swing_1 * min(known.coulomb / design.d1, 0.8)
    sample = yield design.bias
    centre = sample.position  # where the approach came to rest: that is near enough to the start
    relay = Relay(design.d1, knob or _FIRST_KNOB * goal, centre, context.cycle, design.bias)
    begin = sample.time
    sample, cycle, span = yield from _find_period(
        context, relay, design, known, sample, relay_periods, staged=staged
    )
    half = max(round((period or cycle.period) / (2 * context.cycle)), 4)
    held: list[Held] = []
    before = design.d1
    gain = cycle.half_swing / (4 / np.pi * cycle.relay_amplitude)
    for stretch in stretches:
        amplitude = (design.d1, design.d2)[stretch.amplitude - 1]
        amplitude = min(amplitude, context.torque - abs(relay.bias) - context.torque_resolution)
        context.tell(
            f"oscillator at ±{amplitude:.4g} {context.effort_unit}, period "
            f"{2 * half * context.cycle * 1000:.4g} ms"
        )
        most = context.torque - abs(relay.bias) - context.torque_resolution
        oscillator = Oscillator(
            amplitude, 2 * half * context.cycle, centre, relay.bias,
            gain=gain, cycle=context.cycle, most=min(design.most, most), wave=wave,
            lead=_lead(before, amplitude, known.coulomb),
        )  # fmt: skip
        before = amplitude
        found, sample = yield from hold(context, oscillator, sample, stretch.measure, stretch.most)
        held.append(found)
    end = sample.time
    sample = yield from stop_at_reversal(oscillator.torque, sample, relay.bias, 2 * cycle.period)
    yield from come_to_rest(relay.bias, context)
    periods = relay_periods + sum(found.periods for found in held)
    return Oscillations(begin, end, cycle, span, tuple(held), periods)


def _lead(before: float, after: float, coulomb: float) -> float:
    """Phase at which a larger square wave goes on without a drift, periods.

    At one period the peak speed goes with (d² − f²)/d. The axis comes with that of the smaller wave
    and is to leave the half wave with that of the larger one.
    """
    f = min(coulomb, 0.9 * before)
    slow, fast = ((d * d - f * f) / d for d in (before, after))
    return max(0.25 * (1 - slow / fast), 0.0)


def _find_period(
    context: Context,
    relay: Relay,
    design: RelayDesign,
    known: FirstLook,
    sample: Sample,
    count: int,
    *,
    staged: bool,
) -> Plan[tuple[Sample, LimitCycle, Span]]:
    """`count` periods of the relay.

    The hysteresis grows, with the limits checked, from each to the next.

    A period is from one switching to + to the next. Ends at one.
    """
    time: list[float] = []
    position: list[float] = []
    command: list[float] = []
    longest = 4 * design.period + 0.5
    starts: list[int] = []
    since = sample.time
    while True:
        before = relay.sign
        torque = relay.switch(sample)
        time.append(sample.time)
        position.append(sample.position)
        command.append(sample.command)
        if relay.sign != before:
            since = sample.time
            if relay.sign > 0:
                starts.append(len(time) - 1)
                if len(starts) > count:
                    break
                if 1 < len(starts) <= count - 1 or (staged and len(starts) == 2):
                    _adjust(
                        context, relay, design, known,
                        *(np.array(x[starts[-2] :]) for x in (time, position, command)),
                        staged=staged,
                    )  # fmt: skip
        elif sample.time - since > longest:
            raise MeasurementRejected(
                f"the relay of ±{relay.amplitude:.4g} {context.effort_unit} does not oscillate: no "
                f"reversal within {longest:.3g} s. Breakaway and offset are too large for it, or "
                "the axis is blocked",
                code="measurement.no-oscillation",
                hint="raise --max-torque",
            )
        sample = yield torque
    first = max(starts[-1 - min(_AVERAGED, count)] - _quarter(time, starts), 0)
    periods = periods_of(
        time[first:], position[first:], command[first:], relay.reference, relay.bias
    )
    if not len(periods):
        raise MeasurementRejected(
            "the relay makes no whole period about its reference: the axis drifts, or the load "
            "changes",
            code="measurement.drifts",
            hint="is the offset constant?",
        )
    cycle, span = limit_cycle(relay, periods.last(_AVERAGED), is_settled=False)
    return sample, cycle, span


def _quarter(time: list[float], starts: list[int]) -> int:
    """Samples of half a period: the crossing of the reference comes before the switching."""
    return (starts[-1] - starts[-2]) // 2


def _adjust(
    context: Context,
    relay: Relay,
    design: RelayDesign,
    known: FirstLook,
    time: np.ndarray,
    position: np.ndarray,
    command: np.ndarray,
    *,
    staged: bool,
) -> None:
    """After one period: a larger hysteresis where there is room, and the bias to 50 % duty."""
    period = float(time[-1] - time[0])
    swing = float(np.ptp(position)) / 2
    rising = np.diff(position) > 0
    direction = float(np.sum(np.where(rising, 1.0, -1.0) * np.diff(time))) / period
    # DC balance: mean(u) = offset + f·mean(sign v)
    offset = float(np.mean(command[1:])) - known.coulomb * direction
    limit = context.torque - max(design.d1, design.d2) - context.torque_resolution
    moved = _TRUST * (offset - relay.bias)
    if abs(moved) > 0.01 * relay.amplitude:
        relay.bias = max(-limit, min(limit, relay.bias + moved))
    if staged:
        room = min(design.half_swing / swing, (design.period / period) ** 2)
        if room > 1.1 or room < 0.9:
            relay.knob *= min(_GROWTH, room)
            context.detail(
                f"staging: period {period * 1000:.3g} of {design.period * 1000:.3g} ms, half-swing "
                f"{swing:.3g} of at most {design.half_swing:.3g} {context.position_unit}"
            )
