"""Power state machine of CiA 402 (IEC 61800-7-201), as data.

The state is read from the statusword; the way to a state is a table of controlwords.
"""

from __future__ import annotations

from functools import lru_cache

from drivers.sample import Status

__all__ = [
    "DISABLE_VOLTAGE",
    "ENABLE",
    "FAULT_RESET",
    "INTERNAL_LIMIT",
    "QUICK_STOP_RAMP",
    "STATES",
    "STAYS_IN_QUICK_STOP",
    "next_controlword",
    "state",
    "status",
]

# name: (mask, value) of the statusword, CiA 402 table "state coding"
STATES: dict[str, tuple[int, int]] = {
    "not ready to switch on": (0x4F, 0x00),
    "switch on disabled": (0x4F, 0x40),
    "ready to switch on": (0x6F, 0x21),
    "switched on": (0x6F, 0x23),
    "operation enabled": (0x6F, 0x27),
    "quick stop active": (0x6F, 0x07),
    "fault reaction active": (0x4F, 0x0F),
    "fault": (0x4F, 0x08),
}

DISABLE_VOLTAGE = 0x0000
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE = 0x000F
FAULT_RESET = 0x0080

STAYS_IN_QUICK_STOP = 5  # 605Ah from here on: the drive holds the axis when it has stopped
QUICK_STOP_RAMP = 2  # and this one takes the energy away then

# state we are in: controlword of the next step towards "operation enabled"
_UPWARDS: dict[str, int] = {
    "switch on disabled": SHUTDOWN,
    "ready to switch on": SWITCH_ON,
    "switched on": ENABLE,
}

# state we are in: controlword of the next step towards "switch on disabled"
_DOWNWARDS: dict[str, int] = {
    "operation enabled": SWITCH_ON,  # disable operation: ramp down, brake, power off
    "switched on": SHUTDOWN,
    "ready to switch on": DISABLE_VOLTAGE,
}

INTERNAL_LIMIT = 0x0800


def state(statusword: int) -> str:
    """Name of the state, or 'unknown (….h)'."""
    for name, (mask, value) in STATES.items():
        if statusword & mask == value:
            return name
    return f"unknown ({statusword:04X}h)"


def next_controlword(statusword: int, *, enabled: bool) -> int | None:
    """Controlword of the next step towards enabled or disabled; None: there, or no way."""
    return (_UPWARDS if enabled else _DOWNWARDS).get(state(statusword))


@lru_cache(maxsize=256)
def status(statusword: int) -> Status:
    """What the statusword says, in plain flags."""
    name = state(statusword)
    return Status(
        enabled=name == "operation enabled",
        fault=name in ("fault", "fault reaction active"),
        stopping=name in ("quick stop active", "fault reaction active"),
        limit=bool(statusword & INTERNAL_LIMIT),
        word=statusword,
    )
