"""How a fleet run is ended from outside."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from commissioning.fleet.ledger import Ledger, LedgerRow
from commissioning.result.fleet import FleetState, JobState
from drivers.errors import LinkError

__all__ = ["interrupt", "stop_runs"]

_PATIENCE, _LOOK = 15.0, 0.2  # s
_OVER = FleetState.FINISHED, FleetState.STOPPED


def stop_runs(folder: Path, run: str | None, *, drain: bool) -> Iterator[str]:
    """End a run, or all that are under way, and wait until nothing of them moves; says how.

    Raises LinkError where something still does after a while.
    """
    with Ledger(folder, reading=True) as ledger:
        runs = [ledger.record(run)] if run else ledger.live() or [ledger.record("last")]
    for record in runs:
        yield from _stopped(folder, record.id, drain=drain)


def _stopped(folder: Path, run: str, *, drain: bool) -> Iterator[str]:
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
            if row.state is JobState.STARTED:
                yield (
                    f"'{row.axis}': was started, and its process is gone: 'tworelay stop' makes it "
                    "safe, 'tworelay fleet restore' puts its settings back"
                )
        yield f"nothing of fleet run {run} moves"


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
