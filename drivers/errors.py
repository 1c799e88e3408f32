"""What links and drives raise; the whole tree is drawn in `profiles.errors`."""

from __future__ import annotations

from profiles.errors import Refused, TwoRelayError

__all__ = [
    "AccessDenied",
    "DriveEnabled",
    "DriveFault",
    "LinkError",
    "LinkLost",
    "NoAnswer",
    "PreflightRefused",
    "WriteDenied",
    "WriteFailed",
]


class PreflightRefused(Refused):
    """A condition for motion is not met."""

    code = "refused.preflight"


class DriveEnabled(PreflightRefused):
    """The drive controls its axis already, by whomever it was enabled."""

    code = "refused.enabled"


class LinkError(TwoRelayError):
    """The drive cannot be talked to."""

    exit_code = 4
    code = "link"
    said_by = "the link"


class NoAnswer(LinkError):
    """The time-out of one request has passed."""

    code = "link.no-answer"


class LinkLost(LinkError):
    """A link that worked no longer does."""

    code = "link.lost"


class AccessDenied(TwoRelayError):
    """The drive answers, and refuses an access.

    `busy`: for now only. `missing`: it does not have it. `length`: of so many bytes.
    """

    exit_code = 4
    code = "access.denied"
    said_by = "the drive"

    def __init__(
        self,
        message: str,
        *,
        busy: bool = False,
        missing: bool = False,
        length: bool = False,
        code: str = "",
        hint: str = "",
        **facts: float | str,
    ) -> None:
        super().__init__(message, code=code, hint=hint, **facts)
        self.busy = busy
        self.missing = missing
        self.length = length


class WriteFailed(TwoRelayError):
    """A parameter is not what it should be after a write, a store or a restore."""

    exit_code = 7
    code = "write"


class WriteDenied(AccessDenied, WriteFailed):
    """The drive answers, and refuses a write."""

    exit_code = 7
    code = "write.denied"


class DriveFault(TwoRelayError):
    """The drive stopped by itself, or `said_by` stopped it."""

    exit_code = 5
    status = "stopped"
    code = "drive.fault"
    said_by = "the drive"

    def __init__(
        self,
        message: str,
        said_by: str = "",
        *,
        code: str = "",
        hint: str = "",
        **facts: float | str,
    ) -> None:
        super().__init__(message, code=code, hint=hint, **facts)
        self.said_by = said_by or type(self).said_by
