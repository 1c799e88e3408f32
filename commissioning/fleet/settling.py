"""Axes that were handed to a gateway: how they stand is what its ledger says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from enum import Enum
from typing import Protocol

from commissioning.fleet.ledger import Ledger
from commissioning.fleet.rows import FleetRecord, LedgerRow
from commissioning.result.changes import Written
from commissioning.result.fleet import FleetJob, JobState, Outcome, in_doubt
from profiles.errors import TwoRelayError

__all__ = ["ON_GATEWAY", "Elsewhere", "Known", "Reach", "Stands", "fetch", "settle"]

ON_GATEWAY = "stays on gateway"  # said of a run that was not fetched


class Stands(Protocol):
    """How an attempt stands; `alive`: a process has the axis."""

    @property
    def state(self) -> JobState:
        """By the ledger there."""

    @property
    def alive(self) -> bool:
        """Whether it goes on."""

    @property
    def outcome(self) -> Outcome | None:
        """What it came to."""

    @property
    def why(self) -> str:
        """Why it is not done."""


class Elsewhere(Protocol):
    """The gateways of a fleet run."""

    def meet(self) -> object:
        """Greet each; one that cannot be had raises when it is asked."""

    def stop_all(self, key: str) -> Mapping[str, tuple[str, ...] | TwoRelayError]:
        """Have all stopped that runs for a fleet run.

        By gateway, which axes were told, or why nobody knows; none waits for another.
        """

    def settle(self, gateway: str, key: str, row: LedgerRow, job: FleetJob) -> Stands:
        """How an attempt stands there; not started: it never will be. Raises TwoRelayError."""

    def take_in(self, gateway: str, run: str, written: tuple[Written, ...]) -> str:
        """Fetch a run, which has `written` so much; its id here. Raises TwoRelayError."""


Reach = Callable[[FleetRecord], AbstractContextManager[Elsewhere]]  # of the file as it was begun


class Known(Enum):
    """What is known of an axis on another computer."""

    MOVES = 1
    RESTS = 2  # or never moved
    NOT = 3


def settle(gateways: Elsewhere, ledger: Ledger, record: FleetRecord, row: LedgerRow) -> Known:
    """Ask how an attempt stands, and write it down."""
    gateway = record.place(row.axis).gateway or ""
    of_it = record.id, row.axis, row.attempt
    try:
        going = gateways.settle(gateway, record.key, row, record.job)
    except TwoRelayError as error:
        ledger.learn(*of_it, JobState.UNKNOWN, None, f"nobody knows how it ended: {error.text}")
        return Known.NOT
    if going.alive:
        return Known.MOVES
    ledger.learn(*of_it, going.state, going.outcome, going.why)
    fetch(gateways, ledger, record, replace(row, outcome=going.outcome))
    return Known.NOT if in_doubt(going.state, going.outcome) else Known.RESTS


def fetch(gateways: Elsewhere, ledger: Ledger, record: FleetRecord, row: LedgerRow) -> None:
    """Take in the run of an attempt that has ended, if it has one; what cannot be is noted."""
    outcome = row.outcome
    if outcome is None or outcome.run is None:
        return
    gateway = record.place(row.axis).gateway or ""
    try:
        here = gateways.take_in(gateway, outcome.run, outcome.written)
    except (TwoRelayError, OSError) as error:
        why = f"{ON_GATEWAY} '{gateway}': {error}"
        ledger.note(record.id, f"run {outcome.run} {why}", row.axis, row.attempt)
        return
    remarks = [part for part in outcome.remark.split("; ") if ON_GATEWAY not in part]
    outcome = replace(outcome, run=here, remark="; ".join(filter(None, remarks)))
    ledger.fetched(record.id, row.axis, row.attempt, outcome)
