"""Output error: as few periods as the precision asks for."""

from __future__ import annotations

from dataclasses import replace

from commissioning.errors import MeasurementRejected
from commissioning.experiments.oscillations import Stretch
from commissioning.identification.errors import NotShown
from commissioning.identification.motion import Model
from commissioning.identification.output_error import OutputErrorEstimate, output_error
from commissioning.identification.verdict import of_output_error
from commissioning.result.readings import MethodName
from commissioning.rig.measured import Measured
from commissioning.rig.oscillated import knob, oscillate, read_by_law, shown
from commissioning.rig.ready import Ready

__all__ = ["attempted", "positions", "precise", "unexplained"]

_FIRST, _MOST = 2, 12  # periods of relay and of oscillator at first, and of both at most
_MOST_DESIGNS = 2  # how often the oscillations are chosen anew
_STARTING, _HEAT_SHARE = 5.0, 0.5  # s to where it begins, at most; of the i²t budget
_GROWS = 1.2  # more periods than the square of what the interval lacks asks for


def unexplained(measured: Measured) -> str:
    """Why the positions do not give the number."""
    found = measured.output_error
    if found is None:
        return "four periods show no rigid axis"
    if found.bends:
        return "friction that falls with the speed would explain the positions as well"
    return f"a rigid axis leaves {100 * found.misfit:.2g} % of the friction unexplained"


def attempted(ready: Ready) -> Measured | None:
    """The same where it need not be: None where the axis does not oscillate in so few periods."""
    try:
        return _measured(ready)
    except MeasurementRejected as error:
        ready.context.detail(str(error))
        return None


def precise(ready: Ready) -> Measured:
    """Relay and oscillator, two periods each, and again until the interval is as asked.

    Raises MeasurementRejected.
    """
    measured = _measured(ready)
    if measured.output_error is None:
        raise NotShown("no rigid axis moves like this")
    return measured


def positions(measured: Measured) -> OutputErrorEstimate | None:
    """What the positions of another method's record say; its numbers, where that explains them."""
    try:
        fitted = _fitted(measured.ready, measured)
    except NotShown:
        return None
    if fitted.is_explained:
        ready = measured.ready
        measured.by[MethodName.OUTPUT_ERROR] = fitted
        measured.reasons = of_output_error(fitted, ready.options.precision, ready.units)
        read_by_law(measured)
    return fitted


def _measured(ready: Ready) -> Measured:
    spans: list[tuple[float, float]] = []
    before: Measured | None = None
    count, periods, used, designs = _FIRST, 0, 0, 0
    while True:
        try:
            found = oscillate(
                ready, _FIRST, (Stretch(2, count, count),), knob=knob(before) if before else None
            )
        except MeasurementRejected as error:
            if before is None:
                raise
            ready.context.detail(f"no more periods: {error}")
            break
        periods, used = periods + found.periods, used + found.periods
        spans.append((found.begin, found.end))
        now = shown(ready, found, ready.records(spans), periods=periods)
        now.spans = tuple(spans)
        if before is not None:  # the first relay found its period by itself
            now.relay, now.shown = before.relay, (before.shown[0], now.shown[1])
        try:
            fitted = _fitted(ready, now)
        except NotShown:
            if before is None:
                return now
            break
        if fitted.is_explained and before is None and designs < _MOST_DESIGNS:
            again = ready.redesigned(fitted)
            if again is not None:
                ready, spans, used, designs = again, [], 0, designs + 1
                continue
        if before is not None and not fitted.is_explained:
            break  # the axis has changed: what the first periods showed is a number of its own
        ready.watcher.friction(fitted.coulomb.value, fitted.coulomb.low, fitted.coulomb.high)
        now.by[MethodName.OUTPUT_ERROR] = fitted
        now.reasons = of_output_error(fitted, ready.options.precision, ready.units)
        before = now
        more = _more(ready, now, fitted, used) if fitted.is_explained else None
        if more is None:
            break
        count = more
    read_by_law(before)
    return before


def _more(ready: Ready, measured: Measured, found: OutputErrorEstimate, used: int) -> int | None:
    """Further periods of the oscillator, after `used`; None: none are asked for, or left.

    None are left by the number of periods, the time that is allowed, and the motor's heat.
    """
    wanted, half = ready.options.precision, found.coulomb.half_width
    left = _MOST - used
    if half <= wanted or left < 2 * _FIRST:
        return None
    asked = used * min(_GROWS * min(half / wanted, _MOST) ** 2, _MOST) - used
    count = min(max(round(asked) - _FIRST, _FIRST), left - _FIRST)
    seconds = (_FIRST + count) * measured.shown[1].cycle.period
    if _STARTING + seconds > ready.time_left:
        return None
    if ready.heat(ready.design.d2, seconds) > _HEAT_SHARE:
        return None
    ready.context.detail(
        f"±{100 * half:.2g} % after {used} periods, ±{100 * wanted:.2g} % are asked for: "
        f"{_FIRST + count} more"
    )
    return count


def _fitted(ready: Ready, measured: Measured) -> OutputErrorEstimate:
    """From what the first motions have shown."""
    known = ready.known
    start = Model(known.inertia, known.viscous, known.offset, known.dead_time)
    found = output_error(
        measured.record, start, known.coulomb, noise=ready.context.noise,
        rotary=ready.units.position == "rad", spans=measured.spans,
    )  # fmt: skip
    # a load that never moves is no part of what was measured
    return replace(found, is_explained=False) if found.only_winds_up(known.coulomb) else found
