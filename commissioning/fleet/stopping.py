"""How a fleet run is ended from outside."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from commissioning.fleet.ledger import Ledger
from commissioning.fleet.rows import FleetRecord, LedgerRow
from commissioning.fleet.settling import Known, Reach, settle
from commissioning.result.fleet import FleetState, JobState
from drivers.errors import LinkError
from profiles.errors import TwoRelayError

__all__ = ["interrupt", "stop_runs"]

_PATIENCE, _LOOK = 15.0, 0.2  # s
_OVER = FleetState.FINISHED, FleetState.STOPPED


def stop_runs(folder: Path, run: str | None, reach: Reach, *, drain: bool) -> Iterator[str]:
    """End a run, or all that are under way, and wait until nothing of them moves; says how.

    `reach` : the gateways of a fleet run, where its runner is gone

    Raises LinkError where something still does after a while.
    """
    with Ledger(folder, reading=True) as ledger:
        runs = [ledger.record(run)] if run else ledger.live() or [ledger.record("last")]
    for record in runs:
        yield from _stopped(folder, record.id, reach, drain=drain)


def _stopped(folder: Path, run: str, reach: Reach, *, drain: bool) -> Iterator[str]:
    with Ledger(folder) as ledger:
        record = ledger.record(run)
        is_led = record.state not in _OVER and record.is_alive
        if is_led:
            ledger.ask(record.id, "drain" if drain else "stop")
            yield f"fleet run {record.id}: its runner (process {record.pid}) is told"
            if drain:
                return
        else:
            yield f"fleet run {record.id}: no runner is under way"
            for row in ledger.rows(record.id).values():
                if row.state is JobState.GRANTED:
                    ledger.revoke(record.id, row.axis, row.attempt, "'tworelay fleet stop'")
            for row in _moving(ledger, record.id):
                yield f"'{row.axis}': its process {row.pid} is told to stop"
                interrupt(row)
            yield from _stopped_elsewhere(ledger, record, reach)
        until = time.monotonic() + _PATIENCE
        while (left := _moving(ledger, record.id)) or (is_led and _goes_on(ledger, record.id)):
            if time.monotonic() > until:
                names = ", ".join(row.axis for row in left) or "its runner"
                raise LinkError(
                    f"still under way: {names}",
                    code="stop.not-verified",
                    hint="'tworelay stop AXIS' stops each, whoever moves it",
                )
            time.sleep(_LOOK)
        for row in ledger.rows(record.id).values():
            if row.state is JobState.STARTED and record.place(row.axis).gateway is None:
                yield (
                    f"'{row.axis}': was started, and its process is gone: 'tworelay stop' makes it "
                    "safe, 'tworelay fleet restore' puts its settings back"
                )
        yield f"nothing of fleet run {run} moves"


def _stopped_elsewhere(ledger: Ledger, record: FleetRecord, reach: Reach) -> Iterator[str]:
    """What was handed to gateways, and has not ended by what is known here."""
    left = [row for row in ledger.rows(record.id).values() if _is_open(record, row)]
    if not left:
        return
    doubts: dict[str, str] = {}  # axis → why
    with reach(record) as gateways:
        told = gateways.stop_all(record.key)
        for name in sorted({record.place(row.axis).gateway or "" for row in left}):
            found = told.get(name, LinkError("it is not known where it is"))
            if isinstance(found, TwoRelayError):
                yield f"gateway '{name}': NOT VERIFIED: the stop is not confirmed ({found.text})"
            else:
                yield f"gateway '{name}': {', '.join(found) or 'nothing is under way'} – confirmed"
        until = time.monotonic() + _PATIENCE
        while left:
            known = {row.axis: settle(gateways, ledger, record, row) for row in left}
            doubts |= {name: "nobody knows" for name, k in known.items() if k is Known.NOT}
            left = [row for row in left if known[row.axis] is Known.MOVES]
            if left and time.monotonic() > until:
                doubts |= {row.axis: "still under way" for row in left}
                break
            time.sleep(_LOOK if left else 0.0)
    if doubts:
        names = ", ".join(f"'{name}' ({why})" for name, why in doubts.items())
        raise LinkError(
            f"NOT VERIFIED that these are at rest: {names}",
            code="stop.not-verified",
            hint="the emergency stop, if something moves; 'tworelay fleet stop' on its gateway",
        )


def _is_open(record: FleetRecord, row: LedgerRow) -> bool:
    """Whether only a gateway knows how an axis stands."""
    is_open = row.state in (JobState.STARTED, JobState.UNKNOWN)
    return is_open and record.place(row.axis).gateway is not None


def _goes_on(ledger: Ledger, run: str) -> bool:
    """Whether its runner has not ended yet."""
    record = ledger.record(run)
    return record.state not in _OVER and record.is_alive


def _moving(ledger: Ledger, run: str) -> list[LedgerRow]:
    return [
        row for row in ledger.rows(run).values()
        if row.state is JobState.STARTED and row.is_alive
    ]  # fmt: skip


def interrupt(row: LedgerRow) -> None:
    """As a Ctrl-C, to a process that the ledger knows to be the one that moves the axis."""
    assert row.pid is not None
    if sys.platform == "win32":
        os.kill(row.pid, signal.CTRL_BREAK_EVENT)
    else:
        os.kill(row.pid, signal.SIGINT)
