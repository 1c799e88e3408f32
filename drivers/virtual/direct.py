"""The virtual drive in this process, without a wire: the bus behind `virtual://`.

It steps: each exchange lets one cycle of simulated time pass.
"""

from __future__ import annotations

import struct

from drivers.drive import Exchange
from drivers.virtual.device import Device
from drivers.virtual.firmware import SECOND, Denied
from drivers.virtual.modbus_identity import PRODUCT, REVISION, VENDOR
from drivers.virtual.registers import RegisterMap
from profiles.errors import AccessDenied, UsageError
from profiles.schema import Address, Identity, ModbusAddress, Profile

__all__ = ["DirectBus"]

_new = tuple.__new__  # a named tuple in half the time
_CODES = {"i16": "h", "u16": "H", "i32": "i", "u32": "I"}


class DirectBus:
    """Raw access to a virtual drive by the addresses of its Modbus profile."""

    def __init__(self, device: Device, profile: Profile) -> None:
        self.device = device
        self.cycle = device.cycle / SECOND
        self._map = RegisterMap(device)
        self._firmware = device.firmware
        if profile.name != "virtual-modbus":
            raise UsageError(
                f"virtual:// speaks profile 'virtual-modbus', not '{profile.name}'; serve the axis "
                "on a wire to use another"
            )
        self._mode_is_torque = True

    def identify(self) -> Identity:
        """Who the virtual drive says it is."""
        return Identity(vendor=VENDOR, product=PRODUCT, revision=REVISION, serial="")

    def read(self, address: Address) -> int:
        """Raw value; raises AccessDenied."""
        assert isinstance(address, ModbusAddress)
        try:
            words = self._map.read(address.register_, address.count)
        except Denied as error:
            raise AccessDenied(f"{address}: the virtual drive refuses it ({error})") from None
        packed = struct.pack(f">{len(words)}H", *words)
        return int(struct.unpack(f">{_CODES[address.type]}", packed)[0])

    def write(self, address: Address, raw: int) -> None:
        """Write a raw value; raises AccessDenied."""
        assert isinstance(address, ModbusAddress)
        packed = struct.pack(f">{_CODES[address.type]}", raw)
        words = list(struct.unpack(f">{len(packed) // 2}H", packed))
        try:
            self._map.write(address.register_, words)
        except Denied as error:
            raise AccessDenied(f"{address}: the virtual drive refuses {raw} ({error})") from None

    def post(self, address: Address, raw: int) -> None:
        """Write; nothing can be lost here."""
        self.write(address, raw)

    def start(self, idle: tuple[int, ...]) -> None:
        """Nothing to set up."""
        self._mode_is_torque = self._firmware.values["mode"] in (4, 10)

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        """One cycle: command in force, its time passed, feedback latched."""
        firmware = self._firmware
        sent = firmware.now / SECOND
        if self._mode_is_torque:
            firmware.command_torque(values[0])
        else:
            firmware.write("position_target", values[1])
        firmware.feed_watchdog()
        firmware.advance(self.device.cycle)
        feedback = (firmware.statusword, firmware.error_code, firmware.position, firmware.torque)
        return _new(Exchange, (feedback, values, sent, firmware.now / SECOND, 0.0, 0))

    def wait(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._firmware.advance(round(seconds * SECOND))

    def other_master(self) -> str:
        """There is only this process."""
        return ""

    def trouble(self) -> str:
        """Nothing is reported beside the error code."""
        return ""

    def close(self) -> None:
        """The drive is switched off with the process; energy goes now."""
        self._firmware.write("controlword", 0)
