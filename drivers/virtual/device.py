"""A virtual drive with its clock: what every adapter serves.

Two clocks. `wall`: physics is advanced to now before each answer, watchdogs run by themselves.
`step`: each cyclic exchange, and each write of `simulation_advance`, lets exactly that much time
pass, and time stands still otherwise.
"""

from __future__ import annotations

import time
from typing import Literal

from drivers.virtual.firmware import SECOND, Firmware
from drivers.virtual.states import DenialReason, Denied

__all__ = ["Clock", "Device"]

Clock = Literal["wall", "step"]

_LONGEST_STEP = 60 * SECOND


class Device:
    """Firmware behind a clock, with the services that are no plain objects."""

    def __init__(self, firmware: Firmware, clock: Clock) -> None:
        self.firmware = firmware
        self.stepping = clock == "step"
        self.cycle = round(firmware.axis.cycle * SECOND)
        self._started = time.monotonic_ns() - firmware.now

    def catch_up(self) -> None:
        """On the wall clock: bring physics to now. On the step clock: nothing."""
        if not self.stepping:
            behind = time.monotonic_ns() - self._started - self.firmware.now
            if behind > 0:
                self.firmware.advance(behind)

    def end_cycle(self) -> None:
        """One cyclic exchange is complete; on the step clock its time passes now."""
        if self.stepping:
            self.firmware.advance(self.cycle)

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
            self.firmware.advance(value * 1000)
        elif key == "store_command":
            if value != 1:
                raise Denied(DenialReason.RANGE)
            self.firmware.store()
        else:
            self.firmware.write(key, value)
