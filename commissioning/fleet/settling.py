"""Axes that were handed to a gateway: how they stand is what its ledger says."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from commissioning.fleet.ledger import FleetRecord, Ledger, LedgerRow
from commissioning.result.fleet import ENDED, FleetJob, JobState, Outcome
from profiles.errors import Refused, TwoRelayError

__all__ = ["Elsewhere", "Stands", "settle"]


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


class Told(Protocol):
    """Axes whose processes were told to stop."""

    @property
    def axes(self) -> tuple[str, ...]:
        """By name."""


class Elsewhere(Protocol):
    """The gateways of a fleet."""

    def stop(self, gateway: str, key: str) -> Told:
        """Have all stopped that runs there for a fleet run; raises TwoRelayError."""

    def settle(self, gateway: str, key: str, row: LedgerRow, job: FleetJob) -> Stands:
        """How an attempt stands there; not started: it never will be. Raises TwoRelayError."""

    def take_in(self, gateway: str, run: str) -> str:
        """Fetch a run; its id here. Raises TwoRelayError."""


def settle(gateways: Elsewhere | None, ledger: Ledger, record: FleetRecord, row: LedgerRow) -> bool:
    """Write down what a gateway says of an attempt; whether a process there has the axis still."""
    gateway = record.place(row.axis).gateway or ""
    try:
        if gateways is None:
            raise Refused("the fleet file names no gateway any more")
        going = gateways.settle(gateway, record.key, row, record.job)
    except TwoRelayError as error:
        ledger.learn(
            record.id, row.axis, row.attempt, JobState.UNKNOWN, None,
            f"nobody knows how it ended: {error.text}",
        )  # fmt: skip
        return False
    if going.state in ENDED:
        outcome = going.outcome
        if outcome is not None and outcome.run is not None:
            try:
                outcome = replace(outcome, run=gateways.take_in(gateway, outcome.run))
            except (TwoRelayError, OSError) as error:
                why = f"run {outcome.run} stays on gateway '{gateway}': {error}"
                ledger.note(record.id, why, row.axis, row.attempt)
        ledger.learn(record.id, row.axis, row.attempt, going.state, outcome, going.why)
    return going.alive
