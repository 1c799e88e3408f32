"""Registers of a virtual Modbus drive: 16-bit words on one side, objects on the other.

A value of more than 16 bits takes several registers, which are read and written whole.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from drivers.virtual.device import Device
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.habitual_mirror import mirror_of
from drivers.virtual.mailbox import VirtualMailbox
from drivers.virtual.mirror import Entry, Mirror
from drivers.virtual.modbus_identity import PRODUCT, REVISION, VENDOR
from drivers.virtual.states import DenialReason, Denied
from drivers.virtual.switchgear import Switchgear
from profiles.procedures import Mailbox

__all__ = ["CLOCK", "OWN", "Layout", "RegisterMap"]

CLOCK = 0xFF00  # from here on a twin has registers of its own

_OWN: dict[int, tuple[str, str]] = {
    0x0100: ("torque_target", "h"),
    0x0101: ("position_target", "i"),
    0x0110: ("controlword", "H"),
    0x0111: ("mode", "h"),
    0x0112: ("velocity_target", "i"),
    0x0200: ("statusword", "H"),
    0x0201: ("error_code", "H"),
    0x0202: ("position_actual", "i"),
    0x0204: ("torque_actual", "h"),
    0x0206: ("velocity_actual", "i"),
    0x0210: ("mode_display", "h"),
    0x0212: ("supported_modes", "I"),
    0x0214: ("serial", "I"),
    0x0300: ("rated_torque", "I"),
    0x0302: ("encoder_increments", "I"),
    0x0304: ("encoder_revolutions", "I"),
    0x0310: ("max_torque", "H"),
    0x0312: ("max_speed", "I"),
    0x0314: ("quick_stop_option", "h"),
    0x0315: ("abort_connection_option", "h"),
    0x0316: ("watchdog_time", "H"),
    0x0318: ("torque_slope", "I"),
    0x031A: ("following_window", "I"),
    0x0400: ("torque_offset", "h"),
    0x0401: ("coulomb_positive", "H"),
    0x0402: ("coulomb_negative", "H"),
    0x0403: ("viscous_gain", "H"),
    0x0404: ("coulomb_speed", "I"),
    0x0410: ("velocity_gain", "I"),
    0x0412: ("integral_time", "I"),
    0x0414: ("position_gain", "I"),
    0x0416: ("torque_lag", "I"),
    0x0418: ("motor_temperature", "h"),
    0x0500: ("store_command", "H"),
    0x0501: ("store_status", "H"),
    0x0510: ("simulation_cycle", "I"),
    0x0512: ("simulation_advance", "I"),
}


@dataclass(frozen=True)
class Layout:
    """Which object lies in which register.

    `bits`: registers that are made of several objects, each with its mask. `low_first`: registers
    at which a value begins with its low word. `filled`: registers that nobody needs, and that read
    0. `position`: the register whose reading completes a cycle. `functions`: those that the drive
    knows. `identity`: vendor, product, revision by FC 43/14. `traffic_feeds`: any request feeds the
    watchdog. `posted`: objects behind the mailbox, by number and sub-index.
    """

    registers: dict[int, Entry]
    position: int
    bits: dict[int, tuple[tuple[Entry, int], ...]] = field(default_factory=dict)
    low_first: frozenset[int] = frozenset()
    filled: frozenset[int] = frozenset()
    functions: frozenset[int] = frozenset({3, 4, 6, 16, 22, 23, 43})
    identity: tuple[str, str, str] = (VENDOR, PRODUCT, REVISION)
    traffic_feeds: bool = False
    mailbox: Mailbox | None = None
    posted: Mapping[tuple[int, int], Entry] = field(default_factory=dict)


OWN = Layout(
    {
        at: Entry((key,), code, "wo" if key == "store_command" else "rw")
        for at, (key, code) in _OWN.items()
    },
    position=0x0202,
)


class RegisterMap:
    """Words in, words out.

    `around`: what stands between them and the values.
    """

    def __init__(
        self,
        device: Device,
        layout: Layout = OWN,
        switchgear: Switchgear | None = None,
        *,
        keeps: bool = False,
        habits: Habits = NONE,
        around: Callable[[Mirror], Mirror] = lambda mirror: mirror,
    ) -> None:
        self.device = device
        self.layout = layout
        self._mirror = around(mirror_of(device, habits, switchgear, keeps=keeps))
        self._posts: dict[int, VirtualMailbox] = {}
        if layout.mailbox is not None:
            mailbox = VirtualMailbox(layout.mailbox, layout.posted, self._mirror)
            self._posts = dict.fromkeys(mailbox.registers, mailbox)
        self._other: dict[int, int] = {}  # bits of registers that are no object's
        self._command_pending = False

    def read(self, start: int, count: int) -> list[int]:
        """`count` registers from `start`; raises Denied.

        The read of the position that follows a write of the set-point completes a cyclic exchange.
        """
        device, layout = self.device, self.layout
        device.catch_up()
        if self._command_pending and start <= layout.position < start + count:
            self._command_pending = False
            device.end_cycle()
        if layout.traffic_feeds:
            device.firmware.feed_watchdog()
        words: list[int] = []
        end = start + count
        while start < end:
            found = self._words(start)
            if len(found) > end - start:
                raise Denied(DenialReason.NO_OBJECT)
            words += found
            start += len(found)
        return words

    def _words(self, start: int) -> list[int]:
        layout = self.layout
        if start in self._posts:
            return [self._posts[start].read(start)]
        fields = layout.bits.get(start)
        if fields is not None:
            word = self._other.get(start, 0)
            for part, mask in fields:
                word |= int(self._mirror.value(part)) * (mask & -mask)
            return [word]
        entry = self._entry(start)
        if entry is None:
            return [0]
        if entry.access == "wo":
            raise Denied(DenialReason.NO_OBJECT)
        value = self._mirror.value(entry)
        packed = struct.pack(f">{entry.code}", value if entry.code == "f" else int(value))
        words = list(struct.unpack(f">{len(packed) // 2}H", packed))
        return words[::-1] if start in layout.low_first else words

    def write(self, start: int, words: list[int]) -> None:
        """Write `words` from `start`, all checked before the first is taken; raises Denied."""
        self.device.catch_up()
        if self.layout.traffic_feeds and start < CLOCK:
            self.device.firmware.feed_watchdog()
        writes: list[tuple[Entry, int]] = []
        left = words
        while left:
            if start in self._posts:
                self._posts[start].write(start, left[0])
                start, left = start + 1, left[1:]
                continue
            if start in self.layout.bits:
                writes += self._fields(start, left[0])
                start, left = start + 1, left[1:]
                continue
            entry = self._entry(start)
            if entry is None or entry.access == "ro":
                raise Denied(DenialReason.READ_ONLY)
            width = struct.calcsize(entry.code) // 2
            if width > len(left):
                raise Denied(DenialReason.NO_OBJECT)
            ordered = left[:width][::-1] if start in self.layout.low_first else left[:width]
            packed = struct.pack(f">{width}H", *ordered)
            writes.append((entry, struct.unpack(f">{entry.code}", packed)[0]))
            start, left = start + width, left[width:]
        for entry, value in writes:
            self._mirror.set(entry, value)
        if writes and "torque_target" in writes[0][0].keys:
            self._command_pending = True
            self.device.firmware.feed_watchdog()

    def _fields(self, start: int, word: int) -> list[tuple[Entry, int]]:
        found = []
        for entry, mask in self.layout.bits[start]:
            found.append((entry, (word & mask) // (mask & -mask)))
            word &= ~mask
        self._other[start] = word
        return found

    def _entry(self, start: int) -> Entry | None:
        """Object that begins there; None where a register reads 0; raises Denied."""
        entry = self.layout.registers.get(start)
        if entry is None and start not in self.layout.filled:
            raise Denied(DenialReason.NO_OBJECT)
        return entry
