"""What is done to one axis of a fleet: the look at it, and its job, by the acts for one axis."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import replace

from commissioning.desk import Desk, Options, connect
from commissioning.ending import error_of, of_failed, of_run
from commissioning.fleet.messages import Looked, Order
from commissioning.journal import Journal
from commissioning.ownership import owned
from commissioning.result.document import RunResult
from commissioning.result.endings import AxisState
from commissioning.result.fleet import OF_EXIT_CODE, JobState, Outcome, Room
from commissioning.result.words import VERDICTS, act_ended, nothing_proposed
from commissioning.rig.armed import Failure, fit
from commissioning.rig.preflight import Limits, writes
from commissioning.runs import RunFolder
from commissioning.session.commission import prove_and_store
from commissioning.session.identify import identify
from commissioning.session.verify import Wishes, provable, verify
from drivers.drive import Drive
from profiles.axis import Axis
from profiles.errors import Refused, TwoRelayError

__all__ = ["Step", "carry_out", "look_at", "outcome_now"]

Step = Callable[[int, int, str], None]  # number from 1, of how many, what happens
_SAFE = AxisState.AT_REST, AxisState.HELD, AxisState.NOT_MOVED


def look_at(order: Order, desk: Desk) -> Looked:
    """Connect, and read; raises what the job would be refused for, as far as reading shows it."""
    axis = Axis.model_validate_json(order.axis)
    with connect(axis, order.options.cycle, desk, f"a look at axis {axis.name}") as drive:
        limits = fit(axis, order.options, desk, drive)
        if order.job != "identify":
            provable(drive.profile)
        identity = drive.identity()
        if order.job == "verify":
            _run_to_verify(identity.serial, axis.name, desk)
        room = Room(
            limits.travel, limits.torque, limits.speed, axis.position_unit, axis.effort_unit
        )
        profile = drive.profile
        mark = f"{profile.name} {profile.version}"
        return Looked(identity.serial, str(identity), mark, room, _writes(drive, limits))


def _writes(drive: Drive, limits: Limits) -> tuple[str, ...]:
    found = []
    for name, raw in writes(drive, limits).items():
        there, what = drive.read(name).raw, drive.parameters[name]
        if there != raw:
            found.append(f"{name} ({what.address}): {there} → {raw} (x {what.raw_unit})")
    return tuple(found)


class _Progress:
    """How far a job has got."""

    result: RunResult | None = None


def carry_out(order: Order, desk: Desk, step: Step) -> tuple[JobState, Outcome]:
    """The job on one axis, to whatever end; raises only what is a bug."""
    began = time.monotonic()
    axis = Axis.model_validate_json(order.axis)
    progress, error = _Progress(), None
    try:
        with owned(axis.link or "virtual://", f"a fleet's job on axis {axis.name}"):
            _do(order, axis, desk, step, progress)
    except Failure as failure:
        progress.result, error = failure.result, failure.error
    except TwoRelayError as early:
        error = early
        if progress.result is not None and progress.result.run is not None:
            progress.result = of_failed(desk, progress.result.run, early)
    state = OF_EXIT_CODE.get(0 if error is None else error.exit_code, JobState.UNKNOWN)
    return state, _outcome(progress.result, error, desk, time.monotonic() - began)


def _do(order: Order, axis: Axis, desk: Desk, step: Step, progress: _Progress) -> None:
    """What the job is, step by step."""
    options = _within(order.options, order.room)
    if order.job == "verify":
        step(1, 1, "proving")
        run = _run_to_verify(options.serial or "", axis.name, desk)
        progress.result = of_run(desk, run)
        wishes = Wishes(
            options.travel, options.max_speed, options.cycle, options.without_watchdog,
            options.max_torque,
        )  # fmt: skip
        progress.result = verify(run, axis.link, desk, wishes)
        return
    steps = 1 if order.job == "identify" else 3
    step(1, steps, "measuring")
    progress.result = identify(axis, options, desk)
    if order.job == "identify" or not progress.result.compensation:
        return

    def write(_changes: object) -> None:
        step(2, steps, "writing")

    progress.result = prove_and_store(
        str(progress.result.run), desk, write, without_watchdog=options.without_watchdog,
        proving=lambda: step(3, steps, "proving"),
    )  # fmt: skip


def _run_to_verify(serial: str, axis: str, desk: Desk) -> str:
    """The last run that measured on this drive; raises Refused."""
    for record in reversed(desk.journal.on_drive(serial)):
        if record.axis == axis and record.status == "completed":
            return record.id
    raise Refused(
        f"no run of axis '{axis}' with the drive {serial} can be verified: identify it first",
        code="verify.no-run",
    )


def _within(options: Options, room: Room | None) -> Options:
    """What was asked for, in the room that was confirmed."""
    if room is None:
        return options
    return replace(options, travel=room.travel, max_torque=room.torque, max_speed=room.speed)


def outcome_now(outcome: Outcome, journal: Journal) -> Outcome:
    """An outcome with what its run has in the drive by now: it may have been put back since."""
    if outcome.run is None:
        return outcome
    try:
        history = journal.history(outcome.run)
        result = RunFolder.of(journal, outcome.run).result(history)
    except TwoRelayError:  # its files are gone
        return outcome
    now = _of_result(result, journal)
    return replace(now, error=outcome.error, seconds=outcome.seconds, remark=outcome.remark)


def _outcome(
    result: RunResult | None, error: TwoRelayError | None, desk: Desk, seconds: float
) -> Outcome:
    said = None if error is None else error_of(error)
    if result is None:  # nothing was begun
        return Outcome(error=said, seconds=seconds, at_rest=True)
    remark = "" if error or result.compensation else nothing_proposed(result)
    found = _of_result(result, desk.journal)
    return replace(found, error=said, seconds=seconds, remark=remark)


def _of_result(result: RunResult, journal: Journal) -> Outcome:
    found, proved, ending = result.friction, result.verification, result.ending
    kept = None if proved is None else proved.kept
    mark = result.profile
    return Outcome(
        run=result.run,
        profile=None if mark is None else f"{mark.name} {mark.version}",
        verdict=VERDICTS[result.quality.verdict] if result.quality.verdict else None,
        coulomb=result.coulomb,
        offset=found.offset,
        viscous=found.viscous,
        inertia=found.inertia,
        changes=result.compensation,
        written=result.written,
        position_unit=result.units.position,
        before=None if proved is None else proved.steps[0].reversal_error,
        after=None if kept is None else kept.reversal_error,
        percent=None if proved is None else proved.percent,
        ending=act_ended(result),
        put_back=ending is None or ending.settings is None or not ending.settings.names,
        at_rest=ending is not None and ending.axis in _SAFE,
        sha256=_hash(result, journal),
    )


def _hash(result: RunResult, journal: Journal) -> str | None:
    """SHA-256 of the run's result, as it lies there."""
    if result.run is None:
        return None
    path = RunFolder.of(journal, result.run).path / "run.json"
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
