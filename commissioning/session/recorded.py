"""A recording of an axis becomes a run with a proposal for its drive, which is only read."""

from __future__ import annotations

from dataclasses import replace

from commissioning.desk import Desk, begin_run, connect, drive_line
from commissioning.ending import axis_state, ended, on_drive
from commissioning.result.document import RunResult
from commissioning.runs import RunFolder
from commissioning.session.proposal import with_proposal
from profiles.axis import Axis
from profiles.errors import UsageError
from profiles.library import source_of

__all__ = ["for_drive"]


def for_drive(result: RunResult, axis: Axis, fraction: float, desk: Desk) -> RunResult:
    """A recording's result with what would be written to the drive of `axis`, as a run.

    Raises UsageError, LinkError, IdentityMismatch, PreflightRefused.
    """
    units = result.units
    if units.position != axis.position_unit:
        raise UsageError(
            f"the recording is in {units.position} and {units.effort}, axis '{axis.name}' in "
            f"{axis.position_unit} and {axis.effort_unit}: say its mechanics in an axis file"
        )
    with connect(axis, None, desk, "analyze") as drive:
        identity = drive.identity()
        desk.tell(drive_line(identity, drive.profile))
        result = with_proposal(result, drive, fraction)
        result = on_drive(result, axis, drive.link, drive.profile, identity)
        run = begin_run(desk, drive, identity, axis, fraction)
        text = source_of(axis, drive.profile)
        state = axis_state(drive, axis)
    result = ended(replace(result, run=run), desk.journal.history(run), state)
    RunFolder.of(desk.journal, run).save(result, profile=text)
    desk.journal.finish(run, result.status)
    return result
