"""The virtual CANopen node with habits of real ones."""

from __future__ import annotations

import time
from dataclasses import replace

from drivers.virtual.canopen_node import CanopenNode, Frame
from drivers.virtual.device import Device
from drivers.virtual.dictionary import OWN, Dictionary
from drivers.virtual.firmware import SECOND
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.mirror import Entry

__all__ = ["HabitualNode"]

_FAULT, _RESET = 0x0208, 0x80  # statusword: fault; controlword: its reset
_POSITIONS = {"position_actual", "position_target", "velocity_actual", "velocity_target"}
_TURNED = 0xC0  # polarity: position and velocity
_SAVE = b"\x23\x10\x10"


class HabitualNode(CanopenNode):
    """What a node says, bent by its habits; what it does is the virtual drive's."""

    def __init__(
        self,
        device: Device,
        node_id: int,
        dictionary: Dictionary = OWN,
        habits: Habits = NONE,
    ) -> None:
        self._habits = habits
        lacking = self._habits.lacking
        objects = _factors(self._habits, device) | dictionary.objects
        objects = {at: entry for at, entry in objects.items() if at[0] not in lacking}
        super().__init__(
            device,
            node_id,
            replace(dictionary, objects=objects, lacks=dictionary.lacks | lacking),
        )
        increments = device.firmware.read("encoder_increments")
        self._units = (habits.units or increments) / increments  # a count
        if "polarity" in habits:
            self._units = -self._units
        self._range = -(1 << 31), 1 << 32  # least, and how many
        if "modulo" in habits:
            self._range = 0, habits.counts("modulo")
        self._began = (1 << 31) - habits.counts("wrap") if "wrap" in habits else 0
        if "lenient" in self._habits:
            self._error_behaviour = 1
        self._fault_until = self._mode_until = 0  # ns
        self._mode_before = 0
        self._late: list[tuple[float, Frame]] = []  # s of the wall, and what is said then

    @property
    def _now(self) -> int:
        return self.device.firmware.now

    def _value(self, entry: Entry) -> float:
        shown = super()._value(entry)
        if _POSITIONS & set(entry.keys):
            return self._counted(round(shown * self._units), entry)
        if "statusword" in entry.keys and self._now < self._fault_until:
            return _FAULT
        if "mode_display" in entry.keys and self._now < self._mode_until:
            return self._mode_before
        return shown

    def _set(self, entry: Entry, value: float) -> None:
        mode = self.device.firmware.read("mode_display")
        if _POSITIONS & set(entry.keys):
            value = round(self._meant(int(value), entry) / self._units)
        super()._set(entry, value)
        if "controlword" in entry.keys and int(value) & _RESET:
            self._fault_until = self._now + round(self._habits.seconds("slow-reset") * SECOND)
        if "mode" in entry.keys and value != mode:
            self._mode_before = mode
            self._mode_until = self._now + round(self._habits.seconds("slow-mode") * SECOND)

    def _counted(self, count: int, entry: Entry) -> int:
        """A position as its counter shows it, from where it stood."""
        if "velocity_actual" in entry.keys or "velocity_target" in entry.keys:
            return count
        low, width = self._range
        return (count + self._began - low) % width + low

    def _meant(self, shown: int, entry: Entry) -> int:
        """The position nearest to the axis' own that a counter shows as `shown`."""
        if "position_target" not in entry.keys:
            return shown
        here = round(self.device.firmware.read("position_actual") * self._units)
        width = self._range[1]
        turned = (shown - self._began - here + width // 2) % width - width // 2
        return here + turned

    def _sdo(self, data: bytes) -> None:
        before = len(self._outbox)
        super()._sdo(data)
        if data[:3] == _SAVE and "slow-save" in self._habits:
            # of the wall: the time of a drive that steps stands still while its answer is awaited
            at = time.monotonic() + self._habits.seconds("slow-save")
            self._late += [(at, frame) for frame in self._outbox[before:]]
            del self._outbox[before:]

    def _answer(self, data: bytes) -> None:
        if "short-sdo" in self._habits:
            self._send(0x580 + self.node_id, data)
        else:
            super()._answer(data)

    def _timers(self) -> None:
        super()._timers()
        now = time.monotonic()
        due = [frame for at, frame in self._late if at <= now]
        self._late = [(at, frame) for at, frame in self._late if at > now]
        self._outbox += due


def _factors(habits: Habits, device: Device) -> dict[tuple[int, int], Entry]:
    """Objects of CiA 402's factor group that say in which units it counts."""
    found: dict[tuple[int, int], int] = {}
    units = habits.units
    if "feed" in habits:
        found = {(0x6092, 1): units, (0x6092, 2): 1}
    elif "gear" in habits:
        found = {(0x6091, 1): 10, (0x6091, 2): 1, (0x6092, 1): 10 * units, (0x6092, 2): 1}
    elif "old-factor" in habits:
        increments = device.firmware.read("encoder_increments")
        found = {(0x6093, 1): increments, (0x6093, 2): units}
    if "delivered" in habits:
        found |= {(index, sub): 1 for index in (0x6091, 0x6092) for sub in (1, 2)}
    if "modulo" in habits:
        found |= {(0x607B, 1): 0, (0x607B, 2): habits.counts("modulo") - 1}
    objects = {at: Entry((), "I", default=value, name=f"{at}") for at, value in found.items()}
    if "polarity" in habits:
        objects[0x607E, 0] = Entry((), "B", default=_TURNED, name="polarity")
    return objects
