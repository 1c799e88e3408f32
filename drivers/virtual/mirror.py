"""Object values against the firmware's.

Scale, and what stands behind an object that does nothing.
"""

from __future__ import annotations

from contextlib import suppress
from math import isfinite
from typing import NamedTuple

from drivers.virtual.device import Device
from drivers.virtual.states import DenialReason, Denied
from drivers.virtual.switchgear import Switchgear

__all__ = ["Entry", "Mirror"]

_LIMITS = {
    code: (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)
    for code, bits in {"b": 8, "B": 8, "h": 16, "H": 16, "i": 32, "I": 32, "q": 64, "Q": 64}.items()
}


class Entry(NamedTuple):
    """Object that mirrors firmware values: object value times `factor` is the firmware's.

    `keys`: every one is written, the first is read; none: the object keeps a value by its `name`
    and does nothing by itself. `codes`: values of the object, each with the firmware's for it.
    """

    keys: tuple[str, ...]
    code: str
    access: str = "rw"
    factor: float = 1.0
    default: float = 0
    name: str = ""
    codes: tuple[tuple[int, int], ...] = ()


class Mirror:
    """Reads and writes the objects of one device.

    `switchgear`: what some of them do to the power. `keeps`: every write lasts, there is no store.
    """

    def __init__(
        self, device: Device, switchgear: Switchgear | None = None, *, keeps: bool = False
    ) -> None:
        self._device = device
        self._switchgear = switchgear
        self._keeps = keeps
        self._kept: dict[str, float] = {}

    def value(self, entry: Entry) -> float:
        """Object value, in the object's own steps; raises Denied."""
        if self._switchgear is not None:
            told = self._switchgear.says(entry.name)
            if told is not None:
                return told
        if not entry.keys:
            return self._kept.get(entry.name, entry.default)
        stored = self._device.read(entry.keys[0])
        for code, meant in entry.codes:
            if stored == meant:
                return code
        value = stored / entry.factor
        if entry.code == "f":  # a number is read as it was written, finer than the firmware counts
            written = self._kept.get(entry.name, value)
            return written if round(written * entry.factor) == stored else value
        low, high = _LIMITS[entry.code]
        return max(low, min(high, round(value)))

    def set(self, entry: Entry, value: float) -> None:
        """Write an object value to all that it mirrors; raises Denied."""
        if not isfinite(value):
            raise Denied(DenialReason.RANGE)
        if not entry.keys or entry.code == "f":
            self._kept[entry.name] = value
        meant = dict(entry.codes).get(int(value), value)
        for key in entry.keys:
            self._device.write(key, round(meant * entry.factor))
        if self._switchgear is not None:
            self._switchgear.written(entry.name, int(value))
        if self._keeps:
            with suppress(Denied):  # while it is enabled, the last value is kept with the next one
                self._device.firmware.store()
