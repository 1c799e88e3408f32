"""The methods: which oscillations each one runs, and what is read from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from commissioning.errors import MeasurementRejected
from commissioning.experiments.approach import approach
from commissioning.experiments.design import LONG, SHORT, PeriodNeeds
from commissioning.experiments.oscillations import Oscillations, Stretch
from commissioning.experiments.oscillator import Held
from commissioning.experiments.plan import Plan
from commissioning.experiments.relay import Switching
from commissioning.experiments.two_relay import Solver, TwoRelay, two_relay
from commissioning.identification.critical_point import CriticalPoint
from commissioning.identification.errors import words_of
from commissioning.identification.lock_in import LockIn, Phasors, lock_in, phasors
from commissioning.identification.modulating import (
    EXPLAINS,
    ModulatingEstimate,
    estimate,
    refined_kinematics,
)
from commissioning.identification.phase_locked import phase_locked
from commissioning.identification.reading import by_balance
from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import Kinematics, Record
from commissioning.identification.two_relay import from_cycles
from commissioning.identification.verdict import (
    agreement,
    as_wide_as_its_harmonics,
    balance_is_better,
    holding,
    of_bend,
    of_lock_in,
    of_modulating,
    of_precision,
    of_preference,
    within_short,
)
from commissioning.result.readings import MethodName, Methods
from commissioning.rig.expected import POINTS, oscillating
from commissioning.rig.measured import Measured, Oscillation
from commissioning.rig.oscillated import knob, oscillate, read_by_law, shown, whole
from commissioning.rig.points import points
from commissioning.rig.precise import attempted, positions, precise, unexplained
from commissioning.rig.readings import (
    balance_reading,
    modulating_reading,
    output_error_reading,
    two_relay_reading,
)
from commissioning.rig.ready import Ready
from commissioning.rig.rig import Rig
from profiles.errors import UnknownName

__all__ = ["METHODS", "Method", "method_of", "methods_of", "repeated"]

_RELAY_PERIODS, _HOLD_PERIODS = 5, 7  # of relay and oscillator, where no rigid law explains it
_RELAY_PERIODS_MORE, _HELD_PERIODS = 2, 8  # of relay and each oscillation, when they are not
_PERIODS_SETTLED, _MOST_PERIODS = 10, 20  # of each oscillation of lock-in: settled, and at most
_MOST_DESIGNS = 3  # how often the oscillations are chosen anew, where the first look was far off
_AFTER_SWITCHING = 3 / 8  # of a period: well after the reversal, before the next switching


def repeated(rig: Rig) -> list[Measured]:
    """All experiments; the oscillations as often as `repeat` says, each with its reading.

    Raises MeasurementRejected, PreflightRefused, DriveFault, LinkError.
    """
    method = method_of(rig.options.method)
    ready = rig.prepare(method.pace)
    found = []
    repeats, watcher = rig.options.repeat, rig.recorder.watcher
    for number in range(1, repeats + 1):
        watcher.step(oscillating(number, repeats))
        found.append(_once(method, ready))
        ready = found[-1].ready
        known = found[-1].found.coulomb
        watcher.friction(known.value, known.low, known.high)
    if rig.options.points:
        watcher.step(POINTS)
    try:
        points(found[-1], move=rig.options.points)
    except (ValueError, ArithmeticError) as error:
        why = f"the plant at −180° and −135° is not known: {words_of(error)}"
        found[-1].reasons.append(Reason("point.not-known", Weight.NOTE, why))
    return found


def _once(method: Method, ready: Ready) -> Measured:
    try:
        measured = method.run(ready)
    except (ValueError, ArithmeticError) as error:  # identification knows records, not axes
        raise MeasurementRejected(
            f"{method.name}: {words_of(error)}", code="measurement.method"
        ) from None
    value, d1 = measured.found.coulomb.value, measured.ready.design.d1
    if not 0 < value < d1:
        e = ready.units.effort
        raise MeasurementRejected(
            f"the oscillations give a friction of {value:.4g} {e}, which their own amplitude of "
            f"{d1:.4g} {e} contradicts",
            code="measurement.contradiction",
            hint="is the axis rigid, and free to move?",
        )
    return measured


def methods_of(measured: Measured) -> Methods:
    """The readings of every method that was run."""
    readings = {
        name.replace("-", "_"): reader(found)
        for name, found in measured.by.items()
        if (reader := method_of(name).read) is not None
    }
    return Methods(**readings)


# -- a dozen periods, and thirty ------------------------------------------------------------------


def _auto(ready: Ready) -> Measured:
    """As many periods as the precision asks for, where a law explains the positions.

    Else a dozen for modulating functions, or thirty and the exact balance (method.md 3a, 9.5).
    """
    first = attempted(ready)
    if first is not None and first.output_error is not None and first.output_error.is_explained:
        return first
    if first is not None:
        ready = first.ready
        ready.context.detail(f"{unexplained(first)}; a dozen periods")
    brief = None if first is None else first.output_error
    measured = _by_law_or_balance(ready, None if brief is None else brief.bent_level)
    if measured.positions is None:
        wanted, found = ready.options.precision, measured.found.coulomb
        measured.reasons += of_precision(found, measured.periods, wanted)
    measured.periods += first.periods if first is not None else 0
    return measured


def _by_law_or_balance(ready: Ready, bent: float | None) -> Measured:
    """A dozen periods where they are enough, else thirty and the exact balance.

    `bent` : level that friction falls to with the speed, by positions that said so before, N.m or N
    """
    short = _short(ready)
    ready, first = short.ready, short.modulating
    assert first is not None
    seen = positions(short)
    if seen is not None and seen.bent_level is not None:
        bent = seen.bent_level
    if short.output_error is not None or (within_short(first) and bent is None):
        return short
    why = "friction that falls with the speed" if within_short(first) else _why(first)
    ready.context.detail(f"a dozen periods are not enough: {why}; the oscillations are held")
    more = oscillate(
        ready, _RELAY_PERIODS_MORE,
        (Stretch(1, _HELD_PERIODS, _HELD_PERIODS), Stretch(2, _HELD_PERIODS, _HELD_PERIODS)),
        knob=knob(short), staged=False, period=short.shown[1].cycle.period,
    )  # fmt: skip
    record = ready.record(more.begin, more.end)
    fast = estimate(record)
    if {"stribeck", "soft"} & set(fast.law.rungs):
        bent = None  # the law says it
    if bent is not None:
        fast = replace(fast, coulomb=holding(fast.coulomb, bent))
    measured = shown(ready, more, record, periods=short.periods + more.periods)
    # the first record's relay had more periods to come to its limit cycle
    measured.relay, measured.shown = short.relay, (short.shown[0], measured.shown[1])
    measured.by[MethodName.MODULATING] = fast
    measured.reasons = of_modulating(fast, ready.units)
    if bent is not None:
        measured.reasons.append(of_bend(ready.units))
    measured.reasons.insert(
        0,
        Reason("periods.more", Weight.NOTE, f"{measured.periods} periods, because of {why}"),
    )
    measured.corrected, measured.second = short.corrected, short.second
    return _beside_the_balance(measured, short, more)


def _beside_the_balance(measured: Measured, short: Measured, more: Oscillations) -> Measured:
    """With the exact balance of what was held, and its number where that is better."""
    ready, record, fast, first = (
        measured.ready,
        measured.record,
        measured.modulating,
        short.modulating,
    )
    assert fast is not None
    assert first is not None
    try:
        exact, second = _balance(record, more, ready)
    except ValueError as error:
        measured.reasons.append(
            Reason(
                "balance.none",
                Weight.DOUBT,
                f"no exact balance to compare with: {words_of(error)}",
            )
        )
        return measured
    measured.by[MethodName.LOCK_IN] = exact
    is_better = balance_is_better(fast, exact)
    if is_better or not first.held_out < EXPLAINS:  # no law explains it: the balance needs none
        measured.second = second
        measured.corrected = _of_relay(short, short.record, exact)
    if is_better:
        exact = as_wide_as_its_harmonics(exact)
        measured.by[MethodName.LOCK_IN] = exact
        measured.preferred = MethodName.LOCK_IN
        measured.reasons = [
            measured.reasons[0],
            of_preference(fast, exact, ready.units),
            *of_lock_in(exact, record.resolution, ready.units),
        ]
        return measured
    measured.reasons.append(agreement(fast, exact, ready.units))
    return measured


def _why(found: ModulatingEstimate) -> str:
    """Which check of the short record fails."""
    if found.law.rungs:
        names = {
            "stribeck": "a Stribeck effect", "soft": "soft friction",
            "load": "friction that grows with the torque",
            "drag": "a torque that grows with the square of the speed",
            "drift": "friction that changes while it is measured",
            "position": "a position-dependent torque",
        }  # fmt: skip
        return " and ".join(names[rung] for rung in found.law.rungs)
    if found.halves > 0.02:
        return f"a difference of {100 * found.halves:.1f} % between odd and even periods"
    if found.widths > 0.05:
        return f"a difference of {100 * found.widths:.1f} % between wide and narrow windows"
    return f"{100 * found.rigid_residual:.1f} % of the torque unexplained by a rigid axis"


def _short(ready: Ready) -> Measured:
    """Relay at d1, oscillator at d2, nothing settled: modulating functions."""
    periods = 0
    for _ in range(_MOST_DESIGNS):
        stretch = Stretch(2, _HOLD_PERIODS, _HOLD_PERIODS)
        found = oscillate(ready, _RELAY_PERIODS, (stretch,))
        record = ready.record(found.begin, found.end)
        periods += found.periods
        fitted = estimate(record)
        again = ready.redesigned(fitted)
        if again is None:
            break
        ready = again
    measured = shown(ready, found, record, periods=periods)
    measured.by[MethodName.MODULATING] = fitted
    measured.reasons = of_modulating(fitted, ready.units)
    read_by_law(measured)
    return measured


# -- the exact balance ----------------------------------------------------------------------------


def _lock_in(ready: Ready) -> Measured:
    found = oscillate(
        ready,
        _RELAY_PERIODS,
        (Stretch(1, _PERIODS_SETTLED, _MOST_PERIODS), Stretch(2, _PERIODS_SETTLED, _MOST_PERIODS)),
    )
    record = ready.record(found.begin, found.end)
    measured = shown(ready, found, record, periods=found.periods)
    exact, measured.second = _balance(record, found, ready)
    measured.by[MethodName.LOCK_IN] = exact
    measured.corrected = _of_relay(measured, record, exact)
    measured.reasons = of_lock_in(exact, record.resolution, ready.units)
    for number, held in enumerate(found.held, 1):
        if not held.settled:
            measured.reasons.append(
                Reason(
                    "not-settled",
                    Weight.DOUBT,
                    f"oscillation {number} did not settle within {held.periods} periods",
                )
            )
    return measured


def _balance(record: Record, found: Oscillations, ready: Ready) -> tuple[LockIn, CriticalPoint]:
    """The balance of both oscillations, and the plant as the second one shows it."""
    kinematics = refined_kinematics(record)
    first, second = (_phasors(record, kinematics, held) for held in found.held)
    solved = lock_in(first, second, record.resolution, ready.context.cycle)
    return solved, by_balance(second, solved)


def _phasors(record: Record, kinematics: Kinematics, held: Held) -> Phasors:
    """Whole periods of one stretch, from between a reversal and a switching on."""
    count = round((held.end - held.begin) / held.period) - 1
    return phasors(
        record, kinematics, held.begin + _AFTER_SWITCHING * held.period, held.period, count
    )


# -- the plant's point ----------------------------------------------------------------------------


def _of_relay(measured: Measured, record: Record, found: LockIn) -> CriticalPoint:
    """The plant from the relay's limit cycle in `record`, by the exact balance's own friction."""
    read = phasors(record, refined_kinematics(record), *whole(measured.shown[0]))
    return by_balance(read, found)


def _phase_locked(ready: Ready) -> Measured:
    found = oscillate(
        ready,
        _RELAY_PERIODS,
        (Stretch(1, _PERIODS_SETTLED, _MOST_PERIODS), Stretch(2, _PERIODS_SETTLED, _MOST_PERIODS)),
        wave="sine",
    )
    record = ready.record(found.begin, found.end)
    measured = shown(ready, found, record, periods=found.periods)
    kinematics = refined_kinematics(record)
    first, second = (_phasors(record, kinematics, held) for held in found.held)
    measured.by[MethodName.PHASE_LOCKED] = phase_locked(first, second)
    return measured


# -- the thesis' methods --------------------------------------------------------------------------


def _thesis(switching: Switching, name: MethodName, ready: Ready) -> Measured:
    tests = ready.run(_two_relay(ready, switching))
    begin, end = tests.first_span[0], tests.second_span[1]
    measured = Measured(
        ready,
        tests.first,
        (
            Oscillation("relay test 1", tests.first, tests.first_span),
            Oscillation("relay test 2", tests.second, tests.second_span),
        ),
        ready.record(begin, end),
        tests.periods,
        tests.tests,
    )
    found = from_cycles(tests.first, tests.second, ready.context.cycle)
    measured.by[name] = found
    for number, cycle in enumerate((tests.first, tests.second), 1):
        if not cycle.settled:
            measured.reasons.append(
                Reason(
                    "not-settled",
                    Weight.DOUBT,
                    f"relay test {number} did not settle within {cycle.periods} periods",
                )
            )
    return measured


def _two_relay(ready: Ready, switching: Switching) -> Plan[TwoRelay]:
    solver: Solver = "thesis" if ready.options.solver == "thesis" else "bracket"
    yield from approach(ready.context, ready.context.start, ready.known)
    return (
        yield from two_relay(
            ready.context, ready.design, ready.known, solver=solver, switching=switching
        )
    )


def _all(ready: Ready) -> Measured:
    """Every method; the numbers from `auto`.

    A method of the thesis that fails is a reason, no end.
    """
    measured = _auto(ready)
    for method in METHODS:
        if method.read is None or method.name in measured.by:
            continue
        try:
            other = method.run(measured.ready)
        except (MeasurementRejected, ValueError) as error:
            why = str(error) if isinstance(error, MeasurementRejected) else words_of(error)
            measured.reasons.append(Reason("method.failed", Weight.NOTE, f"{method.name}: {why}"))
            continue
        measured.by |= other.by
        measured.periods += other.periods
        if other.lock_in is not None and measured.modulating is not None:
            measured.reasons += other.reasons
            measured.reasons.append(agreement(measured.modulating, other.lock_in, ready.units))
    return measured


# -- all of them ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Method:
    """One way from oscillations to friction.

    Attributes
    ----------
    pace : what it asks of the oscillations
    run : the experiments, and what they show
    read : what it found as its reading in a result; None: the methods that it runs have theirs
    """

    name: MethodName
    pace: PeriodNeeds
    run: Callable[[Ready], Measured]
    read: Callable[[Any], Any] | None = None


METHODS = (
    Method(MethodName.AUTO, SHORT, _auto),
    Method(MethodName.OUTPUT_ERROR, SHORT, precise, output_error_reading),
    Method(MethodName.MODULATING, SHORT, _short, modulating_reading),
    Method(MethodName.LOCK_IN, SHORT, _lock_in, balance_reading),
    Method(
        MethodName.TWO_RELAY, LONG,
        partial(_thesis, "hysteresis", MethodName.TWO_RELAY), two_relay_reading,
    ),
    Method(
        MethodName.TWO_RELAY_DELAY, LONG,
        partial(_thesis, "delay", MethodName.TWO_RELAY_DELAY), two_relay_reading,
    ),
    Method(MethodName.PHASE_LOCKED, LONG, _phase_locked, balance_reading),
    Method(MethodName.ALL, LONG, _all),
)  # fmt: skip


def method_of(name: str) -> Method:
    """The method of that name; raises UnknownName."""
    for method in METHODS:
        if method.name == name:
            return method
    raise UnknownName("method", name, [str(method.name) for method in METHODS])
