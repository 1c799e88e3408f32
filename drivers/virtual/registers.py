"""Register map of the virtual Modbus drive: 16-bit words on one side, objects on the other.

32-bit values take two registers, high word at the lower address, and are read and written whole.
"""

from __future__ import annotations

import struct

from drivers.virtual.device import Device
from drivers.virtual.firmware import Denied, Reason

__all__ = ["FIRST", "LAST", "MAP", "RegisterMap"]

MAP: dict[int, tuple[str, str]] = {
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
    0x0500: ("store_command", "H"),
    0x0501: ("store_status", "H"),
    0x0510: ("simulation_cycle", "I"),
    0x0512: ("simulation_advance", "I"),
}
FIRST = min(MAP)
LAST = max(MAP) + 1

_WRITE_ONLY = {"store_command"}


class RegisterMap:
    """Words in, words out."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._command_pending = False

    def read(self, start: int, count: int) -> list[int]:
        """`count` registers from `start`; raises Denied.

        The read that follows a write of the set-points completes a cyclic exchange.
        """
        device = self.device
        device.catch_up()
        if self._command_pending and start <= 0x0202 < start + count:
            self._command_pending = False
            device.end_cycle()
        words: list[int] = []
        end = start + count
        while start < end:
            key, code = self._entry(start)
            if key in _WRITE_ONLY:
                raise Denied(Reason.NO_OBJECT)
            packed = struct.pack(f">{code}", device.read(key))
            if len(packed) // 2 > end - start:
                raise Denied(Reason.NO_OBJECT)
            words += struct.unpack(f">{len(packed) // 2}H", packed)
            start += len(packed) // 2
        return words

    def write(self, start: int, words: list[int]) -> None:
        """Write `words` from `start`, all checked before the first is taken; raises Denied."""
        self.device.catch_up()
        writes: list[tuple[str, int]] = []
        left = words
        while left:
            key, code = self._entry(start)
            width = struct.calcsize(code) // 2
            if width > len(left):
                raise Denied(Reason.NO_OBJECT)
            packed = struct.pack(f">{width}H", *left[:width])
            writes.append((key, struct.unpack(f">{code}", packed)[0]))
            start, left = start + width, left[width:]
        for key, value in writes:
            self.device.write(key, value)
        if writes[0][0] == "torque_target":
            self._command_pending = True
            self.device.firmware.feed_watchdog()

    @staticmethod
    def _entry(start: int) -> tuple[str, str]:
        try:
            return MAP[start]
        except KeyError:
            raise Denied(Reason.NO_OBJECT) from None
