"""A run that moves an axis.

Checks, arming, journal and record around whatever work is done in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from commissioning.desk import Desk, Options, begin_run, connect, drive_line, none_unfinished
from commissioning.ending import (
    axis_state,
    begun,
    ended,
    erring,
    failed,
    on_drive,
    untouched,
)
from commissioning.guardian import Guardian, guarded
from commissioning.identification.reasons import Reason, Weight
from commissioning.result.document import Quality, RunResult
from commissioning.result.endings import AxisState
from commissioning.result.experiment import Allowed
from commissioning.result.words import remaining
from commissioning.rig import preflight
from commissioning.rig.conditions import conditions
from commissioning.rig.dry_run import would_write
from commissioning.rig.expected import of_commissioning, setting_of, to_one_side
from commissioning.rig.preflight import check_watchdog, choose_limits, look
from commissioning.rig.results import Rejected, experiment
from commissioning.rig.rig import Rig
from commissioning.runs import RunFolder
from commissioning.samples import Samples
from commissioning.settings import Settings
from commissioning.watching import Stage
from drivers.drive import Drive
from drivers.writing import why_not_written
from profiles.axis import Axis
from profiles.errors import IdentityMismatch, Refused, TwoRelayError
from profiles.library import source_of

__all__ = ["Failure", "Work", "fit", "in_a_run", "noted"]

Work = Callable[[Rig, RunResult], RunResult]


class Failure(Exception):
    """A job that ended early: its error, and the result as far as it got."""

    def __init__(self, error: TwoRelayError, result: RunResult) -> None:
        super().__init__(str(error))
        self.error = error
        self.result = result


@dataclass
class _Draft:
    """The result as far as it got."""

    result: RunResult


def in_a_run(axis: Axis, options: Options, desk: Desk, work: Work) -> RunResult:
    """Do `work` on the armed drive of `axis`; it fills the result, which is returned.

    Raises
    ------
    Failure
        Around any TwoRelayError, with the result so far. The axis is at rest and de-energised, and
        every setting of the experiment is back, or the error says what is not.
    """
    draft = _Draft(begun(axis))
    try:
        with connect(axis, options.cycle, desk, f"a job on axis {axis.name}") as drive:
            _run(axis, options, desk, drive, draft, work)
    except TwoRelayError as error:
        result = draft.result
        if result.ending is None:  # before anything was moved or written
            result = ended(failed(result, error), None, untouched(error), error.said_by or None)
        elif result.status == "completed":  # and then the link was closed, or a signal came
            result = erring(result, error)
            if result.run is not None:
                RunFolder.of(desk.journal, result.run).save(result)
        raise Failure(error, result) from error
    return draft.result


def _run(axis: Axis, options: Options, desk: Desk, drive: Drive, draft: _Draft, work: Work) -> None:
    identity = drive.identity()
    draft.result = on_drive(draft.result, axis, drive.link, drive.profile, identity)
    desk.tell(drive_line(identity, drive.profile))
    for line in drive.lacking:
        desk.tell(line)
    limits = fit(axis, options, desk, drive)
    if options.dry_run:
        draft.result = _dry_run(axis, options, drive, limits, desk, draft.result)
        return
    desk.agree(
        _arming_text(axis, options, drive, limits), axis.name, "nothing was moved or written"
    )
    limits = fit(axis, options, desk, drive)  # the question may have stood for long
    measuring, after = of_commissioning(options, axis, drive, limits)
    desk.watcher.begins(setting_of(axis, drive, limits), [*measuring, *after])
    _begun(axis, options, desk, drive, draft, limits, work)


def fit(axis: Axis, options: Options, desk: Desk, drive: Drive) -> preflight.Limits:
    """Whether the connected drive may be moved, by all that reading shows; and within what.

    Raises Refused, LinkError, UsageError.
    """
    serial = drive.identity().serial
    if options.serial is not None and serial != options.serial:
        raise IdentityMismatch(
            f"the drive on {drive.link} has serial {serial}, and {options.serial} is meant: "
            "nothing was moved or written",
            code="identity.serial",
        )
    none_unfinished(desk, serial, drive.link)
    look(drive, axis)
    check_watchdog(drive, without=options.without_watchdog)
    if options.writes:
        _may_be_written(drive)
    return choose_limits(drive, axis, options)


def _may_be_written(drive: Drive) -> None:
    """Raise Refused where the compensation may not be written: known before anything moves."""
    for name in drive.compensation.written:
        why = why_not_written(drive.parameters[name])
        if why is not None:
            raise Refused(
                f"{why.text}, so that what is measured could not be written: nothing was moved",
                code=why.code,
                hint=f"{why.hint}; 'tworelay identify' only measures",
                parameter=name,
            )


def _begun(
    axis: Axis,
    options: Options,
    desk: Desk,
    drive: Drive,
    draft: _Draft,
    limits: preflight.Limits,
    work: Work,
) -> None:
    """The work as a run of the journal, whatever becomes of it."""
    identity = drive.identity()
    profile_text = source_of(axis, drive.profile)
    run_id = begin_run(desk, drive, identity, axis, options.fraction)
    seen = conditions(drive, axis, limits.start, options.motor_temperature)
    draft.result = replace(draft.result, run=run_id, conditions=seen)
    folder = RunFolder.of(desk.journal, run_id)
    folder.save(
        draft.result, profile=profile_text
    )  # so that `restore` knows the drive after a crash
    recorder = desk.record()
    notes: tuple[str, ...] = drive.lacking
    said_by: str | None = None
    try:
        settings = Settings(desk.journal, run_id, drive)
        home = desk.journal.folder
        with guarded(drive, axis, folder.profile_path(), run_id, home) as guardian:
            rig = Rig.of(axis, options, desk, drive, limits, recorder, settings, guardian)
            try:
                draft.result = replace(work(rig, draft.result), status="completed")
            finally:
                notes = (*notes, *noted(guardian))
    except TwoRelayError as error:
        if isinstance(error, Rejected):
            draft.result = error.result
        draft.result = failed(draft.result, error)
        said_by = error.said_by or None
        raise
    finally:
        with desk.interruption.deferred():
            result = replace(draft.result, notes=draft.result.notes + notes)
            if result.experiment is None:
                allowed = Allowed(limits.travel, limits.torque, limits.speed)
                watched = experiment(recorder, drive.cycle, 0, allowed)
                result = replace(result, experiment=watched)
            history = desk.journal.history(run_id)
            result = ended(result, history, axis_state(drive, axis), said_by)
            draft.result = result
            try:
                folder.save(result, Samples.of(recorder))
            finally:
                desk.journal.finish(run_id, result.status)


def noted(guardian: Guardian) -> list[str]:
    """What the result keeps of what the guardian did."""
    acted = guardian.acted()
    return [acted, *(f"guardian: {line}" for line in guardian.said[1:])] if acted else []


def _arming_text(axis: Axis, options: Options, drive: Drive, limits: preflight.Limits) -> str:
    """What will move, how far and how long; and what comes after it, act by act."""
    p, e = axis.position_unit, axis.effort_unit
    measuring, after = of_commissioning(options, axis, drive, limits)
    move = (
        f"MOVE axis '{axis.name}' by itself for about {_seconds(measuring)}, within "
        f"±{limits.travel:.4g} {p} of its present position; it is stopped there, at "
        f"{limits.torque:.4g} {e} and at {limits.speed:.4g} {p}/s"
    )
    acts = [move]
    if after and not options.ask_each:
        names = ", ".join(drive.compensation.written)
        way = f"{to_one_side(limits):.3g} {p} to one side and back"
        acts += [
            f"WRITE the compensation that is found: {names}",
            f"MOVE in position mode, slowly, {way}, for about {_seconds(after)}",
            "STORE what helps, or put the old values back",
        ]
    told = acts[0] if len(acts) == 1 else "; ".join(f"{n}. {act}" for n, act in enumerate(acts, 1))
    return (
        f"This will {told}. tworelay is not a safety function: keep people clear and the emergency "
        "stop in reach."
    )


def _seconds(steps: Sequence[Stage]) -> str:
    return remaining(sum(step.seconds for step in steps))


def _dry_run(
    axis: Axis,
    options: Options,
    drive: Drive,
    limits: preflight.Limits,
    desk: Desk,
    result: RunResult,
) -> RunResult:
    """Say what would be written; write nothing."""
    desk.tell(_arming_text(axis, options, drive, limits))
    for line in would_write(drive, axis, limits):
        desk.tell(line)
    desk.tell("dry run: nothing was written or moved")
    nothing = Reason("dry-run", Weight.NOTE, "dry run: nothing was measured")
    result = replace(result, status="completed", quality=Quality(None, (nothing,)))
    return ended(result, None, AxisState.NOT_MOVED)
