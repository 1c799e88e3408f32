"""What a fleet run is and has come to, typed: the ledger keeps it, screens and files show it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar, Literal

from pydantic import ConfigDict

from commissioning.result.changes import Change, Written
from commissioning.result.document import Tool
from commissioning.result.endings import Error
from commissioning.result.found import Quantity
from commissioning.result.kinds import Count, Finite, Text

__all__ = [
    "ENDED",
    "FAILED",
    "FLEET_SCHEMA",
    "MAY_RESUME",
    "OF_EXIT_CODE",
    "Confirmed",
    "FleetAxis",
    "FleetJob",
    "FleetResult",
    "FleetState",
    "JobState",
    "Outcome",
    "Room",
    "in_doubt",
]

FLEET_SCHEMA: Literal["tworelay.fleet/1"] = "tworelay.fleet/1"
FleetJob = Literal["identify", "commission", "verify"]


class FleetState(StrEnum):
    """Where a fleet run is."""

    CHECKING = "checking"
    RUNNING = "running"
    PAUSED = "paused"
    FINISHED = "finished"
    STOPPED = "stopped"


class JobState(StrEnum):
    """Where the job on one axis is; each is in the ledger before the act that it names."""

    PLANNED = "planned"
    WAITING = "waiting"
    GRANTED = "granted"
    STARTED = "started"
    DONE = "done"
    NOT_HELPED = "not-helped"
    REJECTED = "rejected"
    REFUSED = "refused"
    FAULT = "fault"
    LINK = "link"
    WRITE_INCOMPLETE = "write-incomplete"
    STOPPED = "stopped"
    UNKNOWN = "unknown"  # started, and nobody knows how it ended
    REVOKED = "revoked"  # granted, and taken back before it started
    BLOCKED = "blocked"
    SKIPPED = "skipped"


FAILED = frozenset(
    {
        JobState.NOT_HELPED, JobState.REJECTED, JobState.REFUSED, JobState.FAULT, JobState.LINK,
        JobState.WRITE_INCOMPLETE, JobState.STOPPED, JobState.UNKNOWN,
    }
)  # fmt: skip
MAY_RESUME = frozenset({JobState.PLANNED, JobState.WAITING, JobState.BLOCKED, JobState.REVOKED})
ENDED = FAILED | {JobState.DONE, JobState.BLOCKED, JobState.SKIPPED, JobState.REVOKED}
OF_EXIT_CODE = {
    0: JobState.DONE, 2: JobState.REFUSED, 3: JobState.REFUSED, 4: JobState.LINK,
    5: JobState.FAULT, 6: JobState.REJECTED, 7: JobState.WRITE_INCOMPLETE, 8: JobState.NOT_HELPED,
    130: JobState.STOPPED, 143: JobState.STOPPED, 129: JobState.STOPPED,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Room:
    """What an axis may use of its travel, torque and speed; half-widths about where it stands.

    Attributes
    ----------
    travel, torque, speed : rad or m, N.m or N, rad/s or m/s
    """

    travel: Finite
    torque: Finite
    speed: Finite
    position_unit: Literal["rad", "m"] = "rad"
    effort_unit: Text = "N.m"


@dataclass(frozen=True, slots=True)
class Confirmed:
    """Who let an axis move, and how far.

    Attributes
    ----------
    how : a typed word, or in advance: on the command line and in the file
    """

    by: Text
    at: Text
    how: Text
    room: Room


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a job on one axis came to.

    Attributes
    ----------
    run : of the journal; None where none was begun
    verdict : of the measurement, in words
    changes : what was proposed; `written`: what of it, or before it, is in the drive at the end
    before, after : error after reversals, peak, in `position_unit`; None: not proved
    percent : by how much it has fallen
    ending : the line of truth: axis, settings, what is in the drive
    put_back : the experiment's settings are, or none were changed
    at_rest : the axis was seen at rest and off, or held by its brake; or was never moved
    remark : what else there is to say of a job that is done
    seconds : of the job
    sha256 : of the run's result file
    """

    run: Text | None = None
    profile: Text | None = None
    verdict: Text | None = None
    coulomb: Quantity | None = None
    offset: Quantity | None = None
    viscous: Quantity | None = None
    inertia: Quantity | None = None
    changes: tuple[Change, ...] = ()
    written: tuple[Written, ...] = ()
    position_unit: Literal["rad", "m"] = "rad"
    before: Finite | None = None
    after: Finite | None = None
    percent: Finite | None = None
    ending: Text = ""
    put_back: bool = True
    at_rest: bool = False
    error: Error | None = None
    remark: Text = ""
    seconds: Finite = 0.0
    sha256: Text | None = None

    def in_drive(self, change: Change) -> Written | None:
        """What the drive has of a change, at the end; None: what it had before."""
        return next((one for one in self.written if one.parameter == change.parameter), None)


def in_doubt(state: JobState, outcome: Outcome | None) -> bool:
    """Whether nobody knows that an axis that was started is at rest."""
    if state is JobState.UNKNOWN:
        return True
    return state in FAILED and outcome is not None and not outcome.at_rest


@dataclass(frozen=True, slots=True)
class FleetAxis:
    """One axis of a fleet run.

    Attributes
    ----------
    step, steps : the step of the job that is under way, from 1, and how many there are
    doing : what happens in it
    why : why it is not done, in one line; '' where it is, or is still to be
    gateway : computer on which its link is; None: the fleet run's own
    """

    name: Text
    state: JobState
    attempt: Count
    link: Text
    group: Text | None = None
    zone: Text | None = None
    serial: Text | None = None
    step: Count = 0
    steps: Count = 0
    doing: Text = ""
    why: Text = ""
    confirmed: Confirmed | None = None
    began: Text | None = None
    ended: Text | None = None
    outcome: Outcome | None = None
    gateway: Text | None = None

    @property
    def where(self) -> str:
        """Its link, and on which computer that is."""
        return f"{self.gateway}: {self.link}" if self.gateway else self.link

    @property
    def what(self) -> str:
        """What happens to it; or how it stands, where it was begun in vain, and why."""
        if self.doing:
            return self.doing
        begun = self.state in FAILED and self.outcome is not None and self.outcome.run is not None
        stands = self.outcome.ending.partition(";")[0] if begun and self.outcome else ""
        return "; ".join(filter(None, (stands, self.why)))


@dataclass(frozen=True, slots=True)
class FleetResult:
    """A fleet run as it is now.

    Attributes
    ----------
    left : s until all is done, as far as it can be known; None: nothing is under way
    rehearsed : on twins, not on the drives of the file
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        strict=True, extra="ignore", allow_inf_nan=False
    )

    schema: Literal["tworelay.fleet/1"]
    fleet_run: Text
    name: Text
    job: FleetJob
    file: Text
    state: FleetState
    tool: Tool | None = None
    host: Text | None = None
    operator: Text | None = None
    began: Text | None = None
    ended: Text | None = None
    left: Finite | None = None
    rehearsed: bool = False
    axes: tuple[FleetAxis, ...] = ()
    notes: tuple[Text, ...] = field(default=())

    def count(self, *states: JobState) -> int:
        """How many axes are in one of these states."""
        return sum(axis.state in states for axis in self.axes)

    @property
    def in_doubt(self) -> tuple[FleetAxis, ...]:
        """Axes of which nobody knows that they are at rest."""
        return tuple(one for one in self.axes if in_doubt(one.state, one.outcome))

    @property
    def exit_code(self) -> int:
        """0: all that were to be done are; 9: some are not."""
        return 0 if self.count(JobState.DONE, JobState.SKIPPED) == len(self.axes) else 9
