"""States of the virtual drive, its error codes, and why it denies an access."""

from __future__ import annotations

from enum import Enum, auto

__all__ = [
    "ERROR_COMMUNICATION",
    "ERROR_FOLLOWING",
    "ERROR_HEARTBEAT",
    "ERROR_OVERSPEED",
    "ERROR_PDO_TIMEOUT",
    "DenialReason",
    "Denied",
    "State",
]

ERROR_COMMUNICATION = 0x8100
ERROR_HEARTBEAT = 0x8130
ERROR_PDO_TIMEOUT = 0x8250
ERROR_FOLLOWING = 0x8611
ERROR_OVERSPEED = 0x8400


class State(Enum):
    """Power state machine of CiA 402; the value is the statusword's state bits."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class DenialReason(Enum):
    """Why the drive does not take a value."""

    NO_OBJECT = auto()
    READ_ONLY = auto()
    RANGE = auto()
    STATE = auto()


class Denied(Exception):
    """The drive refuses an access; adapters turn it into their bus' answer."""

    def __init__(self, reason: DenialReason) -> None:
        super().__init__(reason.name)
        self.reason = reason
