"""What a client and a gateway say to each other: one verb, one request, one answer, as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from commissioning.fleet.messages import Order, Report
from commissioning.result.endings import Error
from commissioning.result.fleet import FleetJob, JobState, Outcome

__all__ = [
    "KINDS",
    "PROTOCOL",
    "Ask",
    "Axes",
    "Chunk",
    "Declined",
    "FarAxis",
    "Going",
    "Greeting",
    "News",
    "Offered",
    "Piece",
    "PutBack",
    "Restore",
    "Since",
    "Start",
    "Started",
    "Stop",
    "Stopped",
    "Which",
    "Wire",
    "Work",
]

PROTOCOL = 1  # of these messages; another one is refused


class Wire(Protocol):
    """A connection to one gateway."""

    async def call(self, verb: str, text: str, seconds: float) -> str:
        """Ask, and wait so long for the answer; raises LinkLost: whether it was heard is open."""

    async def close(self) -> None:
        """Let go of it; what was started on the gateway goes on."""


@dataclass(frozen=True, slots=True)
class Ask:
    """hello: the first word of a client.

    Attributes
    ----------
    below : defaults of its fleet file, as JSON, which an axis file is above
    axes : that it wants to hear of
    """

    protocol: int
    version: str
    below: str = "{}"
    axes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FarAxis:
    """An axis of a gateway, as its file there says.

    Attributes
    ----------
    axis : as JSON; '' where there is an error
    buses : names of its bus on that computer, of which two axes on one bus share one
    stepping : its time is simulated; simulated: its drive is virtual, or on loopback there
    cut_off : run that was cut off on its drive, of which the gateway knows
    """

    name: str
    axis: str = ""
    buses: tuple[str, ...] = ()
    stepping: bool = False
    simulated: bool = False
    cut_off: str | None = None
    error: Error | None = None


@dataclass(frozen=True, slots=True)
class Greeting:
    """What a gateway says of itself; `life` is another one after each of its starts."""

    protocol: int
    version: str
    name: str
    host: str
    life: str
    cores: int


@dataclass(frozen=True, slots=True)
class Axes:
    """A gateway, and the axes that were asked for."""

    gateway: Greeting
    axes: tuple[FarAxis, ...]


@dataclass(frozen=True, slots=True)
class Declined:
    """It was not done, and why; as an error on this computer would be."""

    code: str
    text: str
    exit_code: int
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Work:
    """look: at an axis; what it shows is in the news. offer: the job on it; nothing moves yet.

    Attributes
    ----------
    run : the client's fleet run, as no other client can have it
    order : of a job what was looked at and confirmed
    below : defaults of its fleet file, as JSON
    """

    run: str
    order: Order
    below: str = "{}"


@dataclass(frozen=True, slots=True)
class Offered:
    """The job may be started with this, once, for half a minute, as long as the gateway lives."""

    nonce: str


@dataclass(frozen=True, slots=True)
class Start:
    """start: the job that was offered.

    Attributes
    ----------
    fleet, operator, host : for the ledger there: whose fleet run it is
    """

    nonce: str
    fleet: str = ""
    operator: str = ""
    host: str = ""


@dataclass(frozen=True, slots=True)
class Started:
    """It is granted in the ledger of the gateway, and a process has its order."""

    process: int


@dataclass(frozen=True, slots=True)
class Which:
    """settle: an attempt at an axis. Where it was not started yet it never will be."""

    run: str
    axis: str
    attempt: int
    job: FleetJob = "identify"


@dataclass(frozen=True, slots=True)
class Going:
    """How an attempt stands, by the ledger there; `alive`: a process has the axis."""

    axis: str
    attempt: int
    state: JobState
    alive: bool = False
    outcome: Outcome | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class Stop:
    """stop: what runs of a fleet run, or one axis of it.

    `request` : of people: however often it is sent, a process is told once of each
    """

    run: str
    request: str
    axis: str = ""


@dataclass(frozen=True, slots=True)
class Stopped:
    """Axes whose processes were told to stop."""

    axes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Since:
    """news: what was reported since a number, in this life of the gateway."""

    run: str
    life: str
    number: int


@dataclass(frozen=True, slots=True)
class Piece:
    """What was reported of an axis."""

    number: int
    axis: str
    attempt: int
    report: Report


@dataclass(frozen=True, slots=True)
class News:
    """`life` differs from what was asked: the gateway has ended meanwhile; ask for `settle`."""

    life: str
    number: int
    pieces: tuple[Piece, ...] = ()


@dataclass(frozen=True, slots=True)
class Restore:
    """restore: what a fleet run has left in the drives of these axes, by the journal there.

    Attributes
    ----------
    act : names what would be written, or writes it
    everything : also what was written for good
    force : also over values that somebody changed since
    """

    run: str
    axes: tuple[str, ...]
    act: Literal["show", "do"]
    everything: bool = False
    force: bool = False


@dataclass(frozen=True, slots=True)
class PutBack:
    """What that came to, as 'tworelay fleet restore' there says it."""

    exit_code: int
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Chunk:
    """fetch: bytes of an exported run, from `begin` on, in Base64; all of it are `total`."""

    run: str
    begin: int = 0
    total: int = 0
    data: str = ""


KINDS = {  # what each verb asks with
    "hello": Ask, "look": Work, "offer": Work, "start": Start, "settle": Which, "stop": Stop,
    "news": Since, "fetch": Chunk, "restore": Restore,
}  # fmt: skip
