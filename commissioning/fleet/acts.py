"""What is done to one axis of a fleet: the look at it, and its job, by the acts for one axis."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import replace

from commissioning.desk import Desk, Options, connect
from commissioning.ending import error_of, of_failed
from commissioning.fleet.messages import Looked, Order
from commissioning.ownership import owned
from commissioning.result.document import RunResult
from commissioning.result.endings import AxisState
from commissioning.result.fleet import OF_EXIT_CODE, JobState, Outcome, Room
from commissioning.result.words import VERDICTS, act_ended
from commissioning.rig.armed import Failure, fit
from commissioning.rig.preflight import Limits, writes
from commissioning.runs import RunFolder
from commissioning.session.commission import prove_and_store
from commissioning.session.identify import identify
from commissioning.session.verify import Wishes, provable, verify
from drivers.drive import Drive
from profiles.axis import Axis
from profiles.errors import Refused, TwoRelayError

__all__ = ["Step", "carry_out", "look_at"]

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


def carry_out(order: Order, desk: Desk, step: Step) -> tuple[JobState, Outcome]:
    """The job on one axis, to whatever end; raises only what is a bug."""
    began = time.monotonic()
    axis = Axis.model_validate_json(order.axis)
    result: RunResult | None = None
    error: TwoRelayError | None = None
    try:
        with owned(axis.link or "virtual://", f"a fleet's job on axis {axis.name}"):
            result, error = _done(order, axis, desk, step)
    except Failure as failure:
        result, error = failure.result, failure.error
    except Refused as refused:  # somebody else has the bus
        error = refused
    state = OF_EXIT_CODE.get(0 if error is None else error.exit_code, JobState.UNKNOWN)
    return state, _outcome(result, error, desk, time.monotonic() - began)


def _done(
    order: Order, axis: Axis, desk: Desk, step: Step
) -> tuple[RunResult | None, TwoRelayError | None]:
    """The result as far as it got, and what ended it early."""
    options = _within(order.options, order.room)
    if order.job == "verify":
        return _verified(order, axis, options, desk, step)
    steps = 1 if order.job == "identify" else 3
    step(1, steps, "measuring")
    result = identify(axis, options, desk)
    if order.job == "identify" or not result.compensation:
        return result, None
    run = str(result.run)

    def write(_changes: object) -> None:
        step(2, steps, "writing")

    try:
        found = prove_and_store(
            run, desk, write, without_watchdog=options.without_watchdog,
            proving=lambda: step(3, steps, "proving"),
        )  # fmt: skip
    except TwoRelayError as error:
        return of_failed(desk, run, error), error
    return found, None


def _verified(
    order: Order, axis: Axis, options: Options, desk: Desk, step: Step
) -> tuple[RunResult | None, TwoRelayError | None]:
    run = None
    try:
        step(1, 1, "proving")
        run = _run_to_verify(options.serial or "", axis.name, desk)
        wishes = Wishes(
            options.travel, options.max_speed, options.cycle, options.without_watchdog,
            options.max_torque,
        )  # fmt: skip
        return verify(run, axis.link, desk, wishes), None
    except TwoRelayError as error:
        return (of_failed(desk, run, error) if run else None), error


def _run_to_verify(serial: str, axis: str, desk: Desk) -> str:
    """The last run that measured on this drive; raises Refused."""
    for record in reversed(desk.journal.runs()):
        if record.serial == serial and record.axis == axis and record.status == "completed":
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


def _outcome(
    result: RunResult | None, error: TwoRelayError | None, desk: Desk, seconds: float
) -> Outcome:
    said = None if error is None else error_of(error)
    if result is None:
        return Outcome(error=said, seconds=seconds, at_rest=True)
    found, proved, ending = result.friction, result.verification, result.ending
    kept = None if proved is None else proved.kept
    mark = result.profile
    return Outcome(
        result.run,
        None if mark is None else f"{mark.name} {mark.version}",
        VERDICTS[result.quality.verdict] if result.quality.verdict else None,
        result.coulomb, found.offset, found.viscous, found.inertia,
        result.compensation,
        result.written,
        result.units.position,
        None if proved is None else proved.steps[0].reversal_error,
        None if kept is None else kept.reversal_error,
        None if proved is None else proved.percent,
        act_ended(result),
        ending is not None and ending.axis in _SAFE,
        said,
        seconds,
        _hash(result, desk),
    )  # fmt: skip


def _hash(result: RunResult, desk: Desk) -> str | None:
    """SHA-256 of the run's result, as it lies there."""
    if result.run is None:
        return None
    path = RunFolder.of(desk.journal, result.run).path / "run.json"
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
