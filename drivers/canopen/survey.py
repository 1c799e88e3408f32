"""Which nodes are on a CAN bus: one short read from each at once, and whose heartbeat is heard.

Reading object 1000h is what every CANopen device must answer; nothing is written, no node is reset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivers.canopen.bus import identify
from drivers.canopen.wire import HEARTBEAT, CanWire
from drivers.errors import AccessDenied, LinkError
from drivers.patience import when_up
from profiles.identity import Identity

__all__ = ["Node", "Traffic", "ask", "listen", "survey"]

_NODES = range(1, 128)
_UPLOAD_DEVICE_TYPE = bytes((0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0))  # CiA 301, SDO upload of 1000h:00
_AT_ONCE = 16  # requests that are on their way together: a slow bus is not flooded
_PATIENCE = 0.25  # s for the last answers and for heartbeats
_BETWEEN = 0.004  # s that a handful of requests may take
_CIA402 = 402


@dataclass(frozen=True, slots=True)
class Node:
    """A node that was found.

    Attributes
    ----------
    number : 1…127
    identity : 1018h; None where it answers no SDO
    device : device profile, the low word of 1000h (402: a drive); None where it is not said
    modes : 6502h supported drive modes, None where it has none
    """

    number: int
    identity: Identity | None
    device: int | None
    modes: int | None

    @property
    def is_drive(self) -> bool:
        """Whether it says that it is a CiA 402 drive."""
        return self.device == _CIA402


@dataclass(frozen=True, slots=True)
class Traffic:
    """What was heard.

    Frames, error frames, what these say, and the nodes whose heartbeat it was.
    """

    frames: int
    errors: int
    trouble: str
    heartbeats: frozenset[int]


def listen(bus: Any, seconds: float) -> Traffic:
    """Hear a bus for some time, and say nothing; raises LinkLost."""
    ear = _Ear(bus, seconds)
    ear.listen(seconds)
    return Traffic(ear.frames, ear.error_frames, ear.bus_trouble, frozenset(ear.heard))


def survey(bus: Any, timeout: float) -> list[Node]:
    """Every node on `bus` (a python-can bus), by its number; raises LinkError."""
    ear = _Ear(bus, timeout)
    for number in _NODES:
        ear.send(0x600 + number, _UPLOAD_DEVICE_TYPE)
        if number % _AT_ONCE == 0:
            ear.listen(_BETWEEN)
    ear.listen(max(_PATIENCE, timeout))
    return [_described(bus, number, ear, timeout) for number in sorted(ear.heard)]


def ask(bus: Any, number: int, timeout: float, patience: float) -> Node:
    """One node, as a job asks it.

    `timeout` s for each answer, `patience` s while it boots, or is busy.

    Raises LinkError.
    """
    wire = CanWire(bus, number, timeout)
    identity = when_up(lambda: identify(wire, patience), patience, timeout)
    return Node(number, identity, None, None)


class _Ear(CanWire):
    """A wire that notes who speaks."""

    def __init__(self, bus: Any, timeout: float) -> None:
        super().__init__(bus, 127, timeout, self._note)
        self.heard: set[int] = set()
        self.answered: dict[int, bytes] = {}
        self.frames = 0

    def _note(self, sending: bool, cob_id: int, data: bytes | None) -> None:
        if sending or data is None:
            return
        self.frames += 1
        if HEARTBEAT < cob_id < HEARTBEAT + 128:
            self.heard.add(cob_id - HEARTBEAT)
        elif 0x580 < cob_id < 0x600 and data[1:4] == _UPLOAD_DEVICE_TYPE[1:4]:
            self.heard.add(cob_id - 0x580)
            self.answered[cob_id - 0x580] = data

    def listen(self, seconds: float) -> None:
        """Hear whoever speaks within some time."""
        self.pump_until(lambda: False, seconds)


def _described(bus: Any, number: int, ear: _Ear, timeout: float) -> Node:
    answer = ear.answered.get(number)
    if answer is None:
        return Node(number, None, None, None)
    device = int.from_bytes(answer[4:6], "little") if answer[0] & 0x43 == 0x43 else None
    wire = CanWire(bus, number, timeout)
    try:
        identity = identify(wire)
    except (AccessDenied, LinkError):
        return Node(number, None, device, None)
    modes = None
    try:
        modes = int.from_bytes(wire.upload(0x6502, 0)[:4], "little")
    except (AccessDenied, LinkError):
        modes = None
    return Node(number, identity, device, modes)
