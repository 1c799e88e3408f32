"""Putting back what a fleet run has left: what was cut off, or all that was written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from commissioning.fleet.ledger import Ledger
from commissioning.fleet.rows import LedgerRow
from commissioning.journal import Journal
from commissioning.processes import is_alive
from commissioning.result.fleet import JobState
from drivers.places import same_place
from profiles.errors import Refused, UnknownName

__all__ = ["Left", "left_by"]

_CUT_OFF = JobState.UNKNOWN, JobState.STARTED


@dataclass(frozen=True, slots=True)
class Left:
    """A run of the journal that has left something in the drive of an axis."""

    axis: str
    run: str


def left_by(
    ledger: Ledger, journal: Journal, run: str, axes: Sequence[str], *, everything: bool
) -> list[Left]:
    """The runs to be restored, the last first.

    Parameters
    ----------
    axes : of these, all that was written; none: of every axis what was cut off
    everything : of every axis all that was written
    """
    record = ledger.record(run)
    attempts = ledger.attempts(record.id)
    known = list(dict.fromkeys(row.axis for row in attempts))
    for row in attempts:
        if row.state is JobState.STARTED and row.is_alive:
            raise Refused(
                f"axis '{row.axis}' of fleet run {record.id} is still under way (process "
                f"{row.pid})",
                code="run.in-progress",
                hint="wait for it, or 'tworelay fleet stop'",
            )
    for name in axes:
        if name not in known:
            raise UnknownName(f"axis of fleet run {record.id}", name, known)
    found: dict[str, Left] = {}
    for row in reversed(attempts):
        if (axes and row.axis not in axes) or record.place(row.axis).gateway is not None:
            continue  # another computer has its drive, and what it has left there
        written = everything or bool(axes)
        for one in _runs_of(row, journal, others=not written):
            whole = written or row.state in _CUT_OFF
            intents = journal.intents(one, open_only=True)
            if any(whole or not intent.lasts for intent in intents):
                found.setdefault(one, Left(row.axis, one))
    return list(found.values())


def _runs_of(row: LedgerRow, journal: Journal, *, others: bool) -> list[str]:
    """Of an attempt, by its outcome or its process; `others`: all that was cut off on its drive."""
    found = [row.run] if row.run else []
    on_drive = journal.on_drive(row.serial) if row.serial else []
    for one in reversed(on_drive):
        of_process = (
            row.pid is not None and one.context.pid == row.pid and one.axis == row.axis
            and one.context.started == row.started
        )  # fmt: skip
        if of_process and not is_alive(one.context.pid, one.context.started):
            found.append(one.id)
    if row.serial and others:
        link = on_drive[-1].link if on_drive else ""
        found += journal.unfinished(row.serial, lambda other: same_place(other, link))
    return list(dict.fromkeys(found))
