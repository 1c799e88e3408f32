"""A fleet run as people and programs are shown it: by its runner, or by the ledger alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from commissioning.fleet.acts import outcome_now
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.plan import Fleet
from commissioning.fleet.rows import FleetRecord, LedgerRow, Place
from commissioning.journal import Journal
from commissioning.result.document import Tool
from commissioning.result.fleet import (
    ENDED,
    FAILED,
    FLEET_SCHEMA,
    FleetAxis,
    FleetResult,
    FleetState,
    JobState,
)
from commissioning.result.words import iso

__all__ = ["by_the_ledger", "not_begun", "view", "ways_on"]

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
    return FleetResult(
        FLEET_SCHEMA, record.id, record.name, record.job, record.file, state or record.state, tool,
        record.host or None, record.operator or None, iso(record.created), iso(record.ended),
        left, rehearsed, tuple(axes), notes,
    )  # fmt: skip


def ways_on(result: FleetResult) -> tuple[str, ...]:
    """What is to be done about axes that are not done, the most urgent first."""
    if result.rehearsed:
        return ("a rehearsal: no drive of the file was touched",)
    again = f"tworelay fleet run {result.file}"
    lines = [
        f"'{one.name}': NOT VERIFIED that it is at rest: look at it, the emergency stop in reach; "
        f"{_stop(one)}, then 'tworelay fleet restore'"
        for one in result.in_doubt
    ]
    if any(one.outcome and not one.outcome.put_back for one in result.axes):
        lines.append("settings are NOT put back: 'tworelay fleet restore' tries again")
    if failed := result.count(*FAILED):
        lines.append(f"{failed} not done: '{again} --again failed' tries again")
    if left := result.count(JobState.PLANNED, JobState.WAITING, JobState.REVOKED):
        lines.append(f"{left} not started: '{again} --resume' goes on")
    if blocked := result.count(JobState.BLOCKED):
        lines.append(f"{blocked} blocked: when what is in the way is done, '{again} --resume'")
    return tuple(lines)


def _stop(one: FleetAxis) -> str:
    if one.gateway is not None:
        return f"'tworelay fleet stop' here, or 'tworelay stop \"{one.link}\"' on {one.gateway}"
    return f"'tworelay stop \"{one.link}\"'"


def not_begun(fleet: Fleet, why: str, tool: Tool | None) -> FleetResult:
    """A fleet run that was refused before there was one."""
    axes = tuple(
        FleetAxis(one.name, JobState.PLANNED, 1, one.link, one.group, one.zone, gateway=one.gateway)
        for one in fleet.axes
    )
    return FleetResult(
        FLEET_SCHEMA, "", fleet.name, fleet.job, str(fleet.path), FleetState.STOPPED, tool,
        rehearsed=fleet.rehearsed, axes=axes, notes=(why,),
    )  # fmt: skip


def by_the_ledger(
    ledger: Ledger, run: str, tool: Tool | None, journal: Journal | None = None,
    moving: Collection[str] = (),
) -> FleetResult:  # fmt: skip
    """A fleet run as its ledger has it now, and its drives by the `journal`.

    `moving` : axes of which their gateways say that they are under way
    """
    record = ledger.record(run)
    rows = ledger.rows(record.id)
    led = record.is_alive
    axes = [
        _axis(row, record.place(row.axis), journal, led=led, moves=row.axis in moving)
        for row in rows.values()
    ]
    over = record.state in (FleetState.FINISHED, FleetState.STOPPED)
    notes: tuple[str, ...] = ()
    state = record.state
    if not over and not record.is_alive:
        state = FleetState.STOPPED
        alive = [row for row in rows.values() if row.state is JobState.STARTED and row.is_alive]
        notes = tuple(
            f"its runner is gone, and process {row.pid} still moves '{row.axis}': wait for it, or "
            "'tworelay fleet stop'"
            for row in alive
        ) or ("its runner is gone",)
        notes += tuple(
            f"'{name}' is under way still on gateway '{record.place(name).gateway}': wait for it, "
            "or 'tworelay fleet stop'"
            for name in moving
        )
    notes = (*notes, *ways_on(view(record, axes, state)))
    return view(record, axes, state, tool, notes=notes, rehearsed=record.rehearsed)


def _axis(
    row: LedgerRow, place: Place, journal: Journal | None, *, led: bool, moves: bool
) -> FleetAxis:
    """`led`: its runner is there, which hears of gateways. `moves`: its gateway says so."""
    state, why = row.state, row.why
    elsewhere = place.gateway is not None
    if moves or (elsewhere and led and state is JobState.STARTED):
        state = JobState.STARTED
    elif state is JobState.STARTED and (elsewhere or not row.is_alive):
        state, why = JobState.UNKNOWN, row.why if elsewhere else _GONE
    outcome = row.outcome
    if outcome is not None and journal is not None and not elsewhere:
        outcome = outcome_now(outcome, journal)
        if row.outcome and row.outcome.written and not outcome.written:
            why = f"{why}; its values were put back since".removeprefix("; ")
    return FleetAxis(
        row.axis, state, row.attempt, place.link, place.group, place.zone,
        row.serial or None, why=why, confirmed=row.confirmed, began=iso(row.began),
        ended=iso(row.at) if state in ENDED else None, outcome=outcome, gateway=place.gateway,
    )  # fmt: skip
