"""What was measured, as parts of a result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from commissioning.errors import MeasurementRejected
from commissioning.identification.critical_point import CriticalPoint, hysteresis_only, naive
from commissioning.identification.estimate import Estimate
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.output_error import OutputErrorEstimate
from commissioning.identification.reasons import Reason, Weight, verdict, weightiest_first
from commissioning.identification.repeats import Repeats, mean_of
from commissioning.identification.steady import SteadyFit
from commissioning.result.document import Quality, RunResult
from commissioning.result.experiment import Allowed, Experiment, Oscillated
from commissioning.result.found import (
    QUANTITIES,
    CriticalPoints,
    Curve,
    Found,
    Point,
    Quantity,
    Units,
)
from commissioning.runner import Recorder

if TYPE_CHECKING:
    from commissioning.rig.measured import Measured, Oscillation, Wished

__all__ = [
    "Rejected",
    "critical_points",
    "curve_of",
    "cycles",
    "experiment",
    "found_of",
    "judged",
    "quantity",
    "repeated_of",
]

_SPEEDS = 40  # points of a friction curve
_SLOWEST = 0.002  # of its fastest speed
Raw = Callable[[str, float], tuple[float | None, str | None]]  # name, SI → as the drive counts


class Rejected(MeasurementRejected):
    """Numbers that cannot be trusted, with the result as far as it got."""

    def __init__(self, message: str, result: RunResult) -> None:
        super().__init__(message)
        self.result = result


def judged(result: RunResult, reasons: Sequence[Reason]) -> RunResult:
    """`result` with its verdict, the weightiest reason first.

    Raises Rejected, without any friction.
    """
    ordered = weightiest_first(reasons)
    result = replace(result, quality=Quality(verdict(ordered), tuple(ordered)))
    if result.quality.verdict == "rejected":
        worst = [r.text for r in ordered if r.weight is Weight.CONTRADICTION]
        raise Rejected("; ".join(worst), replace(result, friction=Found(), critical_point=None))
    return result


# -- numbers --------------------------------------------------------------------------------------


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
            mean = mean_of(known)
            numbers[name] = quantity(mean, units.of_quantity(name), raw(name, mean.value))
    # a law that does not explain the record says nothing of the curve
    told = [one.positions or one.modulating for one in repeats if one.preferred is None]
    fits = [one for one in told if one is not None]
    curve = low_speed = None
    if len(fits) == len(repeats):
        curve = curve_of(fits, fits[-1].peak_speed)
        value = float(np.mean([fit.low_speed for fit in fits]))
        low_speed = Quantity(value, None, None, units.effort, *raw("coulomb", value))
    lags = [one.positions.lag for one in repeats if one.positions is not None]
    lag = quantity(mean_of(lags), units.dead_time) if len(lags) == len(repeats) else None
    return Found(repeats[-1].method, **numbers, lag=lag, low_speed=low_speed, curve=curve)


def repeated_of(repeats: Sequence[Measured], began: float) -> Repeats:
    """Coulomb friction of each repeat, its spread and drift; `began`: of the run, s."""
    times = [float(one.record.time.mean()) - began for one in repeats]
    return Repeats.of([one.found.coulomb for one in repeats], times)


def curve_of(
    fits: Sequence[ModulatingEstimate | OutputErrorEstimate | SteadyFit], fastest: float
) -> Curve:
    """Friction against speed up to `fastest`, by the law that was found; the mean of several."""
    speed = np.geomspace(_SLOWEST, 1, _SPEEDS) * fastest
    level = np.mean([fit.curve(speed) for fit in fits], axis=0)
    return Curve(tuple(speed.tolist()), tuple(level.tolist()))


# -- the plant ------------------------------------------------------------------------------------


def critical_points(measured: Measured, right: CriticalPoint | None) -> CriticalPoints:
    """The readings at the relay's own frequency (`right`.

    The corrected one), and the points wanted.
    """
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
    gain = None if gain is None else float(gain)
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
        None,
        *_ku_interval(point),
    )


def _ku_interval(point: CriticalPoint) -> tuple[float | None, float | None]:
    """Of Ku, where the gain's interval leaves one."""
    if point.ku is None or point.gain_error is None or not point.gain_error < 1:
        return None, None
    return point.ku / (1 + point.gain_error), point.ku / (1 - point.gain_error)


# -- the experiment -------------------------------------------------------------------------------


def cycles(shown: Sequence[Oscillation], begin: float) -> tuple[Oscillated, ...]:
    """The oscillations that the report shows; `begin`: of the record, s."""
    names = (
        "relay_amplitude", "hysteresis", "bias", "half_swing", "fundamental", "duty", "periods",
        "settled",
    )  # fmt: skip
    return tuple(
        Oscillated(
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


def experiment(recorder: Recorder, cycle: float, periods: int, limits: Allowed) -> Experiment:
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
