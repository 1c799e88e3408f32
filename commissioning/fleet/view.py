"""A fleet run as people and programs are shown it: by its runner, or by the ledger alone."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from commissioning.fleet.ledger import FleetRecord, Ledger, LedgerRow, Place
from commissioning.fleet.plan import Fleet
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

__all__ = ["by_the_ledger", "iso", "not_begun", "view"]

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


def not_begun(fleet: Fleet, why: str, tool: Tool | None) -> FleetResult:
    """A fleet run that was refused before there was one."""
    axes = tuple(
        FleetAxis(one.name, JobState.PLANNED, 1, one.link, one.group, one.zone)
        for one in fleet.axes
    )
    return FleetResult(
        FLEET_SCHEMA, "", fleet.name, fleet.job, str(fleet.path), FleetState.STOPPED, tool,
        rehearsed=fleet.rehearsed, axes=axes, notes=(why,),
    )  # fmt: skip


def by_the_ledger(ledger: Ledger, run: str, tool: Tool | None) -> FleetResult:
    """A fleet run as its ledger has it now; nothing is changed there."""
    record = ledger.record(run)
    rows = ledger.rows(record.id)
    axes = [_axis(row, record.place(row.axis)) for row in rows.values()]
    over = record.state in (FleetState.FINISHED, FleetState.STOPPED)
    notes: tuple[str, ...] = ()
    state = record.state
    if not over and not record.is_alive:
        state = FleetState.STOPPED
        moving = [row for row in rows.values() if row.state is JobState.STARTED and row.is_alive]
        notes = tuple(
            f"its runner is gone, and process {row.pid} still moves '{row.axis}': wait for it, or "
            "'tworelay fleet stop'"
            for row in moving
        ) or (_ABANDONED,)
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
