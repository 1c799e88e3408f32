"""How a fleet run is ended from outside."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from commissioning.fleet.ledger import FleetRecord, Ledger, LedgerRow
from commissioning.fleet.settling import Elsewhere, settle
from commissioning.result.fleet import FleetState, JobState
from drivers.errors import LinkError
from profiles.errors import TwoRelayError

__all__ = ["Reach", "interrupt", "stop_runs"]

_PATIENCE, _LOOK = 15.0, 0.2  # s
Reach = Callable[[FleetRecord], AbstractContextManager[Elsewhere]]
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
    open_ = [row for row in ledger.rows(record.id).values() if _is_open(record, row)]
    if not open_:
        return
    with reach(record) as gateways:
        for name in sorted({record.place(row.axis).gateway or "" for row in open_}):
            try:
                told = gateways.stop(name, record.key).axes
            except TwoRelayError as error:
                raise LinkError(
                    f"NOT VERIFIED: gateway '{name}' has not confirmed the stop ({error.text})",
                    code="stop.not-verified",
                    hint="the emergency stop, if something moves; or 'tworelay fleet stop' there",
                ) from None
            yield f"gateway '{name}': {', '.join(told) or 'nothing of it is under way'} – confirmed"
        until = time.monotonic() + _PATIENCE
        while left := [row.axis for row in open_ if settle(gateways, ledger, record, row)]:
            if time.monotonic() > until:
                raise LinkError(f"still under way: {', '.join(left)}", code="stop.not-verified")
            open_ = [row for row in open_ if row.axis in left]
            time.sleep(_LOOK)


def _is_open(record: FleetRecord, row: LedgerRow) -> bool:
    """Whether only a gateway knows how an axis stands."""
    of_gateway = record.place(row.axis).gateway is not None
    return of_gateway and row.state in (JobState.STARTED, JobState.UNKNOWN)


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
