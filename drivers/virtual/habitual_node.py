"""The virtual CANopen node with habits of real ones."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.virtual.aborts import Abort
from drivers.virtual.canopen_node import CanopenNode, Frame
from drivers.virtual.device import Device
from drivers.virtual.dictionary import OWN, Dictionary
from drivers.virtual.firmware import SECOND
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.habitual_mirror import mirror_of
from drivers.virtual.mirror import Entry, Mirror
from drivers.virtual.node_pdo import NodePdo
from drivers.virtual.states import State

__all__ = ["HabitualNode"]

_TURNED = 0xC0  # polarity: position and velocity
_SAVE = b"\x23\x10\x10"
_GUARD_TIME, _LIFE_FACTOR = (0x100C, 0), (0x100D, 0)
_PERIOD, _POWER_OF_TEN = (0x60C2, 1), (0x60C2, 2)
_START, _OPERATIONAL, _PRE_OPERATIONAL = 0x01, 0x05, 0x7F
_COMMUNICATION = 0x10  # bit of 1001h
_SYNC_LOST, _NO_TORQUE, _WARNING = 0x8700, 0x8120, 0xFF01  # error codes
_TARGET_TORQUE = 0x6071
_WIDER = {"h": "i", "H": "I"}
_UPLOAD, _DOWNLOAD = 2, 1  # client command specifiers that begin a transfer
_BUSY, _STATE, _RANGE, _READ_ONLY = 0x08000020, 0x08000022, 0x06090030, 0x06010002
_NEIGHBOUR = 9  # another node of the bus
_TOLERANCE = 0.1  # of a period
_FIXED = ([0x607A0020, 0x60400010, 0x60710010], [0x60410010, 0x60770010, 0x60640020])
_OWN_IDS = 0x1B0, 0x3B0  # first TPDO, first RPDO


class HabitualNode(CanopenNode):
    """What a node says and takes, bent by its habits; what it does is the virtual drive's.

    What takes time takes it of the wall: that of a drive that steps stands still while it is asked.
    """

    def __init__(
        self,
        device: Device,
        node_id: int,
        dictionary: Dictionary = OWN,
        habits: Habits = NONE,
        around: Callable[[Mirror], Mirror] = lambda mirror: mirror,
    ) -> None:
        self._habits = habits
        self._late: list[tuple[float, Frame]] = []  # s, and what is said then
        self._saved_until = self._boots_at = self._warned = 0.0  # s
        self._accesses = self._tpdos_sent = 0
        self._synced, self._period = 0, 0  # ns
        self._guard, self._life, self._guard_toggle = 0, 0, 0
        super().__init__(
            device, node_id, _bent(dictionary, habits, device), around(mirror_of(device, habits))
        )
        if "lenient" in habits:
            self._error_behaviour = 1
        if "operational" in habits:
            self.state = _OPERATIONAL

    def _reset_pdos(self) -> None:
        super()._reset_pdos()
        if "fixed-pdo" in self._habits:
            for pdo, entries in zip((self._rpdos[0], self._tpdos[0]), _FIXED, strict=True):
                pdo.entries = entries
                pdo.__post_init__()
        if "own-ids" in self._habits:
            self._tpdos[0].cob_id, self._rpdos[0].cob_id = _OWN_IDS

    # -- frames ----------------------------------------------------------------------------------

    def receive(self, cob_id: int, data: bytes, *, remote: bool = False) -> list[Frame]:
        """Take one frame from the bus."""
        if "slow-boot" in self._habits:
            if not self._boots_at:
                self._boots_at = time.monotonic() + self._habits.seconds("slow-boot")
            if time.monotonic() < self._boots_at:
                return []
            self._up()
        if remote:
            if cob_id == 0x700 + self.node_id and "guarding" in self._habits:
                self._guarded()
            return self._flush()
        return super().receive(cob_id, data)

    def _up(self) -> None:
        """The boot-up message, once."""
        if self._boots_at > 0:
            self._boots_at = -1.0
            self._outbox += self.boot()

    def _guarded(self) -> None:
        """The master asks how it is: life guarding (CiA 301, 7.2.8.3.2.1)."""
        self.device.catch_up()
        self._send(0x700 + self.node_id, bytes((self._guard_toggle | self.state,)))
        self._guard_toggle ^= 0x80
        self.device.firmware.values["watchdog_time"] = self._guard * self._life
        if self._guard * self._life:
            self.device.firmware.feed_watchdog()

    def _nmt(self, command: int) -> None:
        if command == _START:
            register = self._error_register(self.device.firmware.error_code)
            if "refuses-start" in self._habits and register & _COMMUNICATION:
                return
            mapped = {slot >> 16 for pdo in self._rpdos for slot in pdo.slots[: pdo.count]}
            if "needs-torque" in self._habits and _TARGET_TORQUE not in mapped:
                self.device.firmware.trip(_NO_TORQUE)
        super()._nmt(command)

    def _sync(self) -> None:
        now = self.device.firmware.now
        before, self._period, self._synced = self._period, now - self._synced, now
        is_steady = abs(before - self._period) <= _TOLERANCE * self._period
        super()._sync()
        firmware = self.device.firmware
        if "needs-period" in self._habits and firmware.state is State.OPERATION_ENABLED:
            told = self._kept(_PERIOD) * 10.0 ** self._kept(_POWER_OF_TEN) * SECOND
            if is_steady and abs(told - self._period) > _TOLERANCE * self._period:
                firmware.trip(_SYNC_LOST)
        if "chatty" in self._habits:
            for base, data in ((0x180, b"\x37\x02"), (0x700, b"\x05"), (0x080, bytes(8))):
                self._send(base + _NEIGHBOUR, data)

    def _kept(self, at: tuple[int, int]) -> float:
        return self._mirror.value(self._dictionary.objects[at])

    def _emergency(self, code: int) -> None:
        if code or "mute-reset" not in self._habits:
            super()._emergency(code)

    def _send_tpdo(self, pdo: NodePdo) -> None:
        every = self._habits.number("lost-tpdo")
        self._tpdos_sent += 1
        before = len(self._outbox)
        super()._send_tpdo(pdo)
        if every and self._tpdos_sent % every == 0:
            del self._outbox[before:]

    def _timers(self) -> None:
        super()._timers()
        now = time.monotonic()
        if self._boots_at and now >= self._boots_at:
            self._up()
        if "warnings" in self._habits and now - self._warned >= self._habits.seconds("warnings"):
            self._warned = now
            self._emergency(_WARNING)
        due = [frame for at, frame in self._late if at <= now]
        self._late = [(at, frame) for at, frame in self._late if at > now]
        self._outbox += due

    # -- SDO server ------------------------------------------------------------------------------

    def _sdo(self, data: bytes) -> None:
        habits, now = self._habits, time.monotonic()
        begins = bool(data) and data[0] >> 5 in (_UPLOAD, _DOWNLOAD)
        if now < self._saved_until:
            if "busy-save" in habits and begins:
                self._refuse(data, _BUSY)
            return
        if begins and "busy" in habits:
            self._accesses += 1
            if self._accesses % habits.number("busy") == 0:
                self._refuse(data, _STATE)
                return
        before = len(self._outbox)
        super()._sdo(data)
        wait = habits.seconds("slow-answer")
        if data[:3] == _SAVE:
            wait += habits.seconds("slow-save") + habits.seconds("silent-save")
            self._saved_until = now + max(
                habits.seconds("busy-save"), habits.seconds("silent-save")
            )
        if wait:
            self._late += [(now + wait, frame) for frame in self._outbox[before:]]
            del self._outbox[before:]

    def _refuse(self, data: bytes, code: int) -> None:
        self._answer(b"\x80" + data[1:4].ljust(3, b"\0") + struct.pack("<I", code))

    def _answer(self, data: bytes) -> None:
        if data[0] & 0xF3 == 0x43 and "unsized" in self._habits:
            data = b"\x42" + data[1:]
        if "short-sdo" in self._habits:
            self._send(0x580 + self.node_id, data)
        else:
            super()._answer(data)

    def _begin_upload(self, index: int, sub: int) -> None:
        if "segmented" not in self._habits:
            super()._begin_upload(index, sub)
            return
        self._upload, self._toggle = self._read(index, sub), 0
        self._answer(struct.pack("<BHBI", 0x41, index, sub, len(self._upload)))

    def _read(self, index: int, sub: int) -> bytes:
        if "guarding" in self._habits:
            if (index, sub) == _GUARD_TIME:
                return struct.pack("<H", self._guard)
            if (index, sub) == _LIFE_FACTOR:
                return bytes((self._life,))
        return super()._read(index, sub)

    def _write(self, index: int, sub: int, data: bytes, *, sized: bool) -> None:
        if "guarding" in self._habits and (index, sub) in (_GUARD_TIME, _LIFE_FACTOR):
            if (index, sub) == _GUARD_TIME:
                self._guard = self._number(data, "H", sized=sized)
            else:
                self._life = self._number(data, "B", sized=sized)
            self.device.firmware.unwatch()
            return
        super()._write(index, sub, data, sized=sized)

    def _write_pdo(self, pdo: NodePdo, index: int, sub: int, data: bytes) -> None:
        if "locked-pdo" in self._habits and self.state != _PRE_OPERATIONAL:
            raise Abort(_STATE)
        if "fixed-pdo" in self._habits and index & 0x0200:
            raise Abort(_READ_ONLY)
        number = int.from_bytes(data, "little")
        is_id = sub == 1 and not index & 0x0200
        if "own-ids" in self._habits and is_id and (pdo.cob_id ^ number) & 0x7FF:
            raise Abort(_RANGE)
        super()._write_pdo(pdo, index, sub, data)


def _bent(dictionary: Dictionary, habits: Habits, device: Device) -> Dictionary:
    """The objects that a drive with these habits has."""
    objects = _factors(habits, device) | dictionary.objects
    lacking = habits.objects("lacks")
    if "guarding" in habits:
        lacking |= {0x1016, 0x1017}
    for index in habits.objects("wide"):
        for at in [at for at in objects if at[0] == index]:
            code = objects[at].code
            objects[at] = objects[at]._replace(code=_WIDER.get(code, code))
    for index in habits.objects("sub1"):
        if (index, 0) in objects:
            objects[index, 1] = objects.pop((index, 0))
    if "one-limit" in habits:
        objects[0x6073, 0] = Entry(("max_torque",), "H")
    if "low-current" in habits:
        objects[0x6073, 0] = Entry(
            (), "H", default=habits.number("low-current"), name="max_current"
        )
    if "needs-period" in habits:
        objects[_PERIOD] = Entry((), "B", default=1, name="period")
        objects[_POWER_OF_TEN] = Entry((), "b", default=-3, name="power of ten")
    objects = {at: entry for at, entry in objects.items() if at[0] not in lacking}
    return replace(dictionary, objects=objects, lacks=dictionary.lacks | lacking)


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
        found |= {(0x607B, 1): 0, (0x607B, 2): habits.number("modulo") - 1}
    objects = {at: Entry((), "I", default=value, name=f"{at}") for at, value in found.items()}
    if "polarity" in habits:
        objects[0x607E, 0] = Entry((), "B", default=_TURNED, name="polarity")
    return objects
