"""What was measured, as parts of a result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from commissioning.errors import MeasurementRejected
from commissioning.identification.critical_point import CriticalPoint, hysteresis_only, naive
from commissioning.identification.estimate import Estimate
from commissioning.identification.lock_in import LockIn
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.phase_locked import PhaseLocked
from commissioning.identification.reasons import Reason, Weight, verdict, weightiest_first
from commissioning.identification.steady import SteadyFit, SteadyPoint
from commissioning.identification.two_relay import FrictionEstimate
from commissioning.result.document import Quality, RunResult
from commissioning.result.experiment import Cycle, Experiment, Limits
from commissioning.result.found import (
    QUANTITIES,
    CriticalPoints,
    Curve,
    Found,
    Point,
    Quantity,
    Units,
)
from commissioning.result.readings import (
    BalanceReading,
    Law,
    Methods,
    ModulatingReading,
    Speed,
    SteadyReading,
    TwoRelayReading,
)
from commissioning.runner import Recorder

if TYPE_CHECKING:
    from commissioning.rig.methods import Measured, Oscillation, Wished

__all__ = [
    "Rejected",
    "balance_reading",
    "critical_points",
    "curve_of",
    "cycles",
    "experiment",
    "found_of",
    "judged",
    "methods_of",
    "modulating_reading",
    "quantity",
    "steady_reading",
]

_CHECKS = (  # of modulating functions, in the order of their reading
    "residual", "held_out", "rigid_residual", "condition", "halves", "widths", "noise", "periods",
    "windows", "reversals", "low_speed", "peak_speed",
)  # fmt: skip
_SPEEDS = 40  # points of a friction curve
_SLOWEST = 0.002  # of its fastest speed
Raw = Callable[[str, float], tuple[float | None, str | None]]  # name, SI → as the drive counts


class Rejected(MeasurementRejected):
    """Numbers that cannot be trusted, with the result as far as it got."""

    def __init__(self, message: str, result: RunResult) -> None:
        super().__init__(message)
        self.result = result


def judged(result: RunResult, reasons: Sequence[Reason]) -> RunResult:
    """`result` with its verdict, the weightiest reason first; raises Rejected, without any friction."""
    ordered = weightiest_first(reasons)
    result = replace(result, quality=Quality(verdict(ordered), tuple(ordered)))
    if result.quality.verdict == "rejected":
        worst = [r.text for r in ordered if r.weight is Weight.CONTRADICTION]
        raise Rejected("; ".join(worst), replace(result, friction=Found(), critical_point=None))
    return result


# -- numbers ----------------------------------------------------------------------------------------


def quantity(
    estimate: Estimate, unit: str, raw: tuple[float | None, str | None] = (None, None)
) -> Quantity:
    """One number with its interval; `raw`: as the drive counts, and what it counts in."""
    return Quantity(estimate.value, estimate.low, estimate.high, unit, *raw)


def found_of(repeats: Sequence[Measured], units: Units, raw: Raw) -> Found:
    """The numbers of a measurement: of repeats the mean, and what they scatter by."""
    numbers = {}
    for name in QUANTITIES:
        estimates = [one.estimate(name) for one in repeats]
        known = [estimate for estimate in estimates if estimate is not None]
        if len(known) == len(repeats):
            mean = _mean(known)
            numbers[name] = quantity(mean, units.of_quantity(name), raw(name, mean.value))
    fits = [one.modulating for one in repeats if one.modulating is not None]
    curve = low_speed = None
    if len(fits) == len(repeats):
        curve = curve_of(fits, fits[-1].peak_speed)
        value = float(np.mean([fit.low_speed for fit in fits]))
        low_speed = Quantity(value, None, None, units.effort, *raw("coulomb", value))
    return Found(repeats[-1].method, **numbers, low_speed=low_speed, curve=curve)


def _mean(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of repeats; its interval holds theirs and the scatter."""
    if len(estimates) == 1:
        return estimates[0]
    from scipy.stats import t

    values = [one.value for one in estimates]
    half = float(t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / len(values) ** 0.5)
    mean = float(np.mean(values))
    low, high = min(one.low for one in estimates), max(one.high for one in estimates)
    return Estimate(mean, min(low, mean - half), max(high, mean + half))


def curve_of(fits: Sequence[ModulatingEstimate | SteadyFit], fastest: float) -> Curve:
    """Friction against speed up to `fastest`, by the law that was found; the mean of several."""
    speed = np.geomspace(_SLOWEST, 1, _SPEEDS) * fastest
    level = np.mean([fit.curve(speed) for fit in fits], axis=0)
    return Curve(tuple(speed.tolist()), tuple(level.tolist()))


# -- methods ----------------------------------------------------------------------------------------


def methods_of(measured: Measured) -> Methods:
    """Every method that was run."""
    hysteresis, delay = measured.two_relay, measured.two_relay_delay
    locked, exact, fast = measured.phase_locked, measured.lock_in, measured.modulating
    return Methods(
        None if hysteresis is None else _two_relay_reading(hysteresis),
        None if delay is None else _two_relay_reading(delay),
        phase_locked=None if locked is None else balance_reading(locked),
        lock_in=None if exact is None else balance_reading(exact),
        modulating=None if fast is None else modulating_reading(fast),
    )


def _two_relay_reading(found: FrictionEstimate) -> TwoRelayReading:
    a, b = found.first, found.second
    return TwoRelayReading(
        found.coulomb.value,
        found.complex_coulomb.real,
        found.complex_coulomb.imag,
        abs(found.complex_coulomb),
        half_swing=(a.half_swing, b.half_swing),
        fundamental=(a.fundamental, b.fundamental),
        period=(a.period, b.period),
        periods=(a.periods, b.periods),
        relay_amplitude=(a.relay_amplitude, b.relay_amplitude),
        hysteresis=(a.hysteresis, b.hysteresis),
        bias=(a.bias, b.bias),
        duty=(a.duty, b.duty),
        settled=(a.settled, b.settled),
    )


def balance_reading(found: LockIn | PhaseLocked) -> BalanceReading:
    """A balance on measured phasors."""
    reading = BalanceReading(
        found.coulomb.value,
        found.complex_coulomb.real,
        found.complex_coulomb.imag,
        abs(found.complex_coulomb),
        half_swing=tuple(found.half_swing),
        fundamental=tuple(found.fundamental),
        period=found.period,
        periods=tuple(found.periods),
        **{name: getattr(found, name).value for name in QUANTITIES[1:] if hasattr(found, name)},
    )
    if isinstance(found, PhaseLocked):
        return replace(reading, phase_deg=tuple(found.phase_deg))
    return replace(
        reading,
        harmonics=dict(zip(("1", "3", "5"), found.harmonics, strict=True)),
        rejected=tuple(found.rejected),
        plant=(found.plant.real, found.plant.imag),
    )


def modulating_reading(found: ModulatingEstimate) -> ModulatingReading:
    """Modulating functions: numbers, law, and what says how far to trust them."""
    law = found.law
    return ModulatingReading(
        found.coulomb.value, found.offset.value, found.viscous.value, found.inertia.value,
        found.dead_time.value,
        Law(
            ("coulomb", "viscous", *law.rungs), law.stribeck, law.soft, law.position,
            tuple(found.coefficients.tolist()),
        ),
        *(_finite(getattr(found, name)) for name in _CHECKS),
    )  # fmt: skip


def steady_reading(found: SteadyFit, points: Sequence[SteadyPoint]) -> SteadyReading:
    """Friction from constant speeds."""
    return SteadyReading(
        found.coulomb.value,
        found.offset.value,
        found.viscous.value,
        found.stribeck_level,
        found.stribeck_speed,
        _finite(found.rms),
        _finite(found.held_out),
        tuple(Speed(p.speed, p.torque, p.error) for p in points),
    )


def _finite(value: float | None) -> float | None:
    """Not known is None."""
    return float(value) if value is not None and isfinite(value) else None


# -- the plant --------------------------------------------------------------------------------------


def critical_points(measured: Measured, right: CriticalPoint | None) -> CriticalPoints:
    """The readings at the relay's own frequency (`right`: the corrected one), and the points wanted."""
    return CriticalPoints(
        _point(naive(measured.relay)),
        _point(hysteresis_only(measured.relay)),
        _point(right),
        _point(measured.second),
        **{key: _wished(wished) for key, wished in measured.points.items()},
    )


def _wished(wished: Wished) -> Point | None:
    found = _point(wished.point)
    return found and replace(found, travel_needed=wished.travel)


def _point(point: CriticalPoint | None) -> Point | None:
    if point is None:
        return None
    gain, phase = point.gain_error, point.phase_error
    return Point(
        point.gain,
        point.phase_deg,
        point.period,
        point.ku,
        "measured" if point.measured else "computed",
        None if gain is None else point.gain * max(1 - gain, 0.0),
        None if gain is None else point.gain * (1 + gain),
        None if phase is None else point.phase_deg - phase,
        None if phase is None else point.phase_deg + phase,
    )


# -- the experiment ---------------------------------------------------------------------------------


def cycles(shown: Sequence[Oscillation], begin: float) -> tuple[Cycle, ...]:
    """The oscillations that the report shows; `begin`: of the record, s."""
    names = (
        "relay_amplitude", "hysteresis", "bias", "half_swing", "fundamental", "duty", "periods",
        "settled",
    )  # fmt: skip
    return tuple(
        Cycle(
            one.name,
            one.cycle.period,
            one.span[0] - begin,
            one.span[1] - begin,
            **{
                name: None if (value := getattr(one.cycle, name)) != value else value
                for name in names
            },
        )
        for one in shown
    )


def experiment(recorder: Recorder, cycle: float, periods: int, limits: Limits) -> Experiment:
    """How long and how regularly the axis was watched, by what was recorded."""
    samples = recorder.samples
    if not samples:
        return Experiment(0, 0.0, cycle, 0.0, 0.0, 0.0, limits)
    positions = [s.position for s in samples]
    late = sum(s.lateness > 0.5 * cycle for s in samples)
    lost = sum(s.missed for s in samples)
    return Experiment(
        periods,
        samples[-1].time - samples[0].sent,
        cycle,
        late / len(samples),
        lost / (len(samples) + lost),
        max(positions) - min(positions),
        limits,
    )
