"""A PDO of the virtual node: its parameters, and the rules for setting them (CiA 301)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.virtual.aborts import (
    ABORT_NO_SUB,
    ABORT_NOT_MAPPABLE,
    ABORT_PDO_LENGTH,
    ABORT_RANGE,
    ABORT_READ_ONLY,
    ABORT_STATE,
    Abort,
)
from drivers.virtual.dictionary import Dictionary
from drivers.virtual.mirror import Entry

__all__ = ["OFF", "NodePdo"]

OFF = 1 << 31
_IDENTIFIER = (1 << 30) - 1  # of a COB-ID: may not change while the PDO exists
_RESERVED = range(241, 254)  # and those that only a remote frame asks for, which it does not answer

Objects = Mapping[tuple[int, int], Entry]


@dataclass
class NodePdo:
    """Communication and mapping parameters of one PDO."""

    cob_id: int
    transmission: int
    entries: list[int]
    event_timer: int = 0  # ms
    inhibit: int = 0  # 100 us, least time between two
    count: int = 0
    sent: bytes | None = None  # what it said last
    slots: list[int] = field(default_factory=lambda: [0] * 8)
    pending: bytes | None = None
    since: int = 0  # ns, last sent or received
    syncs: int = 0
    armed: bool = False

    def __post_init__(self) -> None:
        self.slots[: len(self.entries)] = self.entries
        self.count = len(self.entries)

    @property
    def active(self) -> bool:
        """Whether it exists (CiA 301, 7.5.2.35)."""
        return not self.cob_id & OFF

    def mapped(self, dictionary: Dictionary) -> list[tuple[Entry, int]]:
        """Entry and its length in bytes, in order."""
        return [
            (dictionary.objects[slot >> 16, slot >> 8 & 0xFF], (slot & 0xFF) // 8)
            for slot in self.slots[: self.count]
        ]

    def read(self, index: int, sub: int) -> bytes:
        """One of its communication or mapping parameters; raises Abort."""
        if index & 0x0200:
            if sub == 0:
                return bytes((self.count,))
            if sub > len(self.slots):
                raise Abort(ABORT_NO_SUB)
            return struct.pack("<I", self.slots[sub - 1])
        try:
            return {
                0: b"\x05",
                1: struct.pack("<I", self.cob_id),
                2: bytes((self.transmission,)),
                3: struct.pack("<H", self.inhibit),
                5: struct.pack("<H", self.event_timer),
            }[sub]
        except KeyError:
            raise Abort(ABORT_NO_SUB) from None

    def write(self, index: int, sub: int, data: bytes, objects: Objects) -> None:
        """Set one of them, by the rules (CiA 301, 7.5.2.35 to 38); raises Abort."""
        value = int.from_bytes(data, "little")
        if index & 0x0200:
            self._write_mapping(sub, value, objects)
        elif sub == 1:
            if self.active and not value & OFF and (self.cob_id ^ value) & _IDENTIFIER:
                raise Abort(ABORT_RANGE)
            self.cob_id = value
            self.armed = False
            self.sent = None
        elif sub == 2:
            if value in _RESERVED:
                raise Abort(ABORT_RANGE)
            self.transmission = value & 0xFF
        elif sub == 3:
            if self.active:
                raise Abort(ABORT_STATE)
            self.inhibit = value & 0xFFFF
        elif sub == 5:
            self.event_timer = value & 0xFFFF
        else:
            raise Abort(ABORT_NO_SUB if sub else ABORT_READ_ONLY)

    def _write_mapping(self, sub: int, value: int, objects: Objects) -> None:
        if self.active:
            raise Abort(ABORT_STATE)
        if sub == 0:
            if value > len(self.slots) or any(
                (slot >> 16, slot >> 8 & 0xFF) not in objects for slot in self.slots[:value]
            ):
                raise Abort(ABORT_NOT_MAPPABLE)
            if sum(slot & 0xFF for slot in self.slots[:value]) > 64:
                raise Abort(ABORT_PDO_LENGTH)
            self.count = value
            return
        if sub > len(self.slots):
            raise Abort(ABORT_NO_SUB)
        if self.count:
            raise Abort(ABORT_STATE)
        if value == 0:  # an entry of nothing, which may not be counted
            self.slots[sub - 1] = value
            return
        entry = objects.get((value >> 16, value >> 8 & 0xFF))
        if entry is None or struct.calcsize("<" + entry.code) * 8 != value & 0xFF:
            raise Abort(ABORT_NOT_MAPPABLE)
        self.slots[sub - 1] = value
