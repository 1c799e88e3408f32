"""The one exception tree of tworelay, and the exit code that each branch ends with.

Here is its root, and what profiles raise; what links and drives raise is in `drivers.errors`, what
a job raises in `commissioning.errors`.

    TwoRelayError                      1   a bug, if it is ever raised as itself
    ├── UsageError                     2   "--travel abc", a file that is no TOML
    │   ├── ProfileError               2   unknown key in a profile, range upside down
    │   └── UnknownName                2   a profile, axis, run or parameter that does not exist
    ├── Refused                        3   confirmation declined, travel too small
    │   ├── IdentityMismatch           3   another drive than the profile is for, or than in the run
    │   └── PreflightRefused           3   fault present, limit not accepted, watchdog not proved
    │       └── DriveEnabled           3   it controls its axis already
    ├── LinkError                      4   unreachable, silent, speaks something else
    │   └── LinkLost                   4   was there, and is gone
    ├── DriveFault                     5   the drive reported a fault in motion
    │   └── EnvelopeTripped            5   a limit of ours was about to be passed
    │       └── FeedbackReversed       5   the position answers against the torque
    ├── MeasurementRejected            6   friction above the torque limit, no limit cycle
    ├── AccessDenied                   4   SDO abort, Modbus exception: the drive refuses to be read
    ├── WriteFailed                    7   write, read-back, store or restore incomplete
    │   ├── WriteDenied                7   the drive refuses to be written to
    │   └── JournalError               7   the journal cannot be written
    ├── DoesNotHelp                    8   the compensation was tried, and is taken back
    └── Interrupted              130, 143  SIGINT, SIGTERM

Every message is one plain line: what happened, to what, with numbers and units, and what to do.
"""

from __future__ import annotations

import difflib
from typing import Literal

__all__ = [
    "IdentityMismatch",
    "ProfileError",
    "Refused",
    "TwoRelayError",
    "UnknownName",
    "UsageError",
]


Status = Literal["completed", "stopped", "failed", "refused", "rejected"]


class TwoRelayError(Exception):
    """Something that the user is told in one line.

    Attributes
    ----------
    exit_code : int
        Exit code of the command line.
    status : str
        `status` of the result JSON.
    code : str
        Stable name for programs.
    said_by : str
        Who ended what was under way; '' where nobody but tworelay did.
    text : str
        What happened, to what, with numbers and units.
    hint : str
        What to do next; '' where the text says it.
    facts : dict
        What the message is about, by name: numbers in SI, and names (parameter, address, unit).
    noted : bool
        The run that it ended says so.
    """

    exit_code = 1
    status: Status = "failed"
    code = "internal"
    said_by = ""
    noted = False

    def __init__(
        self, message: str, *, code: str = "", hint: str = "", **facts: float | str
    ) -> None:
        self.code = code or type(self).code
        self.text = " ".join(message.split())
        self.hint = hint
        self.facts = facts
        self._more: list[str] = []
        super().__init__(self.text)

    def also(self, text: object) -> None:
        """Add what else there is to say: how a clean-up went, what was left."""
        self._more.append(" ".join(str(text).split()))

    @property
    def whole(self) -> str:
        """The text with what was added, and without the hint."""
        return "; ".join((self.text, *self._more))

    def __str__(self) -> str:
        return "; ".join(filter(None, (self.text, self.hint, *self._more)))


class UsageError(TwoRelayError):
    """The command or a file is not what it must be."""

    exit_code = 2
    code = "usage"


class ProfileError(UsageError):
    """A profile or axis file is not valid: file, section, key, and what is allowed."""

    code = "usage.profile"


class UnknownName(UsageError):
    """A name that does not exist, with those that do."""

    code = "usage.name"

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        self.kind, self.name, self.known = kind, name, known
        near = difflib.get_close_matches(name, known, 1)
        hint = f", did you mean '{near[0]}'?" if near else ""
        there = ", ".join(sorted(known)) if known else "none"
        super().__init__(f"no {kind} named '{name}'{hint or ';'} there are: {there}")


class Refused(TwoRelayError):
    """The product declines to act; nothing was moved or written."""

    exit_code = 3
    status = "refused"
    code = "refused"


class IdentityMismatch(Refused):
    """The drive on the link is not the one that is meant."""

    code = "refused.identity"
