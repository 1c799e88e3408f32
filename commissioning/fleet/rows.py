"""What stands in the ledger of fleet runs: a run, and an attempt at one axis of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from commissioning.journal_file import slug
from commissioning.processes import boot, is_alive
from commissioning.result.fleet import Confirmed, FleetJob, FleetState, JobState, Outcome
from commissioning.result.fleet_codec import of_json

__all__ = ["WHOSE", "FleetRecord", "LedgerRow", "Place", "Whose", "row_of"]


class Place(NamedTuple):
    """Where an axis is; `gateway`: the computer that has its bus, None: this one."""

    link: str
    group: str | None
    zone: str | None
    gateway: str | None


class Whose(NamedTuple):
    """Whose fleet run moves axes of a gateway: its file, its computer, and who sits there."""

    fleet: str
    host: str
    operator: str


WHOSE = Whose("", "", "")


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """One fleet run, as it was begun.

    Attributes
    ----------
    created, ended : s since 1970
    definition : of the fleet file, as JSON
    request : what `fleet stop` asks of the runner: '', 'drain' or 'stop'
    """

    id: str
    created: float
    name: str
    file: str
    job: FleetJob
    definition: str
    state: FleetState
    host: str
    operator: str
    pid: int
    started: float
    boot: str
    ended: float | None
    request: str

    def place(self, axis: str) -> Place:
        """Where an axis is, by the file."""
        tree = _tree(self.definition)
        said = {**tree["axes"].get(axis, {}), **tree.get("told", {}).get(axis, {})}
        return Place(said.get("link", ""), said.get("group"), said.get("zone"), said.get("gateway"))

    @property
    def gateways(self) -> Mapping[str, Mapping[str, str | None]]:
        """As the file had them: address and keys, by name."""
        found: Mapping[str, Mapping[str, str | None]] = _tree(self.definition).get("gateways", {})
        return found

    @property
    def key(self) -> str:
        """What it is called on other computers, whose fleet runs have ids of their own."""
        return f"{self.id}@{slug(self.host)}-{self.created * 1e6:.0f}"

    @property
    def rehearsed(self) -> bool:
        """Whether its drives were twins."""
        return bool(json.loads(self.definition).get("rehearsed"))

    @property
    def is_alive(self) -> bool:
        """Whether its runner runs."""
        return self.boot == boot() and is_alive(self.pid, self.started)


@lru_cache(4)
def _tree(definition: str) -> Any:
    return json.loads(definition)


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """One attempt at one axis.

    `at`: of its last transition, `began`: of its grant, s since 1970.
    """

    axis: str
    attempt: int
    state: JobState
    at: float
    serial: str | None = None
    run: str | None = None
    pid: int | None = None
    started: float | None = None
    boot: str | None = None
    confirmed: Confirmed | None = None
    outcome: Outcome | None = None
    why: str = ""
    began: float | None = None

    @property
    def is_alive(self) -> bool:
        """Whether the process that moves the axis runs."""
        return self.boot == boot() and is_alive(self.pid, self.started)


def row_of(row: dict[str, Any]) -> LedgerRow:
    """A row as it must be; raises ValueError, TypeError."""
    row.pop("fleet_run")
    row["state"] = JobState(row["state"])
    if row["confirmed"] is not None:
        row["confirmed"] = of_json(row["confirmed"], Confirmed)
    if row["outcome"] is not None:
        row["outcome"] = of_json(row["outcome"], Outcome)
    return LedgerRow(**row)
