"""A fleet run as people and programs are shown it: by its runner, or by the ledger alone."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from commissioning.fleet.ledger import FleetRecord, Ledger, LedgerRow, Place
from commissioning.result.document import Tool
from commissioning.result.fleet import (
    ENDED,
    FLEET_SCHEMA,
    FleetAxis,
    FleetJob,
    FleetResult,
    FleetState,
    JobState,
)

__all__ = ["by_the_ledger", "iso", "view"]

_ABANDONED = (
    "its runner is gone: 'tworelay fleet run FLEET --resume' goes on, 'tworelay fleet restore' "
    "finishes what was cut off"
)
_GONE = "it was started, and its process is gone"


def view(
    record: FleetRecord,
    axes: Sequence[FleetAxis],
    state: FleetState | None = None,
    tool: Tool | None = None,
    left: float | None = None,
    notes: tuple[str, ...] = (),
    *,
    rehearsed: bool = False,
) -> FleetResult:
    """A fleet run with its axes."""
    job: FleetJob = record.job  # type: ignore[assignment]
    return FleetResult(
        FLEET_SCHEMA, record.id, record.name, job, record.file, state or record.state, tool,
        record.host or None, record.operator or None, iso(record.created), iso(record.ended),
        left, rehearsed, tuple(axes), notes,
    )  # fmt: skip


def by_the_ledger(ledger: Ledger, run: str, tool: Tool | None) -> FleetResult:
    """A fleet run as its ledger has it now; nothing is changed there."""
    record = ledger.record(run)
    axes = [_axis(row, record.place(row.axis)) for row in ledger.rows(record.id).values()]
    over = record.state in (FleetState.FINISHED, FleetState.STOPPED)
    notes: tuple[str, ...] = ()
    state = record.state
    if not over and not record.is_alive:
        state = FleetState.STOPPED
        notes = (_ABANDONED,)
    return view(record, axes, state, tool, notes=notes, rehearsed=record.rehearsed)


def _axis(row: LedgerRow, place: Place) -> FleetAxis:
    state, why = row.state, row.why
    if state is JobState.STARTED and not row.is_alive:
        state, why = JobState.UNKNOWN, _GONE
    return FleetAxis(
        row.axis, state, row.attempt, place.link, place.group, place.zone,
        row.serial or None, why=why, confirmed=row.confirmed, began=iso(row.began),
        ended=iso(row.at) if state in ENDED else None, outcome=row.outcome,
    )  # fmt: skip


def iso(instant: float | None) -> str | None:
    """ISO 8601, with the zone of this computer."""
    if instant is None:
        return None
    return datetime.fromtimestamp(instant).astimezone().isoformat(timespec="seconds")
