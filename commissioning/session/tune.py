"""Gains from a run: every rule, for the loop over the link and for the loop inside the drive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, pi

import numpy as np
from numpy.typing import NDArray

from commissioning.desk import Desk
from commissioning.identification.critical_point import CriticalPoint
from commissioning.result.changes import Change
from commissioning.result.document import RunResult
from commissioning.result.experiment import Experiment, Setup
from commissioning.result.found import CriticalPoints, Point
from commissioning.result.worth import LOOPS, GainSet, Mark, StepResponse
from commissioning.rig.points import TARGETS
from commissioning.runs import resolve
from commissioning.session.named import axis_of_run
from commissioning.tuning.controllers import Gains
from commissioning.tuning.plant import LoopPlant
from commissioning.tuning.proposals import AxisKnown, CannotHold, Hold, Proposal, proposals
from commissioning.tuning.rules import Cascade
from commissioning.tuning.step import Friction, StepCourse
from drivers.described import Parameters, described
from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from profiles.axis import Axis
from profiles.errors import Refused, UsageError
from profiles.law import LoopGains
from profiles.library import load_profile
from profiles.schema import Profile

__all__ = ["DriveLoop", "Tuned", "tune", "tune_run"]

Array = NDArray[np.float64]

_STEP_POINTS = 100  # points of a step's picture
_HARMONICS_SEEN = 7  # harmonics of a square wave that show the axis
_RIGID, _RIGID_NOISE = 0.006, 3.0  # of the torque, and times the noise: left by a rigid axis
_HARMONICS_AGREE = 0.05  # of the friction
_MOST_PERIODS = 200  # of a drive's loops in their dead time
_DEFAULT_PERIOD = 0.00025  # s, of a drive's own loops where only their dead time is given


@dataclass(frozen=True, slots=True)
class DriveLoop:
    """What is known of the drive's own loops beside the profile, s; None: the profile's."""

    dead_time: float | None = None
    period: float | None = None


@dataclass(frozen=True, slots=True)
class Tuned:
    """Gains, and what there is to say about them.

    Attributes
    ----------
    curves : (2, n) time and position of the step of each set, by `step.` and its name
    """

    sets: tuple[GainSet, ...]
    notes: tuple[str, ...]
    curves: dict[str, Array]


def tune(result: RunResult, axis: Axis, profile: Profile, drive: DriveLoop) -> Tuned:
    """Gains for the axis of a completed run.

    Raises
    ------
    Refused
        The run is rejected or measured nothing: no gain can be proposed.
    UsageError
        The run is from an older tworelay and lacks what is needed.
    """
    if result.coulomb is None:
        raise Refused(
            f"run {result.run} has the status '{result.status}': without a friction that can be "
            "trusted no gain is proposed",
            code="run.no-friction",
            hint="identify the axis again",
        )
    try:
        with np.errstate(divide="raise", invalid="raise"):
            return _tune(result, axis, profile, drive)
    except (ArithmeticError, ValueError, TypeError) as error:  # a root of a negative number
        raise UsageError(
            f"run {result.run}: its numbers make no loop ({error}); identify the axis again"
        ) from None


def _tune(result: RunResult, axis: Axis, profile: Profile, drive: DriveLoop) -> Tuned:
    known, watched, setup = _known(result)
    notes: list[str] = []
    viscous = known.viscous or 0.0
    host = LoopPlant(known.inertia, viscous, known.dead_time + setup.turnaround, watched.cycle)
    found: list[tuple[Proposal, tuple[Change, ...]]] = [
        (proposal, ()) for proposal in proposals(known, "host", host)
    ]
    own = _own_loop(profile, drive, setup.loop_lag)
    if own is None:
        notes.append(
            f"no gains for the drive's own loops: profile '{profile.name}' does not say their dead "
            "time; give --drive-dead-time"
        )
    else:
        inside = LoopPlant(known.inertia, viscous, *own)
        bases = setup.bases
        scaling = Scaling(
            bases.rated_torque, bases.increments_per_revolution, axis.mechanics,
            bases.torque_constant,
        )  # fmt: skip
        own_parameters = described(profile, scaling, constant_known=True)
        found += [
            (proposal, _parameters(proposal, profile.loops, own_parameters))
            for proposal in proposals(
                known, "drive", inside, _holder(profile.loops, own_parameters)
            )
        ]
    best = _best([proposal for proposal, _ in found])
    sets = tuple(
        _set(proposal, held, best=any(proposal is one for one in best)) for proposal, held in found
    )
    curves = {
        f"step.{one.name}": _curve(proposal.step)
        for one, (proposal, _) in zip(sets, found, strict=True)
        if proposal.step
    }
    return Tuned(sets, tuple(notes), curves)


def _known(result: RunResult) -> tuple[AxisKnown, Experiment, Setup]:
    """What a run knows of its axis; raises Refused, UsageError."""
    found, watched, points = result.friction, result.experiment, result.critical_point
    coulomb, inertia, dead_time = found.coulomb, found.inertia, found.dead_time
    unknown = [text for q, text in ((inertia, "inertia"), (dead_time, "dead time")) if q is None]
    if inertia is None or dead_time is None:
        raise Refused(
            f"run {result.run}: {' and '.join(unknown)} could not be identified, so no gain is "
            "proposed",
            code="tune.unknown",
            hint="more travel, or method auto, would show it",
        )
    setup = watched.setup if watched else None
    if coulomb is None or watched is None or setup is None or watched.limits is None:
        raise UsageError(
            f"run {result.run}: lacks what tuning needs (how it was measured); identify the axis "
            "again"
        )
    amplitude = watched.cycles[0].relay_amplitude if watched.cycles else None
    if not amplitude:
        raise UsageError(
            f"run {result.run}: lacks what tuning needs (its oscillations); identify the axis again"
        )
    points = points or CriticalPoints()
    known = AxisKnown(
        inertia=inertia.value,
        viscous=found.viscous.value if found.viscous else None,
        dead_time=dead_time.value,
        friction_share=coulomb.value / amplitude,
        naive=_point(points.naive),
        corrected=_point(points.corrected),
        measured={
            phase: point
            for key, phase in TARGETS.items()
            if (there := points.point(key)) and there.how == "measured" and (point := _point(there))
        },
        friction=Friction(
            coulomb.value,
            max(setup.first_look.breakaway, coulomb.value),
            found.offset.value if found.offset else 0.0,
            watched.limits.torque,
            setup.resolution,
        ),
        travel=watched.limits.travel,
        seen=_seen(result, watched),
    )
    return known, watched, setup


def _point(point: Point | None) -> CriticalPoint | None:
    return None if point is None else CriticalPoint(point.gain, point.phase_deg, point.period)


def _seen(result: RunResult, watched: Experiment) -> float:
    """Frequency up to which the record shows a rigid axis, rad/s.

    A square wave shows it up to its seventh harmonic; where the model leaves something, or the
    harmonics contradict each other, or neither is known, only at the fundamental.
    """
    fundamental = 2 * pi / watched.cycles[0].period
    fit, exact = result.methods.modulating, result.methods.lock_in
    positions = result.methods.output_error
    rigid = positions is not None and positions.explained
    if rigid:
        pass
    elif fit is not None and fit.held_out is not None:
        rigid = fit.held_out <= max(_RIGID, _RIGID_NOISE * (fit.noise or 0.0))
    elif exact is not None and exact.harmonics:
        f = exact.harmonics
        rigid = abs(f.get("5", 0.0) / (f.get("1") or 1.0) - 1) < _HARMONICS_AGREE
    return float((_HARMONICS_SEEN if rigid else 1) * fundamental)


def _own_loop(profile: Profile, drive: DriveLoop, lag: float) -> tuple[float, float] | None:
    """Dead time and period of the drive's own loops, s.

    `lag`: what the drive itself says of its torque.
    """
    loops = profile.loops
    dead_time = drive.dead_time
    if dead_time is None:
        dead_time = None if loops is None else loops.dead_time + lag
    if dead_time is None:
        return None
    period = drive.period or (loops.period if loops else _DEFAULT_PERIOD)
    if dead_time > _MOST_PERIODS * period:
        raise UsageError(
            f"a dead time of {dead_time:g} s is {dead_time / period:.0f} periods of the drive's "
            f"loops of {period:g} s: at most {_MOST_PERIODS} make a loop; are both in seconds?"
        )
    return dead_time, period


def _mapped(loops: LoopGains | None, gains: Gains | None) -> dict[str, tuple[str, float]]:
    """Parameter and SI value of each gain that the drive has.

    A cascade, and the profile says where.
    """
    if loops is None or not isinstance(gains, Cascade) or not gains.position_gain > 0:
        return {}
    return {term: (name, getattr(gains, term)) for term, name in loops.terms.items()}


def _holder(loops: LoopGains | None, parameters: Parameters) -> Hold:
    """Gains as the drive holds them, rounded to its steps; raises CannotHold where it cannot."""

    def hold(gains: Gains) -> Gains:
        held = {}
        for term, (name, value) in _mapped(loops, gains).items():
            what = parameters[name]
            try:
                raw = what.checked_raw(value)
            except WriteFailed as error:
                raise CannotHold("gains.out-of-range", error.text) from None
            if not raw:
                raise CannotHold(
                    "gains.too-fine",
                    f"'{name}' would be {value:.3g} {what.unit}, the drive's step is "
                    f"{what.step:.3g}",
                )
            held[term] = what.si(raw)
        return Cascade(**held) if held else gains

    return hold


def _parameters(
    proposal: Proposal, loops: LoopGains | None, parameters: Parameters
) -> tuple[Change, ...]:
    """The gains in the drive's own units, where the profile maps them."""
    if not proposal.proposed:
        return ()
    found = []
    for name, value in _mapped(loops, proposal.gains).values():
        what = parameters[name]
        raw = what.raw(value)
        found.append(
            Change(
                name, value, what.unit, what.si(raw) - value, raw, what.raw_unit,
                why=f"gain by {proposal.rule}",
            )
        )  # fmt: skip
    return tuple(found)


def _set(proposal: Proposal, parameters: tuple[Change, ...], *, best: bool) -> GainSet:
    point, gains, worth, step = proposal.point, proposal.gains, proposal.margins, proposal.step
    mark = response = None
    if point is not None:
        mark = Mark(point.gain, point.phase_deg, point.period)
    if step is not None:
        response = StepResponse(step.overshoot, step.settling, step.error, step.hunting, step.size)
    of_rule = proposal.rule, proposal.loop, proposal.source, mark
    why = proposal.why_not
    code, text = (why.code, why.text) if why is not None else ("", "")
    if gains is None or worth is None:
        return GainSet(*of_rule, why_not=text, why_not_code=code)
    numbers = {name: _finite(getattr(gains, name)) for name in gains.__slots__}
    return GainSet(
        *of_rule, numbers, worth.phase, worth.gain_db, worth.sensitivity, worth.stable,
        worth.crossover,
        worth.bandwidth, response, proposal.proposed, best, text, code, parameters,
    )  # fmt: skip


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def _curve(step: StepCourse) -> Array:
    """Time and position, thinned for a picture, (2, n)."""
    stride = max(len(step.time) // _STEP_POINTS, 1)
    return np.stack((np.asarray(step.time)[::stride], np.asarray(step.position)[::stride]))


def _best(found: list[Proposal]) -> list[Proposal]:
    """The fastest of the proposed sets of each loop."""
    best = []
    for loop in LOOPS:
        sound = [p for p in found if p.loop == loop and p.proposed and p.step and p.margins]
        if sound:
            best.append(max(sound, key=lambda p: (p.margins and p.margins.crossover) or 0.0))
    return best


def tune_run(run: str, drive: DriveLoop, desk: Desk) -> tuple[RunResult, tuple[str, ...]]:
    """Tune a run, keep the gains with it, and return its result and what there is to say."""
    run_id, folder = resolve(desk.journal, run)
    history = folder.history(desk.journal, run_id)
    result = folder.result(history)
    axis = axis_of_run(history.run, folder, None)
    tuned = tune(result, axis, load_profile(axis.profile or ""), drive)
    result = replace(result, tuning=tuned.sets)
    folder.save(result, curves=tuned.curves)
    return result, tuned.notes
