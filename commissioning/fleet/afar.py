"""What commands beside a run ask its gateways for: how axes stand, a stop, old values back."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

from commissioning.fleet.gateway.gateways import Gateways
from commissioning.fleet.gateway.messages import PutBack, Restore
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.rows import FleetRecord, LedgerRow
from commissioning.fleet.running import reach
from commissioning.fleet.settling import ON_GATEWAY, Known, fetch, settle
from commissioning.result.fleet import FleetState, JobState
from drivers.home import home
from profiles.errors import TwoRelayError

__all__ = ["bring_up_to_date", "note_put_back", "on_gateways", "put_back_on", "reach"]

_OVER = FleetState.FINISHED, FleetState.STOPPED
_OPEN = JobState.STARTED, JobState.UNKNOWN


def bring_up_to_date(run: str) -> tuple[str, ...]:
    """Ask the gateways about axes of which nobody here knows how they ended, and for their runs.

    Returns axes that are under way there; tells nothing where they cannot be asked, for the ledger
    says then that nobody knows.
    """
    with Ledger(home(), reading=True) as ledger:
        record = ledger.record(run)
        if record.is_alive and record.state not in _OVER:
            return ()
        rows = [row for row in ledger.rows(record.id).values() if _is_left(row)]
        left = [row for row in rows if record.place(row.axis).gateway is not None]
    if not left:
        return ()
    with reach(record) as gateways, Ledger(home()) as ledger:
        gateways.meet()
        moving = []
        for row in left:
            if row.state not in _OPEN:
                fetch(gateways, ledger, record, row)
            elif settle(gateways, ledger, record, row) is Known.MOVES:
                moving.append(row.axis)
        return tuple(moving)


def _is_left(row: LedgerRow) -> bool:
    """Whether a gateway may know more of an attempt, or have its run still."""
    return row.state in _OPEN or (row.outcome is not None and ON_GATEWAY in row.outcome.remark)


def on_gateways(record: FleetRecord, ledger: Ledger, axes: Sequence[str]) -> dict[str, list[str]]:
    """Axes of a fleet run that were begun on gateways, by the name of each; all, or these."""
    found: dict[str, list[str]] = {}
    for row in ledger.attempts(record.id):
        gateway = record.place(row.axis).gateway
        if gateway is not None and row.began is not None and row.axis in (axes or (row.axis,)):
            names = found.setdefault(gateway, [])
            if row.axis not in names:
                names.append(row.axis)
    return found


def note_put_back(gateways: Gateways, record: FleetRecord, axes: Sequence[str]) -> None:
    """Write down what the drives of these have now, as their gateways say."""
    with Ledger(home()) as ledger:
        for row in ledger.rows(record.id).values():
            gateway = record.place(row.axis).gateway
            if row.axis not in axes or gateway is None or row.outcome is None:
                continue
            with contextlib.suppress(TwoRelayError):
                now = gateways.settle(gateway, record.key, row, record.job).outcome
                if now is None:
                    continue
                remark = row.outcome.remark
                if row.outcome.written and not now.written:
                    remark = "; ".join(filter(None, (remark, "its values were put back since")))
                now = replace(now, run=row.outcome.run, remark=remark, sha256=row.outcome.sha256)
                ledger.fetched(record.id, row.axis, row.attempt, now)


def put_back_on(gateways: Gateways, gateway: str, asked: Restore) -> PutBack:
    """What a fleet run has left on one gateway, shown or put back; what it cannot is told."""
    try:
        return gateways.restore(gateway, asked)
    except TwoRelayError as error:
        return PutBack(error.exit_code, (str(error),))
