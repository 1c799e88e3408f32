"""The plant at −180° and at −135°: measured where the axis allows it, else computed from the model.

The model says at which period the phase is wanted; an oscillation is held there and read with
phasors, and where the phase that it shows is another one, the period is corrected and the
oscillation repeated.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians, sin

from commissioning.errors import MeasurementRejected
from commissioning.experiments.at_period import Wanted, oscillate_at
from commissioning.experiments.design import travel_needed
from commissioning.identification.critical_point import CriticalPoint, Lag, at_its_phase, at_phase
from commissioning.identification.errors import NotShown, words_of
from commissioning.identification.estimate import Estimate
from commissioning.identification.lock_in import phasors
from commissioning.identification.reading import Reader, by_balance
from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import kinematics
from commissioning.rig.measured import Measured, Wished

__all__ = ["TARGETS", "computed", "points"]

TARGETS = {"at_180": -180.0, "at_135": -135.0}

_FEWEST_CYCLES = 10  # a period
_LONGEST = 4.0  # s
_SPEED_SHARE = 0.8  # of the speed limit, at the peak
_FEWEST_COUNTS = 60  # encoder counts of half-swing
_HEAT_SHARE = 0.5  # of the i²t budget
_MOST_PERIODS = 20  # that an oscillation takes at most, with its start
_TIME_TO_START = 5.0  # s, to go where it begins
_NEAR_ENOUGH, _WORTH_A_WORD = 0.4, 1.0  # degrees from the phase that is wanted
_TRIES = 3


def computed(model: dict[str, Estimate | None], phase: float, lag: Lag) -> Wished:
    """The point of the identified rigid axis."""
    names = {"inertia": "inertia", "viscous": "viscous friction", "dead_time": "dead time"}
    unknown = [text for name, text in names.items() if model.get(name) is None]
    if unknown:
        return Wished(None, None, f"{', '.join(unknown)} not known")
    inertia, viscous, dead_time = (model[name] for name in names)
    assert inertia is not None
    assert viscous is not None
    assert dead_time is not None
    if viscous.low <= 0:
        return Wished(
            None, None, "viscous friction is zero within its interval: the plant stays below"
        )
    if phase <= -180 and dead_time.low <= 0:
        return Wished(
            None,
            None,
            "the dead time is zero within its interval: a rigid axis without one stays above",
        )
    point = at_phase(inertia, viscous, dead_time, phase, lag)
    return Wished(point, None, "not asked for")


def points(measured: Measured, *, move: bool) -> None:
    """Put both points into `measured`; with `move` measure them.

    Says what is not there or not measured.
    """
    model = {name: measured.estimate(name) for name in ("inertia", "viscous", "dead_time")}
    lag = measured.lag
    measured.corrected = _at_its_phase(measured.corrected, model, lag)
    measured.second = _at_its_phase(measured.second, model, lag)
    for key, phase in TARGETS.items():
        wished = computed(model, phase, lag)
        if wished.point is not None and move:
            wished = _measured(wished.point, phase, measured, model)
            if wished.point is not None and wished.point.measured:
                wished = replace(wished, point=_at_its_phase(wished.point, model, lag))
        elif wished.point is not None:
            _, travel, why_not = _wanted(wished.point, measured)
            wished = Wished(wished.point, travel, why_not or "not asked for")
        measured.points[key] = wished
        if wished.why_not and (move or (wished.point is None and model.get("inertia") is not None)):
            how = "computed from the model" if wished.point else "not known"
            measured.reasons.append(
                Reason(
                    "point.not-measured",
                    Weight.NOTE,
                    f"the plant at {phase:g}° is {how}: {wished.why_not}",
                )
            )


def _at_its_phase(
    point: CriticalPoint | None, model: dict[str, Estimate | None], lag: Lag
) -> CriticalPoint | None:
    """A point at an oscillation's frequency, where it gives Ku with what its phase makes of it."""
    axis = [model[name] for name in ("inertia", "viscous", "dead_time")]
    known = [estimate.value for estimate in axis if estimate is not None]
    if point is None or point.ku is None or len(known) < len(axis):
        return point
    inertia, viscous, dead_time = known
    return at_its_phase(point, inertia, viscous, dead_time, lag)


def _measured(
    guess: CriticalPoint,
    phase: float,
    measured: Measured,
    model: dict[str, Estimate | None],
) -> Wished:
    """Oscillate at the guess' period, and again where the phase is not the wanted one."""
    point, travel, context = guess, None, measured.ready.context
    found: CriticalPoint | None = None
    for _ in range(_TRIES):
        wanted, travel, why_not = _wanted(point, measured)
        if wanted is None:
            break
        context.tell(
            f"the plant at {phase:g}°: oscillation of ±{wanted.amplitude:.4g} "
            f"{context.effort_unit} at {wanted.period * 1000:.4g} ms"
        )
        try:
            read, settled = _read(wanted, measured)
        except MeasurementRejected as error:
            why_not = str(error)
            break
        except ValueError as error:
            why_not = words_of(error)
            break
        if found is None or abs(read.phase_deg - phase) < abs(found.phase_deg - phase):
            found = read
            unsettled = not settled
        if abs(read.phase_deg - phase) <= _NEAR_ENOUGH:
            break
        # the model's own phase at this period is off by as much
        expected = point.phase_deg + phase - read.phase_deg
        again = computed(model, expected, measured.lag).point
        if again is None or not -270 < expected < -90:
            break
        point = again
    if found is None:
        return Wished(guess, travel, why_not)
    off = found.phase_deg - phase
    for applies, text in (
        (unsettled, f"the oscillation at {phase:g}° did not settle"),
        (
            abs(off) > _WORTH_A_WORD,
            f"the point that was measured for {phase:g}° lies {off:+.1f}° from it",
        ),
    ):
        if applies:
            measured.reasons.append(Reason("point.off", Weight.DOUBT, text))
    return Wished(found, travel, "")


def _wanted(point: CriticalPoint, measured: Measured) -> tuple[Wanted | None, float | None, str]:
    """The oscillation, the travel that it takes, and why it cannot be had."""
    ready, period = measured.ready, point.period
    context, design = ready.context, ready.design
    p = context.position_unit
    f = min(measured.found.coulomb.value, 0.9 * design.d1)
    switching = f / design.d1 + max(sin(radians(180 + point.phase_deg)), 0.0)
    bias = measured.relay.bias
    most = min(design.most, context.torque - abs(bias) - context.torque_resolution)
    needs: list[tuple[float, Wanted, float]] = []
    for d in (min(design.d2, most), min(design.d1, most)):
        half_swing = point.gain * 4 / pi * (d * d - f * f) / d
        peak = 8 * half_swing / period
        travel = travel_needed(ready.stopping, half_swing, min(switching, 1.0), peak, most)
        wanted = Wanted(period, d, half_swing, point.gain, bias, most)
        needs.append((travel, wanted, peak))
    travel = needs[-1][0]
    if period < _FEWEST_CYCLES * context.cycle:
        return None, travel, (
            f"its period of {period * 1000:.3g} ms is beyond a cycle of {context.cycle * 1000:g} "
            f"ms ({_FEWEST_CYCLES} cycles a period are needed)"
        )  # fmt: skip
    if period > _LONGEST:
        return None, travel, (
            f"its period of {period:.3g} s is too long, and would take ±{travel:.3g} {p} of travel"
        )  # fmt: skip
    why_not = ""
    for travel, wanted, peak in needs:
        if travel > context.travel:
            why_not = (
                f"that takes ±{travel:.3g} {p} of travel, and ±{context.travel:.3g} {p} is allowed"
            )
        elif peak > _SPEED_SHARE * context.speed:
            why_not = f"that takes {peak:.3g} {p}/s, and {context.speed:.3g} {p}/s is allowed"
        elif _MOST_PERIODS * period + _TIME_TO_START > ready.time_left:
            why_not = (
                f"that takes up to {_MOST_PERIODS * period + _TIME_TO_START:.0f} s, and "
                f"{ready.time_left:.0f} s are left of --duration"
            )
        elif ready.heat(wanted.amplitude, _MOST_PERIODS * period) > _HEAT_SHARE:
            why_not = (
                f"{_MOST_PERIODS * period:.3g} s of its torque would be too much for the motor"
            )
        elif wanted.half_swing < _FEWEST_COUNTS * context.resolution:
            counts = wanted.half_swing / context.resolution
            why_not = f"its half-swing would be {counts:.0f} encoder counts"
        else:
            return wanted, travel, ""
    return None, travel, why_not


def _read(wanted: Wanted, measured: Measured) -> tuple[CriticalPoint, bool]:
    """Run the oscillation and read it, by the law that explains the axis or by the balance.

    Also whether it had settled.
    """
    ready = measured.ready
    held, end = ready.attempt(oscillate_at(ready.context, ready.known, wanted))
    measured.periods += held.periods
    count = max(round((held.end - held.begin) / held.period - 0.2), 1)
    record = ready.record(held.begin - held.period, end)
    law, balance = measured.explained, measured.lock_in
    if law is not None:
        return Reader(record, law, held.period).point(held.begin, held.period, count), held.settled
    if balance is None:
        raise NotShown("no friction law explains this axis")
    read = phasors(record, kinematics(record), held.begin, held.period, count)
    return by_balance(read, balance), held.settled
