"""RUN as the user names it, and the axis that it was on."""

from __future__ import annotations

from pathlib import Path

from commissioning.desk import Desk
from commissioning.journal import Journal, RunRecord
from commissioning.runs import RunFolder, resolve
from drivers.link import check_files_of_others
from profiles.axis import Axis
from profiles.errors import Refused, UsageError
from profiles.library import builtin_names

__all__ = ["axis_of_run", "own_run", "resolve_any"]


def axis_of_run(record: RunRecord, folder: RunFolder, link: str | None) -> Axis:
    """The axis of a run, on its own link or another, with the profile as it was in the run.

    Raises UsageError, Refused.
    """
    try:
        axis = Axis.model_validate_json(record.context.axis)
    except ValueError as error:
        raise UsageError(f"run {record.id}: its axis cannot be read ({error})") from None
    if link is None and record.adopted:
        check_files_of_others(record.link)
    profile = folder.profile_path()
    if record.adopted and not profile.exists() and record.profile not in builtin_names():
        raise UsageError(f"run {record.id}: the profile of its drive is missing")
    return axis.model_copy(
        update={
            "link": link or record.link,
            "profile": str(profile) if profile.exists() else record.profile,
        }
    )


def own_run(journal: Journal, run: str) -> tuple[str, RunFolder]:
    """RUN → its id and folder, to be acted on: an exported run is taken in first.

    Raises Refused.
    """
    run_id, folder = resolve(journal, run)
    if folder.exported is None:
        return run_id, folder
    if journal.knows(run_id):
        raise Refused(
            f"{run} is an exported run: adopt it first, or name run {run_id}, which is known here",
            code="run.exported",
        )
    raise Refused(
        f"{run} is an exported run: adopt it first ('tworelay adopt {run}')", code="run.exported"
    )


def resolve_any(desk: Desk, run: str) -> tuple[str, RunFolder]:
    """Like `resolve`, but a run killed before it wrote files is good enough to restore."""
    if Path(run).is_dir():
        return own_run(desk.journal, run)
    record = desk.journal.run(run)
    return record.id, RunFolder.of(desk.journal, record.id)
