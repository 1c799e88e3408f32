"""What every job needs beside the drive: the journal, the signals, and somebody to talk to."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator
from dataclasses import dataclass

from commissioning.errors import Interrupted
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.ownership import announce, owned
from commissioning.processes import is_alive, this_process
from commissioning.records import RunContext
from commissioning.runner import Recorder
from commissioning.watching import NOBODY, Telling, Watcher
from drivers.drive import Drive
from drivers.link import open_drive
from drivers.link_text import is_simulated
from drivers.places import same_place
from profiles.axis import Axis
from profiles.errors import IdentityMismatch, Refused
from profiles.identity import NO_SERIAL, Identity
from profiles.library import digest
from profiles.schema import Profile

__all__ = ["Desk", "Options", "begin_run", "connect", "none_unfinished", "same_drive"]


@dataclass(frozen=True, slots=True)
class Options:
    """What the user asks for; None: take the axis', the drive's or the product's own.

    `writes`: what is found will be written at once, and with `ask_each` agreed to on its own.
    `serial`: which drive it has to be.
    `motor_temperature`: °C, where the drive tells none.
    """

    travel: float | None = None
    max_torque: float | None = None
    max_speed: float | None = None
    duration: float | None = None
    fraction: float = 0.85
    method: str = "auto"
    precision: float = 0.01
    solver: str = "bracket"
    repeat: int = 1
    points: bool = False
    output_filter: float | None = None
    cycle: float | None = None
    without_watchdog: bool = False
    dry_run: bool = False
    writes: bool = False
    ask_each: bool = False
    serial: str | None = None
    motor_temperature: float | None = None


@dataclass
class Desk:
    """Journal, signals, and the conversation.

    Attributes
    ----------
    tell : one line for people about what happens
    done : the last act came to its end, and its run says so
    recorder : of what moves, or moved last
    watcher : shown how the job goes on; default: `tell` has a line of each phase
    confirm : (question, word to be typed) → whether it was typed; raises Refused without a terminal
    """

    journal: Journal
    interruption: Interruption
    tell: Callable[[str], None]
    confirm: Callable[[str, str], bool]
    trace: Callable[..., None] | None = None
    done: bool = False
    recorder: Recorder | None = None
    watcher: Watcher = NOBODY

    def __post_init__(self) -> None:
        if self.watcher is NOBODY:
            self.watcher = Telling(self.tell)

    def record(self) -> Recorder:
        """A recorder of what is to move now, which is watched."""
        self.recorder = Recorder(watcher=self.watcher)
        return self.recorder

    @contextlib.contextmanager
    def finishing(self) -> Generator[None]:
        """What is begun is done, and noted, before a signal ends it.

        One that comes late undoes nothing.
        """
        self.done = False
        try:
            with self.interruption.deferred():
                yield
                self.done = True
        except Interrupted as late:
            late.noted = late.noted or self.done
            raise

    def agree(self, question: str, word: str, undone: str = "nothing was written") -> None:
        """Ask; raises Refused when the answer is no. `undone`: what has not happened then."""
        if not self.confirm(question, word):
            raise Refused(f"not confirmed: {undone}", code="refused.not-confirmed")


def begin_run(desk: Desk, drive: Drive, identity: Identity, axis: Axis, fraction: float) -> str:
    """Open a run of the journal on a connected drive; return its id."""
    profile = drive.profile
    run = desk.journal.begin(
        axis=axis.name,
        link=drive.link,
        profile=profile.name,
        profile_hash=digest(profile),
        serial=identity.serial,
        context=RunContext(axis.as_said(), fraction, **this_process()),
    )
    announce(f"run {run}")
    return run


def drive_line(identity: Identity, profile: Profile) -> str:
    """Which drive it is, and by which profile, for people."""
    return f"drive: {identity}; profile {profile.name} {profile.version}"


def none_unfinished(desk: Desk, serial: str, link: str) -> None:
    """Raise Refused while another run uses the drive, or one was cut off and left it changed.

    A drive that tells no serial number is the one on `link`.
    """
    for run in desk.journal.unfinished(serial, lambda other: same_place(link, other)):
        record = desk.journal.run(run)
        context = record.context
        if context.pid != os.getpid() and is_alive(context.pid, context.started):
            raise Refused(
                f"run {run} is still in progress on this drive (process {context.pid})",
                code="run.in-progress",
            )
        there = "" if same_place(record.link, link) else f' --link "{link}"'
        raise Refused(
            f"run {run} on this drive was cut off and left settings changed",
            code="run.cut-off",
            hint=f"'tworelay restore {run}{there}' puts them back",
            run=run,
        )


@contextlib.contextmanager
def connect(
    axis: Axis,
    cycle: float | None,
    desk: Desk,
    doing: str,
    *,
    to_stop: bool = False,
    lenient: bool = False,
) -> Generator[Drive]:
    """The drive of `axis`; closed, and stopped if need be, on every way out.

    `doing` : what for, for those who are refused meanwhile. Raises Refused while another process
        has its
    bus; `to_stop` does not ask. `lenient`: the profile is a run's own, of whatever version.
    """
    _allowed_here(axis)
    lock = owned(axis.link, doing) if axis.link and not to_stop else contextlib.nullcontext()
    with lock:
        drive = open_drive(axis, cycle=cycle, trace=desk.trace, to_stop=to_stop, lenient=lenient)
        try:
            yield drive
        finally:
            try:
                with desk.interruption.deferred():
                    drive.close()
            except Interrupted as late:  # what was begun is done, and noted
                late.noted = late.noted or desk.done
                raise


def _allowed_here(axis: Axis) -> None:
    """In CI only what is simulated is touched, unless the axis is allowed by name."""
    if not os.environ.get("CI") or axis.link is None or is_simulated(axis.link):
        return
    allowed = os.environ.get("TWORELAY_ALLOW_REAL", "")
    if axis.name not in (allowed, *allowed.split(",")):  # a name may have a comma in it
        raise Refused(
            f"CI is set and {axis.link} is a real adapter: axis '{axis.name}' is not touched from "
            f"CI. If it may be, set TWORELAY_ALLOW_REAL={axis.name}",
            code="refused.ci",
        )


def same_drive(found: Identity, serial: str, run: str, link: str, desk: Desk) -> None:
    """Raise IdentityMismatch unless the drive on the link is the run's own.

    A drive that tells no serial number is taken for it only when the user says so.
    """
    if serial in NO_SERIAL and found.serial in NO_SERIAL:
        desk.agree(
            f"The drive tells no serial number, so it cannot be checked that {link} is the drive "
            f"of run {run}.",
            "same",
        )
    elif found.serial != serial:
        raise IdentityMismatch(
            f"the drive on this link has serial {found.serial}, but run {run} is of serial "
            f"{serial}: its values belong to another axis; nothing was written"
        )
