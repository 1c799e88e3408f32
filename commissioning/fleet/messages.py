"""What a runner and its workers say to each other, one line of JSON each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from commissioning.desk import Options
from commissioning.result.endings import Error
from commissioning.result.fleet import Confirmed, FleetJob, JobState, Outcome, Room

__all__ = ["Looked", "Order", "Report"]


@dataclass(frozen=True, slots=True)
class Order:
    """What a worker is to do.

    Attributes
    ----------
    act : look at the axis, and only that; or do the job, if the ledger grants it
    axis : as JSON
    room : what was confirmed, of which no more is used
    gateway : computer that has its bus; '': this one
    confirmed : by whom, and how
    """

    act: Literal["look", "job"]
    fleet_run: str
    name: str
    attempt: int
    job: FleetJob
    axis: str
    options: Options
    room: Room | None = None
    gateway: str = ""
    confirmed: Confirmed | None = None


@dataclass(frozen=True, slots=True)
class Looked:
    """What a look at an axis has shown.

    Attributes
    ----------
    writes : what the experiment would set, and put back, one line each
    """

    serial: str
    identity: str
    profile: str
    room: Room
    writes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """What a worker tells of its axis.

    Attributes
    ----------
    kind : ready to be ordered about | a line of text | one that people must see | a step begins |
        how the motion goes | what a look has shown | how an order has ended | it was not granted
    state, outcome : of an ended job
    error : of a look that was not to be had
    moving : samples since the last pulse, the drive enabled
    late : share of the cycles that came late
    """

    kind: Literal["ready", "tell", "alarm", "step", "pulse", "looked", "ended", "void"]
    text: str = ""
    step: int = 0
    steps: int = 0
    moving: bool = False
    late: float = 0.0
    looked: Looked | None = None
    error: Error | None = None
    exit_code: int = 0
    state: JobState | None = None
    outcome: Outcome | None = None
