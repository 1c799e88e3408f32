"""What a job raises; the whole tree is drawn in `profiles.errors`."""

from __future__ import annotations

from drivers.errors import DriveFault, WriteFailed
from profiles.errors import TwoRelayError

__all__ = [
    "DoesNotHelp",
    "EnvelopeTripped",
    "FeedbackReversed",
    "Interrupted",
    "JournalError",
    "MeasurementRejected",
]


class EnvelopeTripped(DriveFault):
    """A limit of the experiment was reached, so the axis was stopped."""

    code = "limit"
    said_by = "tworelay, at a limit of the experiment"


class FeedbackReversed(EnvelopeTripped):
    """The position answers against the torque, so that a quick stop would accelerate.

    The energy must go.
    """

    code = "limit.feedback"


class MeasurementRejected(TwoRelayError):
    """The measurement gives no number that can be trusted."""

    exit_code = 6
    status = "rejected"
    code = "measurement"


class DoesNotHelp(TwoRelayError):
    """The compensation was tried, and the axis follows no better with it.

    The old values are back.
    """

    exit_code = 8
    code = "verify.no-help"


class JournalError(WriteFailed):
    """The journal cannot be read or written, so nothing may be done."""

    code = "journal"


class Interrupted(TwoRelayError):
    """The user or the system asked to end."""

    exit_code = 130
    status = "stopped"
    code = "interrupted"

    def __init__(self, message: str, signal_number: int, said_by: str = "the operator") -> None:
        super().__init__(message)
        self.exit_code = 128 + signal_number
        self.said_by = said_by
