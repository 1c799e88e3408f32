"""A virtual drive with its clock: what every adapter serves.

Two clocks. `wall`: physics is advanced to now before each answer, watchdogs run by themselves.
`step`: each cyclic exchange, and each write of `simulation_advance`, lets exactly that much time
pass, and time stands still otherwise. Drives on one bus have one clock.
"""

from __future__ import annotations

import time
from typing import Literal

from drivers.virtual.firmware import SECOND, Firmware
from drivers.virtual.states import DenialReason, Denied

__all__ = ["Clock", "ClockKind", "Device"]

ClockKind = Literal["wall", "step"]

_LONGEST_STEP = 60 * SECOND


class Clock:
    """The time of all drives on one bus, ns.

    Attributes
    ----------
    stepping : it stands still between exchanges
    cycle : ns, of an exchange
    """

    def __init__(self, kind: ClockKind, cycle: int) -> None:
        self.stepping = kind == "step"
        self.cycle = cycle
        self._now = self._passed = 0
        self._started = time.monotonic_ns()

    def now(self) -> int:
        """Where every drive on the bus has to be before it is asked."""
        return self._now if self.stepping else time.monotonic_ns() - self._started

    def passed(self, until: int) -> None:
        """One drive has stepped; the others follow from the next turn on."""
        self._passed = max(self._passed, until)

    def turn(self) -> None:
        """What was said on the bus has been heard by all of it."""
        self._now = self._passed


class Device:
    """Firmware behind a clock, with the services that are no plain objects.

    `clock` : the bus' own, where it has other drives
    """

    def __init__(self, firmware: Firmware, clock: Clock | ClockKind) -> None:
        self.firmware = firmware
        cycle = round(firmware.axis.cycle * SECOND)
        self.clock = Clock(clock, cycle) if isinstance(clock, str) else clock
        self.stepping = self.clock.stepping

    @property
    def cycle(self) -> int:
        """Of an exchange, ns."""
        return self.clock.cycle

    @cycle.setter
    def cycle(self, cycle: int) -> None:
        self.clock.cycle = cycle

    def catch_up(self) -> None:
        """Bring physics to where the bus' clock is."""
        behind = self.clock.now() - self.firmware.now
        if behind > 0:
            self.firmware.advance(behind)

    def end_cycle(self) -> None:
        """One cyclic exchange is complete; on the step clock its time passes now."""
        if self.stepping:
            self._step(self.clock.cycle)

    def _step(self, duration: int) -> None:
        self.firmware.advance(duration)
        self.clock.passed(self.firmware.now)

    def read(self, key: str) -> int:
        """Raw value by key; raises Denied."""
        if key == "simulation_cycle":
            return self.cycle // 1000
        if key in ("simulation_advance", "store_command"):
            return 0
        return self.firmware.read(key)

    def write(self, key: str, value: int) -> None:
        """Write a raw value by key; raises Denied."""
        if key == "simulation_cycle":
            if not 1 <= value * 1000 <= _LONGEST_STEP:
                raise Denied(DenialReason.RANGE)
            self.cycle = value * 1000
        elif key == "simulation_advance":
            if not self.stepping:
                raise Denied(DenialReason.STATE)
            if not 0 <= value * 1000 <= _LONGEST_STEP:
                raise Denied(DenialReason.RANGE)
            self._step(value * 1000)
        elif key == "store_command":
            if value != 1:
                raise Denied(DenialReason.RANGE)
            self.firmware.store()
        else:
            self.firmware.write(key, value)
