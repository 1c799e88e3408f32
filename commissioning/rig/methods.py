"""The methods: which oscillations each one runs, and what is read from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from commissioning.errors import MeasurementRejected
from commissioning.experiments.approach import approach
from commissioning.experiments.design import RelayDesign
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.oscillations import Oscillations, Stretch, oscillations
from commissioning.experiments.oscillator import Held, Wave
from commissioning.experiments.plan import Context, Plan
from commissioning.experiments.relay import Switching
from commissioning.experiments.stopping import Stopping
from commissioning.experiments.two_relay import Solver, TwoRelay, two_relay
from commissioning.identification.critical_point import CriticalPoint
from commissioning.identification.estimate import Estimate
from commissioning.identification.limit_cycle import LimitCycle
from commissioning.identification.lock_in import LockIn, Phasors, lock_in, phasors
from commissioning.identification.modulating import (
    EXPLAINS,
    ModulatingEstimate,
    estimate,
    refined_kinematics,
)
from commissioning.identification.phase_locked import PhaseLocked, phase_locked
from commissioning.identification.reading import Reader, by_balance
from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import Kinematics, Record
from commissioning.identification.two_relay import FrictionEstimate, from_cycles
from commissioning.identification.verdict import (
    Units,
    agreement,
    of_lock_in,
    of_modulating,
    within_short,
)

__all__ = ["METHODS", "PACE_IS_LONG", "Measured", "Oscillation", "Rig", "Wished", "measure"]

T = TypeVar("T")

METHODS = (
    "auto", "modulating", "lock-in", "two-relay", "two-relay-delay", "phase-locked", "all",
)  # fmt: skip
# the thesis' methods take the relay's wave for a sine: its period must be long
PACE_IS_LONG = frozenset({"two-relay", "two-relay-delay", "phase-locked", "all"})

_RELAY, _SHORT = 5, 7  # periods of the relay and of the oscillator that usually are enough
_AGAIN, _HELD = 2, 8  # of the relay and of each oscillation when they are not: 30 in all
_SETTLED, _MOST = 10, 20  # periods of each oscillation of lock-in: settled, and at most
_DESIGNS = 3  # how often the oscillations are chosen anew, where the first look was far off
_AWAY = 3 / 8  # of a period after a switching: well after the reversal, before the next switching


class Rig(Protocol):
    """The axis, ready to be moved, and what is known of it."""

    context: Context
    known: FirstLook
    plan: RelayDesign
    units: Units
    solver: Solver
    stopping: Stopping

    def run(self, plan: Plan[T]) -> T:
        """Drive a plan to its end."""

    def record(self, begin: float, end: float) -> Record:
        """What was recorded between two instants, s."""

    def redesign(self, found: ModulatingEstimate) -> bool:
        """Choose the oscillations anew from what a first record tells; False: they were right."""

    def attempt(self, plan: Plan[T]) -> T:
        """The same for what need not be; raises MeasurementRejected where a limit ends it."""

    def heat(self, torque: float, seconds: float) -> float:
        """Share of the i²t budget in use after ± a torque (N.m or N) about the bias for some seconds."""

    @property
    def time_left(self) -> float:
        """Of the duration that is allowed, s."""


@dataclass(frozen=True, slots=True)
class Oscillation:
    """One oscillation for the report.

    Attributes
    ----------
    name : for people
    cycle : its limit cycle; a hysteresis of nan where no relay made it
    span : begin and end, s
    """

    name: str
    cycle: LimitCycle
    span: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Wished:
    """A point at a phase that is wanted.

    Attributes
    ----------
    point : None where the axis has none, or where it is not known
    travel : that measuring it takes, on either side of the start, rad or m; None: not known
    why_not : why it was not measured, or is not there; '' where it was
    """

    point: CriticalPoint | None
    travel: float | None
    why_not: str


@dataclass
class Measured:
    """What was found, and by what; a method that was not run is None.

    `relay`: limit cycle of the relay at d1. `shown`: one oscillation at d1 and one at d2.
    `record`: what the chosen method read. `corrected`, `second`: the plant read from the phasors of the
    relay's limit cycle, and of an oscillation of another amplitude at the same frequency; `points`: at the
    phases that tuning rules ask for.
    """

    relay: LimitCycle
    shown: tuple[Oscillation, Oscillation]
    record: Record
    periods: int
    tests: int = 1
    two_relay: FrictionEstimate | None = None
    two_relay_delay: FrictionEstimate | None = None
    phase_locked: PhaseLocked | None = None
    lock_in: LockIn | None = None
    modulating: ModulatingEstimate | None = None
    corrected: CriticalPoint | None = None
    second: CriticalPoint | None = None
    points: dict[str, Wished] = field(default_factory=dict)
    reasons: list[Reason] = field(default_factory=list)

    @property
    def method(self) -> str:
        """The method that gives the numbers: the finest that was run."""
        for name in ("modulating", "lock_in", "two_relay", "two_relay_delay", "phase_locked"):
            if getattr(self, name) is not None:
                return name.replace("_", "-")
        raise AssertionError("a measurement without a method")

    @property
    def found(self) -> Any:
        """Result of that method."""
        return getattr(self, self.method.replace("-", "_"))

    def estimate(self, name: str) -> Estimate | None:
        """A quantity of the chosen method, None where the record does not show it."""
        found: Estimate | None = getattr(self.found, name, None)
        if found is None or name in ("coulomb", "offset"):
            return found
        cycle = float(np.median(np.diff(self.record.time)))
        half = (found.high - found.low) / 2
        allowed = {
            "viscous": 0.6 * max(found.value, 0.0),
            "inertia": 0.3 * max(found.value, 0.0),
            "dead_time": max(0.6 * found.value, 0.3 * cycle),
        }[name]
        return found if half <= allowed else None


def measure(method: str, rig: Rig) -> Measured:
    """Run `method` once; raises MeasurementRejected."""
    try:
        if method == "auto":
            return _auto(rig)
        if method == "modulating":
            return _short(rig)
        if method == "lock-in":
            return _lock_in(rig)
        if method == "phase-locked":
            return _phase_locked(rig)
        if method == "all":
            return _all(rig)
        return _thesis(rig, "delay" if method == "two-relay-delay" else "hysteresis")
    except (ValueError, ArithmeticError) as error:  # identification knows records, not axes
        raise MeasurementRejected(f"{method}: {error}") from None


# -- a dozen periods, and thirty ------------------------------------------------------------------


def _auto(rig: Rig) -> Measured:
    """A dozen periods where they are enough, else thirty and the exact balance (method.md 3a)."""
    short = _short(rig)
    first = short.modulating
    assert first is not None
    if within_short(first):
        return short
    rig.context.tell(f"a dozen periods are not enough: {_why(first)}; the oscillations are held")
    more = _oscillate(
        rig, _AGAIN, (Stretch(1, _HELD, _HELD), Stretch(2, _HELD, _HELD)),
        knob=_knob(short), period=short.shown[1].cycle.period,
    )  # fmt: skip
    record = rig.record(more.begin, more.end)
    fast = estimate(record)
    measured = _shown(more, record, periods=short.periods + more.periods)
    # the first record's relay had more periods to come to its limit cycle
    measured.relay, measured.shown = short.relay, (short.shown[0], measured.shown[1])
    measured.modulating = fast
    measured.reasons = of_modulating(fast, rig.units)
    measured.reasons.insert(
        0,
        Reason(
            "periods.more", Weight.NOTE, f"{measured.periods} periods, because of {_why(first)}"
        ),
    )
    measured.corrected, measured.second = short.corrected, short.second
    try:
        measured.lock_in, second = _balance(record, more, rig)
    except ValueError as error:
        measured.reasons.append(
            Reason("balance.none", Weight.DOUBT, f"no exact balance to compare with: {error}")
        )
        return measured
    if not first.held_out < EXPLAINS:  # no law explains the record: the balance needs none
        measured.second = second
        measured.corrected = _of_relay(short, short.record, measured.lock_in)
    measured.reasons.append(agreement(fast, measured.lock_in, rig.units))
    return measured


def _why(found: ModulatingEstimate) -> str:
    """Which check of the short record fails."""
    if found.law.rungs:
        names = {
            "stribeck": "a Stribeck effect", "soft": "soft friction",
            "load": "friction that grows with the torque", "position": "a position-dependent torque",
        }  # fmt: skip
        return " and ".join(names[rung] for rung in found.law.rungs)
    if found.halves > 0.02:
        return f"a difference of {100 * found.halves:.1f} % between odd and even periods"
    if found.widths > 0.05:
        return f"a difference of {100 * found.widths:.1f} % between wide and narrow windows"
    return f"{100 * found.rigid_residual:.1f} % of the torque unexplained by a rigid axis"


def _short(rig: Rig) -> Measured:
    """Relay at d1, oscillator at d2, nothing settled: modulating functions."""
    periods = 0
    for _ in range(_DESIGNS):
        found = _oscillate(rig, _RELAY, (Stretch(2, _SHORT, _SHORT),))
        record = rig.record(found.begin, found.end)
        periods += found.periods
        fitted = estimate(record)
        if not rig.redesign(fitted):
            break
    measured = _shown(found, record, periods=periods)
    measured.modulating = fitted
    measured.reasons = of_modulating(fitted, rig.units)
    if fitted.held_out < EXPLAINS:
        _read_by_law(measured, fitted)
    return measured


def _knob(measured: Measured) -> float:
    return measured.relay.hysteresis


# -- the exact balance ----------------------------------------------------------------------------


def _lock_in(rig: Rig) -> Measured:
    found = _oscillate(rig, _RELAY, (Stretch(1, _SETTLED, _MOST), Stretch(2, _SETTLED, _MOST)))
    record = rig.record(found.begin, found.end)
    measured = _shown(found, record, periods=found.periods)
    measured.lock_in, measured.second = _balance(record, found, rig)
    measured.corrected = _of_relay(measured, record, measured.lock_in)
    measured.reasons = of_lock_in(measured.lock_in, record.resolution, rig.units)
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


def _balance(record: Record, found: Oscillations, rig: Rig) -> tuple[LockIn, CriticalPoint]:
    """The balance of both oscillations, and the plant as the second one shows it."""
    kinematics = refined_kinematics(record)
    first, second = (_phasors(record, kinematics, held) for held in found.held)
    solved = lock_in(first, second, record.resolution, rig.context.cycle)
    return solved, by_balance(second, solved)


def _phasors(record: Record, kinematics: Kinematics, held: Held) -> Phasors:
    """Whole periods of one stretch, from between a reversal and a switching on."""
    count = round((held.end - held.begin) / held.period) - 1
    return phasors(record, kinematics, held.begin + _AWAY * held.period, held.period, count)


# -- the plant's point ----------------------------------------------------------------------------


def _read_by_law(measured: Measured, found: ModulatingEstimate) -> None:
    """Relay and oscillator by the law that explains their record."""
    first, second = measured.shown
    reader = Reader(measured.record, found, first.cycle.period)
    measured.corrected = reader.point(*_whole(first))
    measured.second = reader.point(*_whole(second))


def _of_relay(measured: Measured, record: Record, found: LockIn) -> CriticalPoint:
    """The plant from the relay's limit cycle in `record`, by the exact balance's own friction."""
    read = phasors(record, refined_kinematics(record), *_whole(measured.shown[0]))
    return by_balance(read, found)


def _whole(shown: Oscillation) -> tuple[float, float, int]:
    """Begin, period and number of the whole periods of an oscillation."""
    begin, end = shown.span
    period = shown.cycle.period
    return begin, period, max(round((end - begin) / period - 0.2), 1)


def _phase_locked(rig: Rig) -> Measured:
    found = _oscillate(
        rig, _RELAY, (Stretch(1, _SETTLED, _MOST), Stretch(2, _SETTLED, _MOST)), wave="sine"
    )
    record = rig.record(found.begin, found.end)
    measured = _shown(found, record, periods=found.periods)
    kinematics = refined_kinematics(record)
    first, second = (_phasors(record, kinematics, held) for held in found.held)
    measured.phase_locked = phase_locked(first, second)
    return measured


# -- the thesis' methods --------------------------------------------------------------------------


def _thesis(rig: Rig, switching: Switching) -> Measured:
    tests = rig.run(_two_relay(rig, switching))
    begin, end = tests.first_span[0], tests.second_span[1]
    measured = Measured(
        tests.first,
        (
            Oscillation("relay test 1", tests.first, tests.first_span),
            Oscillation("relay test 2", tests.second, tests.second_span),
        ),
        rig.record(begin, end),
        tests.periods,
        tests.tests,
    )
    found = from_cycles(tests.first, tests.second, rig.context.cycle)
    setattr(measured, "two_relay_delay" if switching == "delay" else "two_relay", found)
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


def _two_relay(rig: Rig, switching: Switching) -> Plan[TwoRelay]:
    yield from approach(rig.context, rig.context.start, rig.known)
    return (
        yield from two_relay(
            rig.context, rig.plan, rig.known, solver=rig.solver, switching=switching
        )
    )


def _all(rig: Rig) -> Measured:
    """Every method; the numbers from `auto`. A method of the thesis that fails is a reason, no end."""
    measured = _auto(rig)
    others: list[tuple[str, Callable[[], Measured]]] = [
        ("two_relay", lambda: _thesis(rig, "hysteresis")),
        ("two_relay_delay", lambda: _thesis(rig, "delay")),
        ("phase_locked", lambda: _phase_locked(rig)),
    ]
    if measured.lock_in is None:
        others.insert(0, ("lock_in", lambda: _lock_in(rig)))
    for name, run in others:
        try:
            other = run()
        except (MeasurementRejected, ValueError) as error:
            measured.reasons.append(
                Reason("method.failed", Weight.NOTE, f"{name.replace('_', '-')}: {error}")
            )
            continue
        setattr(measured, name, getattr(other, name))
        measured.periods += other.periods
        if other.lock_in is not None and measured.modulating is not None:
            measured.reasons += other.reasons
            measured.reasons.append(agreement(measured.modulating, other.lock_in, rig.units))
    return measured


# -- helpers --------------------------------------------------------------------------------------


def _oscillate(
    rig: Rig,
    relay_periods: int,
    stretches: tuple[Stretch, ...],
    *,
    wave: Wave = "square",
    knob: float | None = None,
    period: float | None = None,
) -> Oscillations:
    def plan() -> Plan[Oscillations]:
        yield from approach(rig.context, rig.context.start, rig.known)
        return (
            yield from oscillations(
                rig.context, rig.plan, rig.known, relay_periods, stretches,
                wave=wave, knob=knob, period=period,
            )
        )  # fmt: skip

    return rig.run(plan())


def _shown(found: Oscillations, record: Record, *, periods: int) -> Measured:
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
        found.relay,
        (
            Oscillation("relay", found.relay, found.relay_span),
            Oscillation("oscillator", second, (last.begin, last.end)),
        ),
        record,
        periods,
    )
