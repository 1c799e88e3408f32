"""Old runs give their room back. What was done to which drive stays in the journal."""

from __future__ import annotations

import contextlib
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from commissioning.desk import Desk
from commissioning.errors import JournalError
from commissioning.processes import is_alive
from commissioning.runs import RunFolder
from profiles.errors import UsageError

__all__ = ["Pruned", "prune"]


@dataclass(frozen=True, slots=True)
class Pruned:
    """Runs whose files go, or went, and those that are left though they are as old.

    Attributes
    ----------
    runs : ids, the oldest first
    size : bytes of their files
    kept : ids of runs that have something to restore, are in progress, or lie elsewhere
    """

    runs: tuple[str, ...]
    size: int
    kept: tuple[str, ...]


def _size(folder: Path) -> int | None:
    """Bytes of a run's files; None where there are none. Raises OSError."""
    if not folder.is_dir():
        return None
    return sum(path.lstat().st_size for path in folder.rglob("*"))


def _keep_numbers(run: str, desk: Desk) -> None:
    """The index has what the run measured, before its files go."""
    with contextlib.suppress(UsageError):
        desk.journal.index(run, RunFolder.of(desk.journal, run).result())


def prune(before: float, desk: Desk, *, dry_run: bool) -> Pruned:
    """Delete the files of runs that began before an instant (s since 1970), once that is agreed.

    A run with anything to restore keeps its files: its profile is what restores it. Raises Refused,
    JournalError.
    """
    waiting = set(desk.journal.open_runs(adopted=True))
    runs: list[str] = []
    kept: list[str] = []
    size = 0
    for record in desk.journal.runs_before(before):
        try:
            folder = RunFolder.of(desk.journal, record.id)
            used = _size(folder.path)
        except (UsageError, OSError):  # somebody put it elsewhere
            kept.append(record.id)
            continue
        if used is None:
            continue
        context = record.context
        in_progress = record.status == "running" and is_alive(context.pid, context.started)
        if record.id in waiting or in_progress:
            kept.append(record.id)
            continue
        runs.append(record.id)
        size += used
    found = Pruned(tuple(runs), size, tuple(kept))
    if not runs or dry_run:
        return found
    day = time.strftime("%Y-%m-%d", time.localtime(before))
    desk.agree(
        f"The files of {len(runs)} run(s) before {day} ({size / 1e6:.1f} MB: samples, results, "
        "reports) will be DELETED; what they wrote to their drives stays in the journal.",
        "delete",
        "nothing was deleted",
    )
    for run in runs:
        _keep_numbers(run, desk)
        try:
            shutil.rmtree(RunFolder.of(desk.journal, run).path)
        except OSError as error:
            raise JournalError(
                f"the files of run {run} cannot be deleted: {error.strerror or error}; those of "
                "older runs are gone"
            ) from None
        desk.journal.note(run, "files deleted")
    return found
