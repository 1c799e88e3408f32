"""The drive with two keys in simulated time: its registers in this process, at virtual:// links."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Generator

import drivers.link
from drivers.bus import Bus, Exchange
from drivers.errors import AccessDenied, WriteDenied
from drivers.link import Link, Trace, state_file
from drivers.modbus.registers import decode, encode
from drivers.virtual.axes import configured
from drivers.virtual.device import Device
from drivers.virtual.direct import DirectBus
from drivers.virtual.firmware import SECOND, Firmware
from drivers.virtual.memory import Memory
from drivers.virtual.states import Denied
from drivers.virtual.twin import modbus_twin
from profiles.address import Address, ModbusAddress
from profiles.axis import Axis
from profiles.schema import Profile
from tests.command import ROOT

__all__ = ["TWO_KEY", "in_process"]

TWO_KEY = str(ROOT / "tests/faults/two_key.toml")


class TwinBus(DirectBus):
    """Raw access to the registers of a drive's twin."""

    def __init__(self, device: Device, profile: Profile) -> None:
        self.device, self._firmware = device, device.firmware
        self.cycle = device.cycle / SECOND
        self.in_real_time = False
        self._profile = profile
        self._map = modbus_twin(profile, device)
        self._is_bad, self._random = False, random.Random(0)
        self._in = [profile.parameters[name].address for name in profile.cycle.in_]
        self._out = [profile.parameters[name].address for name in profile.cycle.out]

    def read(self, address: Address) -> int:
        assert isinstance(address, ModbusAddress)
        try:
            return decode(address, self._map.read(address.register_, address.count))
        except Denied as error:
            raise AccessDenied(f"{address}: {error}") from None

    def write(self, address: Address, raw: int) -> None:
        assert isinstance(address, ModbusAddress)
        try:
            self._map.write(address.register_, encode(address, raw))
        except Denied as error:
            raise WriteDenied(f"{address}: {error}") from None

    def start(self, idle: tuple[int, ...]) -> None:
        return

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        sent = self._firmware.now / SECOND
        for address, value in zip(self._out, values, strict=True):
            self.write(address, value)
        self._map._command_pending = False
        self._firmware.advance(self.device.cycle)
        feedback = tuple(self.read(address) for address in self._in)
        return Exchange(feedback, values, sent, self._firmware.now / SECOND, 0.0, 0)

    def close(self) -> None:
        self._firmware.write("controlword", 0)


def _open(
    link: Link, axis: Axis, profile: Profile | None, cycle: float | None, _trace: Trace | None
) -> tuple[Bus, Profile]:
    if profile is None or profile.name != "two-key":
        return _virtual(link, axis, profile, cycle, None)
    options = {key: value for key, value in link.options.items() if key != "state"}
    virtual = configured(link.place.strip("/"), options)
    device = Device(Firmware(virtual, Memory(state_file(link))), "step")
    if cycle is not None:
        device.cycle = round(cycle * 1e9)
    return TwinBus(device, profile), profile


_virtual = drivers.link._open_virtual


@contextlib.contextmanager
def in_process() -> Generator[None]:
    """Meanwhile virtual:// has the drive with two keys, where its profile is asked for."""
    drivers.link._open_virtual = _open
    try:
        yield
    finally:
        drivers.link._open_virtual = _virtual
