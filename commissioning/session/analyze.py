"""A recording of any tool, read with the mathematics of an experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from commissioning.ending import begun, ended, failed
from commissioning.errors import MeasurementRejected
from commissioning.identification import verdict
from commissioning.identification.breaks import of_jumps
from commissioning.identification.errors import words_of
from commissioning.identification.lock_in import LockIn, lock_in, phasors
from commissioning.identification.modulating import (
    ModulatingEstimate,
    estimate,
    refined_kinematics,
)
from commissioning.identification.oscillation import Steady, pair, steady_oscillations
from commissioning.identification.output_error import OutputErrorEstimate, output_error
from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import Kinematics, Record, resolution_of, rests, trusted
from commissioning.identification.steady import SteadyFit, SteadyPoint, at_speed, fit, plateaus
from commissioning.identification.verdict import agreement, of_lock_in, of_modulating
from commissioning.recordings.files import table_of
from commissioning.recordings.reading import Recording, Scales, column_of, read
from commissioning.result.document import RunResult
from commissioning.result.endings import AxisState
from commissioning.result.experiment import Experiment
from commissioning.result.found import QUANTITIES, Found, Quantity, Units
from commissioning.result.readings import Methods
from commissioning.rig.readings import (
    balance_reading,
    modulating_reading,
    output_error_reading,
    steady_reading,
)
from commissioning.rig.results import (
    Rejected,
    curve_of,
    judged,
    quantity,
)
from profiles.axis import Axis, Mechanics
from profiles.errors import UsageError

__all__ = ["Columns", "analyze"]

Array = NDArray[np.float64]
Columns = dict[str, str | None]  # quantity: COL:UNIT as the user gives it

_DOMINATES = 0.5  # of the record: one oscillation that is all there is …
_BEFORE = 0.1  # of the span that was analysed
_SWITCHED = 0.3  # of the samples at which the torque may change
_ONE_SWING = 1.1  # … with half-swings that differ by no more
_MISSES = 0.15  # of the torque, on speeds that were left out: no friction curve


def analyze(
    files: Sequence[Path],
    columns: Columns,
    bases: Scales | None = None,
    *,
    steady: bool,
    method: str,
    tell: Callable[[str], None],
) -> RunResult:
    """The result of recordings.

    Raises UsageError for what is no recording, Rejected for what shows no friction.
    """
    recordings = []
    for path in files:
        tell(f"reading {path}")
        table = table_of(path)
        named = {q: column_of(text, q, table.scalars) for q, text in columns.items()}
        for note in table.notes:
            tell(note)
        recordings.append(read(table, named, bases))
    linear = recordings[0].linear
    if any(r.linear != linear for r in recordings):
        raise UsageError("rotary and linear recordings do not go together")
    mechanics = Mechanics(motion="linear" if linear else "rotary", feed=1.0 if linear else None)
    axis = Axis(mechanics=mechanics).model_copy(update={"name": files[0].stem})
    result = replace(begun(axis), experiment=_watched(recordings))
    if len(recordings) > 1 and not steady:
        raise UsageError("several recordings go together with --steady only; give one")
    try:
        # a number that overflows is an error, not a warning of numpy's
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            if steady:
                result = _steady(result, recordings)
            else:
                result = _motion(result, recordings[0], method, tell)
    except (ValueError, ArithmeticError, MeasurementRejected) as error:
        got = error.result if isinstance(error, Rejected) else result
        told = str(error) if isinstance(error, MeasurementRejected) else words_of(error)
        why = MeasurementRejected(f"{files[0]}: {told}", code="recording.rejected")
        raise Rejected(str(why), ended(failed(got, why), None, AxisState.NOT_MOVED)) from None
    return ended(replace(result, status="completed"), None, AxisState.NOT_MOVED)


def _watched(recordings: Sequence[Recording]) -> Experiment:
    first = recordings[0]
    return Experiment(
        periods=0,
        duration=float(sum(r.time[-1] - r.time[0] for r in recordings)),
        cycle=float(np.median(np.diff(first.time))),
        late_share=_late_share(first.time),
        lost_share=0.0,
        travel=0.0 if first.position is None else float(np.ptp(first.position)),
    )


def _late_share(time: Array) -> float:
    steps = np.diff(time)
    return float(np.mean(steps > 1.5 * np.median(steps)))


# -- constant speeds ------------------------------------------------------------------------------


def _steady(result: RunResult, recordings: list[Recording]) -> RunResult:
    points: list[SteadyPoint] = []
    resting = []
    for recording in recordings:
        velocity = recording.velocity
        if velocity is None:
            assert recording.position is not None
            velocity = np.gradient(recording.position, recording.time)
        moves = at_speed(velocity)
        resting.append(1 - float(np.mean(moves)))
        points += plateaus(velocity, recording.torque, moves)
    found = fit(points)
    numbers = {
        name: quantity(getattr(found, name), result.units.of_quantity(name))
        for name in ("coulomb", "offset", "viscous")
    }
    fastest = max(abs(point.speed) for point in points)
    result = replace(
        result,
        friction=Found("steady", **numbers, curve=curve_of([found], fastest)),
        methods=Methods(steady=steady_reading(found, points)),
    )
    return judged(result, [*_steady_reasons(found, result.units), *_of_rest(resting)])


def _of_rest(shares: list[float]) -> list[Reason]:
    """What rests, of each recording; that is no speed."""
    some = [share for share in shares if share > 0]
    if not some:
        return []
    text = f"the axis rests in {len(some)} of {len(shares)} recordings, " if len(shares) > 1 else ""
    text += f"{'for' if text else 'the axis rests for'} {100 * max(some):.0f} % of the time"
    text += " at most; that is left out" if len(some) > 1 else "; that is left out"
    return [Reason("axis.rests", Weight.NOTE, text)]


def _steady_reasons(found: SteadyFit, units: Units) -> list[Reason]:
    reasons = []
    if found.held_out > 0.05:
        reasons.append(
            Reason(
                "fit.left-out",
                Weight.CONTRADICTION if found.held_out > _MISSES else Weight.DOUBT,
                f"speeds that were left out of the fit are met to {100 * found.held_out:.1f} % "
                "only",
            )
        )
    if found.stribeck_speed is not None:
        reasons.append(
            Reason(
                "law.stribeck",
                Weight.NOTE,
                f"Stribeck effect: {found.stribeck_level:.3g} {units.effort} more at rest, gone "
                f"beyond {found.stribeck_speed:.3g} {units.position}/s",
            )
        )
    if found.viscous.value < 0:
        reasons.append(
            Reason(
                "friction.falls",
                Weight.DOUBT,
                "friction falls with speed throughout: is the motor saturated?",
            )
        )
    return reasons


# -- any motion -----------------------------------------------------------------------------------


def _motion(
    result: RunResult, recording: Recording, method: str, tell: Callable[[str], None]
) -> RunResult:
    record, reasons = _record(recording)
    units, watched = result.units, result.experiment
    assert watched is not None
    named = verdict.UnitNames(units.position, units.effort)
    jumps = of_jumps(record, units.position)
    if jumps:  # whatever else it shows comes of that
        return judged(result, [*reasons, *jumps])
    kinematics = refined_kinematics(record)
    oscillations = steady_oscillations(record, kinematics)
    two = pair(oscillations)
    is_a_run = recording.analysed is not None
    one = not is_a_run and _is_one_oscillation(record, oscillations)
    bent: float | None = None
    is_wanted = method == "output-error"
    may_be = is_a_run or (not one and bool(oscillations) and _is_switched(record))
    if is_wanted or (method == "auto" and may_be):
        tell("output error")
        positions = _by_positions(record, recording, result)
        if is_wanted and positions is None:
            raise MeasurementRejected(
                "the positions of the recording are no oscillation of a rigid axis, which output "
                "error needs",
                code="recording.not-rigid",
                hint="use --method auto",
            )
        if positions is not None and (is_wanted or positions.is_explained):
            return _told_by_positions(result, positions, reasons, named)
        bent = None if positions is None else positions.bent_level
    exact: LockIn | None = None
    fast: ModulatingEstimate | None = None
    if two is not None and method != "modulating":
        tell(f"two oscillations of {two[0].period * 1000:.4g} ms: exact harmonic balance")
        exact = _balanced(record, kinematics, two, watched.cycle)
    elif method == "lock-in":
        raise MeasurementRejected(
            "the exact balance needs two steady oscillations of one period and different swing; "
            f"the recording has {len(oscillations)} steady stretches",
            code="recording.no-pair",
            hint="use --method modulating",
        )
    if method != "lock-in":
        tell("modulating functions")
        fast = estimate(record, any_motion=two is None and not is_a_run, ladder=not one)
        if bent is not None and not {"stribeck", "soft"} & set(fast.law.rungs):
            fast = replace(fast, coulomb=verdict.holding(fast.coulomb, bent))
            reasons.append(verdict.of_bend(named))
        reasons += of_modulating(fast, named)
        if one:
            reasons.append(_of_one(oscillations[0], units))
    if exact is not None:
        reasons += of_lock_in(exact, record.resolution, named)
        if fast is not None:
            reasons.append(agreement(fast, exact, named))
    found = fast or exact
    assert found is not None
    periods = round(fast.periods if fast else sum(exact.periods) if exact else 0)
    numbers = {name: quantity(getattr(found, name), units.of_quantity(name)) for name in QUANTITIES}
    curve = curve_of([fast], fast.peak_speed) if fast else None
    low_speed = Quantity(fast.low_speed, None, None, units.effort) if fast else None
    result = replace(
        result,
        friction=Found(
            "modulating" if fast else "lock-in", **numbers, low_speed=low_speed, curve=curve
        ),
        methods=Methods(
            lock_in=balance_reading(exact) if exact else None,
            modulating=modulating_reading(fast) if fast else None,
        ),
        experiment=replace(watched, periods=periods),
    )
    return judged(result, reasons)


def _balanced(
    record: Record, kinematics: Kinematics, two: tuple[Steady, Steady], cycle: float
) -> LockIn:
    """The exact balance of two oscillations."""
    period = two[0].period
    first, second = (
        phasors(record, kinematics, o.begin, period, int(o.periods * o.period / period))
        for o in two
    )
    return lock_in(first, second, record.resolution, cycle)


def _of_one(oscillation: Steady, units: Units) -> Reason:
    """One half-swing tells Coulomb from viscous friction by little."""
    return Reason(
        "recording.one-oscillation",
        Weight.DOUBT,
        f"one oscillation only (half-swing {oscillation.half_swing:.3g} {units.position}, period "
        f"{oscillation.period * 1000:.4g} ms): what tells Coulomb from viscous friction is the "
        "shape of its torque alone, so no other law was tried; record two of clearly different "
        "torque",
    )


def _by_positions(
    record: Record, recording: Recording, result: RunResult
) -> OutputErrorEstimate | None:
    """Output error, from the modulating functions of a rigid axis on; None where that fails."""
    try:
        start = estimate(record, ladder=False)
        return output_error(
            record, start.fit.model, start.coulomb.value,
            rotary=result.units.position == "rad", spans=_spans(recording),
        )  # fmt: skip
    except ValueError:
        return None


def _is_switched(record: Record) -> bool:
    """Whether the torque keeps its level for most of the samples, as that of a relay does."""
    return float(np.mean(np.diff(record.command) != 0)) < _SWITCHED


def _spans(recording: Recording) -> list[tuple[float, float]]:
    """Begin and end of the stretches that a run was analysed by, s; none: all of it."""
    if recording.analysed is None:
        return []
    edges = np.diff(np.concatenate(([0], recording.analysed.astype(int), [0])))
    time = recording.time
    return [
        (float(time[first]), float(time[last - 1]))
        for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    ]


def _told_by_positions(
    result: RunResult,
    found: OutputErrorEstimate,
    reasons: list[Reason],
    named: verdict.UnitNames,
) -> RunResult:
    units, watched = result.units, result.experiment
    assert watched is not None
    numbers = {name: quantity(getattr(found, name), units.of_quantity(name)) for name in QUANTITIES}
    result = replace(
        result,
        friction=Found(
            "output-error",
            **numbers,
            lag=quantity(found.lag, units.dead_time),
            low_speed=Quantity(found.low_speed, None, None, units.effort),
            curve=curve_of([found], found.peak_speed),
        ),
        methods=Methods(output_error=output_error_reading(found)),
        experiment=replace(watched, periods=round(found.periods)),
    )
    return judged(result, [*reasons, *verdict.of_output_error(found, inf, named)])


def _record(recording: Recording) -> tuple[Record, list[Reason]]:
    reasons = []
    position = recording.position
    if position is None:
        velocity = recording.velocity
        assert velocity is not None
        pieces = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(recording.time)
        position = np.concatenate(([0.0], np.cumsum(pieces)))
        reasons.append(
            Reason(
                "position.integrated",
                Weight.DOUBT,
                "the position is the integral of the velocity that was recorded",
            )
        )
    time, sent, torque = recording.time, recording.sent, recording.torque
    if recording.analysed is not None:
        mask = recording.analysed
        if recording.lateness is not None:
            mask = mask & trusted(recording.lateness, float(np.median(np.diff(time))))
        kept = np.flatnonzero(mask)
        span = time[kept[-1]] - time[kept[0]]
        acts = sent >= time[kept[0]] - _BEFORE * span  # commands before it act in it, too
        acts &= sent <= time[kept[-1]]
        time, position = time[kept], position[kept]
        sent, torque = sent[acts], torque[acts]
    record = Record.of(time, position, sent, torque, resolution_of(position))
    quiet = rests(record)
    if len(quiet):
        share = float((quiet[:, 1] - quiet[:, 0]).sum() / (record.time[-1] - record.time[0]))
        reasons.append(
            Reason(
                "axis.rests",
                Weight.NOTE,
                f"the axis rests for {100 * share:.0f} % of the time; that is left out",
            )
        )
    return record, reasons


def _is_one_oscillation(record: Record, oscillations: list[Steady]) -> bool:
    """Whether one oscillation, of one half-swing, is nearly all there is."""
    duration = float(record.time[-1] - record.time[0])
    covered = sum((o.periods + 1) * o.period for o in oscillations)
    if not oscillations or covered < _DOMINATES * duration:
        return False
    swings = [o.half_swing for o in oscillations]
    return max(swings) <= _ONE_SWING * min(swings)
