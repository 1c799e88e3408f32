"""One run of relay and oscillator, as what a method reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from commissioning.experiments.approach import approach
from commissioning.experiments.oscillations import Oscillations, Stretch, oscillations
from commissioning.experiments.oscillator import Wave
from commissioning.experiments.plan import Plan
from commissioning.identification.critical_point import from_model
from commissioning.identification.reading import Reader
from commissioning.identification.record import Record
from commissioning.rig.expected import lasting
from commissioning.rig.measured import Measured, Oscillation
from commissioning.rig.ready import Ready

__all__ = ["knob", "oscillate", "read_by_law", "shown", "whole"]


def oscillate(
    ready: Ready,
    relay_periods: int,
    stretches: tuple[Stretch, ...],
    *,
    wave: Wave = "square",
    knob: float | None = None,
    staged: bool = True,
    period: float | None = None,
) -> Oscillations:
    """Approach the start, relay, oscillator; `knob`, `period` where an earlier run knows them."""

    def plan() -> Plan[Oscillations]:
        yield from approach(ready.context, ready.context.start, ready.known)
        return (
            yield from oscillations(
                ready.context, ready.design, ready.known, relay_periods, stretches,
                wave=wave, knob=knob, staged=staged, period=period,
            )
        )  # fmt: skip

    periods = relay_periods + sum(stretch.measure for stretch in stretches)
    ready.watcher.lasts(lasting(periods, period or ready.design.period))
    return ready.run(plan())


def shown(ready: Ready, found: Oscillations, record: Record, *, periods: int) -> Measured:
    """What one run of relay and oscillator shows, `periods` of them in all."""
    last = found.held[-1]
    inside = (record.time >= last.begin) & (record.time <= last.end)
    second = replace(
        found.relay,
        relay_amplitude=last.amplitude,
        hysteresis=float("nan"),
        period=last.period,
        period_error=0.0,
        half_swing=float(np.ptp(record.position[inside])) / 2,
        fundamental=float("nan"),
        periods=last.periods,
        settled=last.settled,
    )
    return Measured(
        ready,
        found.relay,
        (
            Oscillation("relay", found.relay, found.relay_span),
            Oscillation("oscillator", second, (last.begin, last.end)),
        ),
        record,
        periods,
    )


def read_by_law(measured: Measured) -> None:
    """Relay and oscillator by the law that explains their record, if there is one."""
    found = measured.explained
    if found is None:
        return
    first, second = measured.shown
    model = measured.positions
    if model is not None and "spring" not in model.terms:  # it is known at this very frequency
        measured.corrected, measured.second = (
            from_model(
                model.inertia, model.viscous, model.dead_time, one.cycle.period, measured.lag
            )
            for one in (first, second)
        )
        return
    reader = Reader(measured.record, found, first.cycle.period)
    measured.corrected = reader.point(*whole(first))
    measured.second = reader.point(*whole(second))


def whole(shown: Oscillation) -> tuple[float, float, int]:
    """Begin, period and number of the whole periods of an oscillation."""
    begin, end = shown.span
    period = shown.cycle.period
    return begin, period, max(round((end - begin) / period - 0.2), 1)


def knob(measured: Measured) -> float:
    """Hysteresis with which the relay found its period, rad or m."""
    return measured.relay.hysteresis
