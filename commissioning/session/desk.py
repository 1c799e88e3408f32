"""What every job needs beside the drive: the journal, the signals, and somebody to talk to."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass, field

from commissioning.interruption import Interruption
from commissioning.journal import Journal
from drivers.drive import Drive
from drivers.link import open_drive
from profiles.axis import Axis
from profiles.errors import IdentityMismatch, Refused
from profiles.schema import Identity

__all__ = ["Desk", "Options", "connect", "same_drive"]

Method = str


@dataclass(frozen=True, slots=True)
class Options:
    """What the user asks for; None: take the axis', the drive's or the product's own."""

    travel: float | None = None
    max_torque: float | None = None
    max_speed: float | None = None
    duration: float | None = None
    fraction: float = 0.85
    method: Method = "two-relay"
    solver: str = "bracket"
    cycle: float | None = None
    without_watchdog: bool = False
    dry_run: bool = False


@dataclass
class Desk:
    """Journal, signals, and the conversation.

    Attributes
    ----------
    tell : one line for people about what happens
    confirm : (question, word to be typed) → whether it was typed; raises Refused without a terminal
    """

    journal: Journal
    interruption: Interruption
    tell: Callable[[str], None]
    confirm: Callable[[str, str], bool]
    trace: Callable[..., None] | None = None
    phases: list[str] = field(default_factory=list)

    def agree(self, question: str, word: str) -> None:
        """Ask; raises Refused when the answer is no."""
        if not self.confirm(question, word):
            raise Refused("not confirmed: nothing was moved or written")


@contextlib.contextmanager
def connect(axis: Axis, cycle: float | None, desk: Desk) -> Generator[Drive]:
    """The drive of `axis`; closed, and stopped if need be, on every way out."""
    drive = open_drive(axis, cycle=cycle, trace=desk.trace)
    try:
        yield drive
    finally:
        with desk.interruption.deferred():
            drive.close()


def same_drive(found: Identity, serial: str, run: str) -> None:
    """Raise IdentityMismatch unless the drive on the link is the run's own."""
    if found.serial != serial:
        raise IdentityMismatch(
            f"the drive on this link has serial {found.serial}, but run {run} is of serial "
            f"{serial}: its values belong to another axis; nothing was written"
        )
