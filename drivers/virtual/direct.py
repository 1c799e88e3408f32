"""The virtual drive in this process, without a wire: the bus behind `virtual://`.

It steps: each exchange lets one cycle of simulated time pass.
"""

from __future__ import annotations

import random
import struct
from contextlib import AbstractContextManager, nullcontext

from drivers.bus import Exchange
from drivers.errors import AccessDenied, WriteDenied
from drivers.serial_port import Stream
from drivers.virtual.device import Device
from drivers.virtual.firmware import SECOND
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.modbus_identity import PRODUCT, REVISION, VENDOR
from drivers.virtual.registers import RegisterMap
from drivers.virtual.states import DenialReason, Denied
from profiles.address import Address, ModbusAddress
from profiles.errors import UsageError
from profiles.identity import Identity
from profiles.schema import Profile

__all__ = ["DirectBus"]

_MOST_MISSED = 2  # in a row: one more would be a lost link
_new = tuple.__new__  # a named tuple in half the time
_CODES = {"i16": "h", "u16": "H", "i32": "i", "u32": "I"}


class DirectBus:
    """Raw access to a virtual drive by the addresses of its Modbus profile.

    The axis' `jitter`, `loss` and `stamp` make it as bad as a real link, the same way each time.
    """

    lacking: tuple[str, ...] = ()  # its profile says all that there is

    def __init__(self, device: Device, profile: Profile, habits: Habits = NONE) -> None:
        self.device = device
        self.cycle = device.cycle / SECOND
        self.in_real_time = False
        self._map = RegisterMap(device, habits=habits)
        self._is_habitual = bool(habits.values)
        self._firmware = device.firmware
        if profile.name != "virtual-modbus":
            raise UsageError(
                f"virtual:// speaks profile 'virtual-modbus', not '{profile.name}'; serve the axis "
                "on a wire to use another"
            )
        self._profile = profile
        self._mode_is_torque = True
        axis = device.firmware.axis
        self._is_bad = bool(axis.jitter or axis.loss or axis.stamp)
        self._random = random.Random(axis.seed)  # noqa: S311
        self._stamped = 0.0

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
        """Write a raw value; raises WriteDenied."""
        assert isinstance(address, ModbusAddress)
        packed = struct.pack(f">{_CODES[address.type]}", raw)
        words = list(struct.unpack(f">{len(packed) // 2}H", packed))
        try:
            self._map.write(address.register_, words)
        except Denied as error:
            text = f"{address}: the virtual drive refuses {raw} ({error})"
            raise WriteDenied(text, busy=error.reason is DenialReason.STATE) from None

    def post(self, address: Address, raw: int) -> None:
        """Write; nothing can be lost here."""
        self.write(address, raw)

    def descriptor(self) -> int | None:
        """There is no port."""
        return None

    def port(self) -> None:
        """There is no port."""

    def speak_through(self, stream: Stream | None) -> None:
        """There is no port."""
        raise NotImplementedError

    def frame(self, address: Address, raw: int) -> bytes:
        """There is no port."""
        raise NotImplementedError

    def changes(self) -> dict[str, tuple[int, int]]:
        """Nothing beside the parameters of the profile."""
        return {}

    def put_back(self, old: dict[str, int]) -> bool:
        """Nothing but parameters of the profile was changed.

        Raises UsageError for anything else.
        """
        if old:
            raise UsageError(f"no parameter of profile '{self._profile.name}': {', '.join(old)}")
        return False

    def start(self, idle: tuple[int, ...]) -> None:
        """Nothing to set up."""
        self._mode_is_torque = self._firmware.values["mode"] in (4, 10)

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        """One cycle: command in force, its time passed, feedback latched."""
        firmware = self._firmware
        sent = firmware.now / SECOND
        if self._is_habitual:
            return self._habitual_exchange(values, sent)
        if self._mode_is_torque:
            firmware.command_torque(values[0])
        else:
            firmware.write("position_target", values[1])
        firmware.feed_watchdog()
        if self._is_bad:
            return self._bad_exchange(values, sent)
        firmware.advance(self.device.cycle)
        feedback = (firmware.statusword, firmware.error_code, firmware.position, firmware.torque)
        return _new(Exchange, (feedback, values, sent, firmware.now / SECOND, 0.0, 0))

    def _habitual_exchange(self, values: tuple[int, ...], sent: float) -> Exchange:
        """One cycle through the registers, where habits are."""
        cycle = self._profile.cycle
        known = self._profile.parameters
        for name, raw in zip(cycle.out, values, strict=True):
            self.write(known[name].address, raw)
        self.read(known["position_actual"].address)  # after a command its cycle passes
        feedback = tuple(self.read(known[name].address) for name in cycle.in_)
        return _new(Exchange, (feedback, values, sent, self._firmware.now / SECOND, 0.0, 0))

    def _bad_exchange(self, values: tuple[int, ...], sent: float) -> Exchange:
        """One cycle on a link that is late, loses samples, and stamps them wrongly."""
        firmware, axis, draw = self._firmware, self._firmware.axis, self._random
        missed, lateness = 0, 0.0
        while True:
            late = draw.expovariate(1.0) if draw.random() < axis.jitter else 0.0
            lateness = max(lateness, late * self.cycle)
            firmware.advance(round(self.device.cycle * (1 + late)))
            firmware.feed_watchdog()
            if missed >= _MOST_MISSED or draw.random() >= axis.loss:
                break
            missed += 1
        feedback = (firmware.statusword, firmware.error_code, firmware.position, firmware.torque)
        stamp = firmware.now / SECOND + (draw.gauss(0.0, axis.stamp) if axis.stamp else 0.0)
        stamp = max(stamp, self._stamped + 0.01 * self.cycle, sent)
        self._stamped = stamp
        return _new(Exchange, (feedback, values, sent, stamp, lateness, missed))

    def wait(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._firmware.advance(round(seconds * SECOND))

    def answering_within(self, seconds: float) -> AbstractContextManager[None]:
        """Every answer comes at once."""
        return nullcontext()

    def now(self) -> float:
        """Time of the cycle's clock, s."""
        return self._firmware.now / SECOND

    def own_address(self) -> str:
        """There is none here."""
        return ""

    def other_master(self) -> str:
        """There is only this process."""
        return ""

    def refused_posts(self) -> list[tuple[Address, int]]:
        """None: a refusal comes at once here."""
        return []

    def trouble(self) -> str:
        """Nothing is reported beside the error code."""
        return ""

    def close(self) -> None:
        """The drive is switched off with the process; energy goes now."""
        self._firmware.write("controlword", 0)
