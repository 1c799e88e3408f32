"""How a result begins, and how every act ends.

With what is true of axis, settings and drive then.
"""

from __future__ import annotations

import getpass
import platform
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version

from commissioning.desk import Desk
from commissioning.identification.reasons import Reason, Weight
from commissioning.records import History
from commissioning.result.document import SCHEMA, ProfileMark, Quality, RunResult, Tool
from commissioning.result.endings import AxisState, Ending, Error
from commissioning.result.found import Found, Units
from commissioning.runs import RunFolder, drive_state, left_in_drive, resolve, settings_state
from commissioning.samples import Array
from drivers.drive import Drive
from drivers.errors import DriveEnabled
from profiles.axis import Axis
from profiles.errors import TwoRelayError, UsageError
from profiles.identity import Identity
from profiles.library import digest
from profiles.schema import Profile

__all__ = [
    "axis_state",
    "begun",
    "close_act",
    "cut_off",
    "ended",
    "erring",
    "error_of",
    "failed",
    "of_failed",
    "of_run",
    "on_drive",
    "operator",
    "stopped_state",
    "tool",
    "untouched",
]


def _now() -> str:
    """ISO 8601, with the zone of this computer."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def tool() -> Tool:
    """Whose work it is, and of which version."""
    try:
        return Tool("tworelay", version("tworelay"))
    except PackageNotFoundError:  # from a folder that is not installed
        return Tool("tworelay", "unknown")


def operator() -> str | None:
    """Who is logged in here; None where the system does not tell."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return None


def begun(axis: Axis) -> RunResult:
    """A result in which nothing is known yet but whose it is."""
    return RunResult(
        SCHEMA, "failed", axis.name, Units.of("rad" if axis.position_unit == "rad" else "m"),
        tool(),
        platform.node() or None, operator(), _now(), link=axis.link,
    )  # fmt: skip


def on_drive(
    result: RunResult, axis: Axis, link: str, profile: Profile, identity: Identity
) -> RunResult:
    """A result with the drive that is connected: link, profile, identity."""
    mark = ProfileMark(profile.name, profile.version, digest(profile))
    return replace(result, axis=axis.name, link=link, profile=mark, identity=identity)


# -- endings --------------------------------------------------------------------------------------


def axis_state(drive: Drive, axis: Axis) -> AxisState:
    """What a drive that was commanded says of its axis now."""
    try:
        return stopped_state(axis, deenergised=not drive.state().is_energised)
    except TwoRelayError:
        return AxisState.NOT_VERIFIED


def stopped_state(axis: Axis, *, deenergised: bool | None) -> AxisState:
    """State of an axis by what a stop reached."""
    if not deenergised:
        return AxisState.NOT_VERIFIED
    return AxisState.HELD if axis.mechanics.held_by == "brake" else AxisState.AT_REST


def ended(
    result: RunResult, history: History | None, axis: AxisState, said_by: str | None = None
) -> RunResult:
    """The result with its ending.

    Settings and drive by the journal of the run, where one was begun.
    """
    if history is None:
        return replace(result, ended=_now(), ending=Ending(axis, said_by=said_by))
    written = left_in_drive(result, history)
    result = replace(result, written=written, ended=_now())
    found = Ending(axis, settings_state(history), drive_state(result, history), said_by)
    return replace(result, ending=found)


def failed(result: RunResult, error: TwoRelayError) -> RunResult:
    """The result of a measurement that ended with `error`.

    Without numbers that nobody should use.
    """
    quality = result.quality
    if error.status != "rejected":
        quality = Quality()
    elif quality.verdict != "rejected":
        reason = Reason("measurement.none", Weight.CONTRADICTION, str(error))
        quality = Quality("rejected", (reason,))
    nothing = replace(
        result, friction=Found(), critical_point=None, compensation=(), host_compensation=None
    )
    return erring(replace(nothing, quality=quality), error)


def erring(result: RunResult, error: TwoRelayError) -> RunResult:
    """The result of an act on a run that ended with `error`."""
    return replace(result, status=error.status, error=error_of(error))


def error_of(error: TwoRelayError) -> Error:
    """An error as a result has it."""
    numbers = {name: fact for name, fact in error.facts.items() if not isinstance(fact, str)}
    names = {name: fact for name, fact in error.facts.items() if isinstance(fact, str)}
    return Error(error.code, error.whole, error.hint, numbers, names)


def cut_off(result: RunResult) -> RunResult:
    """The run as it is to be found where the act that begins now is never ended."""
    return replace(result, status="failed", error=None, ending=None)


def close_act(
    desk: Desk,
    folder: RunFolder,
    result: RunResult,
    axis: AxisState,
    error: TwoRelayError | None = None,
    curves: Mapping[str, Array] | None = None,
) -> RunResult:
    """Write into the run what an act on it did, and how it ended; returns the result."""
    said_by = None if error is None else error.said_by or None
    if error is not None:
        result = erring(result, error)
    assert result.run is not None
    result = ended(result, desk.journal.history(result.run), axis, said_by)
    folder.save(result, curves=curves)
    if error is not None:
        error.noted = True
    return result


def of_run(desk: Desk, run: str) -> RunResult:
    """The result of a run with what its journal says now; where its file is no more, that alone."""
    history = desk.journal.history(run)
    try:
        return RunFolder.of(desk.journal, run).result(history)
    except UsageError:
        record = history.run
        bare = RunResult(SCHEMA, "failed", record.axis, Units(), run=run, link=record.link)
        return ended(bare, history, AxisState.NOT_MOVED)


def untouched(error: TwoRelayError, before: Ending | None = None) -> AxisState:
    """What is known of an axis when an act ends before it has done anything."""
    if isinstance(error, DriveEnabled):
        return AxisState.ENABLED
    if before is not None and before.axis is AxisState.NOT_VERIFIED:
        return AxisState.NOT_VERIFIED  # nobody has looked since
    return AxisState.NOT_MOVED


def of_failed(desk: Desk, run: str, error: TwoRelayError) -> RunResult:
    """The result of a run that an act on it ended early.

    As the act left it, or as it was before.
    """
    run_id, folder = resolve(desk.journal, run)
    history = folder.history(desk.journal, run_id)
    result = folder.result(history) if folder.exported else of_run(desk, run_id)
    if error.noted:
        return result
    axis = untouched(error, result.ending or Ending(AxisState.NOT_VERIFIED))
    return ended(erring(result, error), history, axis, error.said_by or None)
