"""What commands beside a run ask its gateways for: how axes stand, a stop, old values back."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path

from commissioning.fleet.gateway.gateways import Gateways
from commissioning.fleet.gateway.messages import PutBack, Restore
from commissioning.fleet.ledger import FleetRecord, Ledger
from commissioning.fleet.loading import load_fleet
from commissioning.fleet.running import met
from commissioning.fleet.settling import settle
from commissioning.result.fleet import JobState
from drivers.home import home
from profiles.errors import Refused, TwoRelayError

__all__ = ["bring_up_to_date", "on_gateways", "put_back_on", "reach"]

_OPEN = JobState.STARTED, JobState.UNKNOWN


@contextlib.contextmanager
def reach(record: FleetRecord) -> Generator[Gateways]:
    """The gateways of the file of a fleet run; raises UsageError, Refused."""
    fleet = load_fleet(Path(record.file))
    with met(fleet, lambda _: None) as (_, gateways):
        if gateways is None:
            raise Refused(f"{record.file} names no gateway any more", code="gateway.gone")
        yield gateways


def bring_up_to_date(run: str) -> Iterator[str]:
    """Ask the gateways about axes of which nobody here knows how they ended; says what is left."""
    with Ledger(home(), reading=True) as ledger:
        record = ledger.record(run)
        left = [row for row in ledger.rows(record.id).values() if row.state in _OPEN]
        left = [row for row in left if record.place(row.axis).gateway is not None]
        if not left or record.is_alive:
            return
    try:
        with reach(record) as gateways, Ledger(home()) as ledger:
            for row in left:
                if settle(gateways, ledger, record, row):
                    yield (
                        f"'{row.axis}' is under way still on gateway "
                        f"'{record.place(row.axis).gateway}': 'tworelay fleet stop' stops it"
                    )
    except TwoRelayError as error:
        yield f"its gateways could not be asked: {error}"


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


def put_back_on(gateways: Gateways, gateway: str, asked: Restore) -> PutBack:
    """What a fleet run has left on one gateway, shown or put back; what it cannot is told."""
    try:
        return gateways.restore(gateway, asked)
    except TwoRelayError as error:
        return PutBack(error.exit_code, (str(error),))
