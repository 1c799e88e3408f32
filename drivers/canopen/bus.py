"""CANopen as a bus: SDO for access, RPDO → SYNC → TPDO for the cycle (CiA 301)."""

from __future__ import annotations

import contextlib
import struct
from time import perf_counter

from drivers.canopen.wire import SYNC, CanWire
from drivers.drive import Exchange
from drivers.pace import Pace
from drivers.stepping import set_simulation
from profiles.errors import (
    AccessDenied,
    LinkError,
    LinkLost,
    PreflightRefused,
    ProfileError,
    TwoRelayError,
)
from profiles.schema import WIDTH_BITS, Address, CanopenAddress, Identity, Profile

__all__ = ["CanopenBus", "identify"]

MISSED_CYCLES = 3  # consecutive cycles without a sample are a lost link (safety, receive deadline)

NMT_OPERATIONAL = 0x01
NMT_PRE_OPERATIONAL = 0x80
_STATE_OPERATIONAL = 0x05
_STATES = {0x00: "booting", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}
_HEARTBEAT_EVERY = 100  # ms, asked of a node that has none
_HEARTBEATS_MISSED = 3
_SYNCS_LOOKED_AT = 20
_SYNC_PATIENCE = 1.0  # s
_SYNC_TOLERANCE = 0.1  # of the cycle
_PDO_OFF = 1 << 31
_PDO_FLAGS = 3 << 29  # no RTR, 29-bit frame: the drive's own
_EVENT_DRIVEN = 255
_EVERY_SYNC = 1

_CODE = {
    "i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I", "i64": "q", "u64": "Q",
}  # fmt: skip


def identify(wire: CanWire) -> Identity:
    """Identity object 1018h."""
    numbers = []
    for sub in (1, 2, 3, 4):
        try:
            numbers.append(int.from_bytes(wire.upload(0x1018, sub)[:4], "little"))
        except AccessDenied:
            numbers.append(0)
    vendor, product, revision, serial = (f"0x{number:08X}" for number in numbers)
    return Identity(vendor=vendor, product=product, revision=revision, serial=serial)


class CanopenBus:
    """One node on one wire."""

    def __init__(self, wire: CanWire, profile: Profile, pace: Pace) -> None:
        self.cycle = pace.cycle
        self.in_real_time = not pace.stepping
        self._wire = wire
        self._profile = profile
        self._pace = pace
        # simulated time stands still while an answer is awaited: any service's patience will do
        self._deadline = (
            wire.patience if pace.stepping else max(pace.cycle, profile.watchdog.deadline)
        )
        cycle = profile.cycle
        self._out = [_canopen(profile.parameters[name].address) for name in cycle.out]
        self._in = [_canopen(profile.parameters[name].address) for name in cycle.in_]
        self._out_format = struct.Struct("<" + "".join(_CODE[a.type] for a in self._out))
        self._in_format = struct.Struct("<" + "".join(_CODE[a.type] for a in self._in))
        for what, layout in (("out", self._out_format), ("in", self._in_format)):
            if layout.size > 8:
                raise ProfileError(
                    f"profile '{profile.name}': [cycle] {what} takes {layout.size} bytes; a PDO "
                    "has 8"
                )
        self._rpdo = _Pdo(0x1400 + cycle.rpdo - 1, 0x1600 + cycle.rpdo - 1)
        self._tpdo = _Pdo(0x1800 + cycle.tpdo - 1, 0x1A00 + cycle.tpdo - 1)
        self._restore: list[tuple[int, int, bytes]] = []
        self._running = False
        self._idle: tuple[int, ...] = ()
        watchdog = profile.watchdog
        self._heartbeat = 0x700 + watchdog.node if watchdog.kind == "heartbeat" else None
        self._heartbeat_every = watchdog.timeout / 4
        self._heartbeat_due = -1.0
        self._silence_allowed = 0.0  # s without a heartbeat of the node; 0: it has none
        if pace.stepping:
            set_simulation(self.write, profile, "simulation_cycle", pace.cycle, self._is_twin)

    def _is_twin(self) -> bool:
        """Whether the device name 1008h is that of a virtual drive in another one's clothes."""
        try:
            return self._wire.upload(0x1008, 0).startswith(b"twin of ")
        except AccessDenied:
            return False

    def identify(self) -> Identity:
        """Ask the drive who it is."""
        return identify(self._wire)

    def read(self, address: Address) -> int:
        """Raw value by SDO; raises LinkError, AccessDenied."""
        at = _canopen(address)
        data = self._wire.upload(at.index, at.sub)
        layout = struct.Struct("<" + _CODE[at.type])
        if len(data) < layout.size:
            raise LinkError(f"{at} has {len(data)} bytes in the drive, not {layout.size}")
        value: int = layout.unpack_from(data)[0]
        return value

    def write(self, address: Address, raw: int) -> None:
        """Write a raw value by SDO; raises LinkError, AccessDenied."""
        at = _canopen(address)
        self._wire.download(at.index, at.sub, struct.pack("<" + _CODE[at.type], raw))

    def post(self, address: Address, raw: int) -> None:
        """By RPDO where the value is mapped and the cycle runs, and by SDO; without waiting."""
        at = _canopen(address)
        if self._running and at in self._out:
            frame = list(self._idle)
            frame[self._out.index(at)] = raw
            self._idle = tuple(frame)
            self._wire.send(self._rpdo.cob_id, self._out_format.pack(*frame))
        self._wire.post_download(at.index, at.sub, struct.pack("<" + _CODE[at.type], raw))

    def descriptor(self) -> int | None:
        """Of a serial adapter; other adapters are shared."""
        return self._wire.descriptor

    def frame(self, address: Address, raw: int) -> bytes:
        """An SDO download as a serial adapter takes it."""
        at = _canopen(address)
        data = struct.pack("<" + _CODE[at.type], raw)
        return self._wire.serial_line(at.index, at.sub, data)

    # -- cycle -----------------------------------------------------------------------------------

    def start(self, idle: tuple[int, ...]) -> None:
        """Map the PDOs, start the node, and expect its TPDO with every SYNC."""
        self._idle = idle
        if self._running:
            return
        if self._wire.awaits_sync:
            self._check_sync()
        self._wire.nmt(NMT_PRE_OPERATIONAL)
        self._map(self._rpdo, self._out, _EVENT_DRIVEN, 0x100 + 0x100 * self._profile.cycle.rpdo)
        self._map(self._tpdo, self._in, _EVERY_SYNC, 0x80 + 0x100 * self._profile.cycle.tpdo)
        self._wire.listen_tpdo(self._tpdo.cob_id)
        if self.in_real_time:
            self._ask_for_heartbeat()
        self._wire.nmt(NMT_OPERATIONAL)
        self._wire.restarted = False
        self._wire.heard_at = perf_counter()
        self._running = True

    def _check_sync(self) -> None:
        """See that SYNC comes as often as the cycle says; raises PreflightRefused."""
        wire, begins = self._wire, []
        for _ in range(_SYNCS_LOOKED_AT):
            wire.syncs = 0
            if not wire.await_sync(max(_SYNC_PATIENCE, 3 * self.cycle)):
                raise PreflightRefused(
                    f"no SYNC on the bus within {_SYNC_PATIENCE:g} s: is its producer on? Without "
                    "sync=bus in the link, tworelay produces it"
                )
            begins.append(perf_counter())
        period = (begins[-1] - begins[0]) / (len(begins) - 1)
        if abs(period - self.cycle) > _SYNC_TOLERANCE * self.cycle:
            raise PreflightRefused(
                f"SYNC comes every {period * 1000:.3g} ms and the cycle is {self.cycle * 1000:g} ms: give "
                f"--cycle {round(period, 4):g}"
            )

    def _ask_for_heartbeat(self) -> None:
        """See that the node produces a heartbeat (1017h); one without it is known by its TPDO only."""
        try:
            every = int.from_bytes(self._wire.upload(0x1017, 0)[:2], "little")
            if not every:
                self._wire.download(0x1017, 0, struct.pack("<H", _HEARTBEAT_EVERY))
                self._restore.append((0x1017, 0, b"\0\0"))
                every = _HEARTBEAT_EVERY
        except AccessDenied:
            return
        self._silence_allowed = _HEARTBEATS_MISSED * every / 1000

    def _supervise(self) -> None:
        """Raises LinkLost where the node has restarted, or fallen silent."""
        wire = self._wire
        if wire.restarted:
            wire.restarted = False  # said once: the stop path still waits for standstill
            raise LinkLost(
                f"node {wire.node} has restarted (its boot-up message was heard): was its supply "
                "interrupted?"
            )
        if not self._silence_allowed:
            return
        silent = perf_counter() - wire.heard_at
        if silent > self._silence_allowed:
            self._silence_allowed = 0.0
            raise LinkLost(
                f"no heartbeat from node {wire.node} for {silent * 1000:.0f} ms: the link is lost"
            )

    def _map(
        self, pdo: _Pdo, wanted: list[CanopenAddress], transmission: int, default_id: int
    ) -> None:
        """Write a PDO's mapping, unless the drive has it already; remember what was there."""
        wire = self._wire
        raw_id = _u32(wire.upload(pdo.communication, 1))
        pdo.cob_id = raw_id & 0x7FF or default_id + wire.node
        number = raw_id & _PDO_FLAGS | pdo.cob_id
        kind = wire.upload(pdo.communication, 2)[:1]
        count = wire.upload(pdo.mapping, 0)[0]
        there = [_u32(wire.upload(pdo.mapping, n + 1)) for n in range(count)]
        entries = [a.index << 16 | a.sub << 8 | WIDTH_BITS[a.type] for a in wanted]
        if there == entries and kind == bytes((transmission,)) and not raw_id & _PDO_OFF:
            return
        # put back in reverse order: off, transmission, no entries, entries, count, as it was
        self._restore += [
            (pdo.communication, 1, struct.pack("<I", raw_id)),
            (pdo.mapping, 0, bytes((count,))),
            *((pdo.mapping, n + 1, struct.pack("<I", entry)) for n, entry in enumerate(there)),
            (pdo.mapping, 0, b"\0"),
            (pdo.communication, 2, kind),
            (pdo.communication, 1, struct.pack("<I", raw_id | _PDO_OFF)),
        ]
        wire.download(pdo.communication, 1, struct.pack("<I", number | _PDO_OFF))
        wire.download(pdo.communication, 2, bytes((transmission,)))
        wire.download(pdo.mapping, 0, b"\0")
        for n, entry in enumerate(entries):
            wire.download(pdo.mapping, n + 1, struct.pack("<I", entry))
        wire.download(pdo.mapping, 0, bytes((len(entries),)))
        wire.download(pdo.communication, 1, struct.pack("<I", number))
        found = [_u32(wire.upload(pdo.mapping, n + 1)) for n in range(len(entries))]
        if found != entries:
            raise AccessDenied(
                f"the drive did not take the mapping of {pdo.mapping:04X}h: it reads "
                + ", ".join(f"{entry:08X}h" for entry in found)
            )

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        """Command by RPDO now, SYNC at the deadline, feedback by TPDO."""
        wire, pace = self._wire, self._pace
        payload = self._out_format.pack(*values)
        missed = 0
        if wire.awaits_sync:
            wire.drain()
            missed, wire.syncs = wire.syncs, 0  # those that nobody was there for
        lost = 0
        while True:
            wire.send(self._rpdo.cob_id, payload)
            sent = pace.now()
            if self._heartbeat is not None and sent >= self._heartbeat_due:
                wire.send(self._heartbeat, bytes((_STATE_OPERATIONAL,)))
                self._heartbeat_due = sent + self._heartbeat_every
            if wire.awaits_sync:
                self._supervise()
                wire.await_sync(self._deadline)
                lateness, time = missed * self.cycle, pace.now()
                wire.syncs = 0
            else:
                lateness = pace.next_deadline()
                wire.drain()
                self._supervise()
                time = pace.now()
                wire.send(SYNC, b"")
            data = wire.take_tpdo(self._deadline)
            if data is not None and len(data) >= self._in_format.size:
                return Exchange(
                    self._in_format.unpack_from(data), values, sent, time, lateness, missed
                )
            missed, lost = missed + 1, lost + 1
            if lost >= MISSED_CYCLES:
                raise LinkLost(
                    f"no TPDO from node {wire.node} for {lost} cycles of "
                    f"{self.cycle * 1000:g} ms: the link is lost{self._last_word()}"
                )

    def _last_word(self) -> str:
        """What the node or the adapter said last, as far as it explains a silence."""
        wire = self._wire
        if wire.bus_trouble:
            return f"; {wire.bus_trouble}"
        state = wire.heartbeat_state
        if not self._silence_allowed or state in (None, _STATE_OPERATIONAL):
            return ""
        return f"; its heartbeat says '{_STATES.get(state, f'{state:02X}h')}'"

    def wait(self, seconds: float) -> None:
        """Let time pass; on a stepping drive, by asking it to."""
        if self._pace.stepping:
            set_simulation(self.write, self._profile, "simulation_advance", seconds, self._is_twin)
        self._pace.pass_time(seconds)
        if self._running and self.in_real_time:
            self._wire.drain()
            self._supervise()

    def other_master(self) -> str:
        """COB-ID of a frame that only another master would send."""
        self._wire.drain()
        seen = self._wire.foreign_master
        return "" if seen is None else f"a frame with COB-ID {seen:03X}h"

    def trouble(self) -> str:
        """Last emergency of the node."""
        if self._wire.emergency is None:
            return ""
        code, register = self._wire.emergency
        return f"emergency {code:04X}h, error register {register:02X}h"

    def close(self) -> None:
        """Put the PDO mapping back and let go of the adapter."""
        self._running = False
        try:
            if self._restore:
                self._wire.nmt(NMT_PRE_OPERATIONAL)
            for index, sub, data in reversed(self._restore):
                with contextlib.suppress(AccessDenied):  # volatile, and the next entry may be taken
                    self._wire.download(index, sub, data)
        except TwoRelayError:
            self._restore.clear()  # a dead link is reported by whoever used it
        finally:
            self._wire.close()


class _Pdo:
    """Where a PDO's parameters are, and its COB-ID once it is known."""

    def __init__(self, communication: int, mapping: int) -> None:
        self.communication = communication
        self.mapping = mapping
        self.cob_id = 0


def _u32(data: bytes) -> int:
    return int.from_bytes(data[:4], "little")


def _canopen(address: Address) -> CanopenAddress:
    assert isinstance(address, CanopenAddress)  # the profile's bus was checked when it was loaded
    return address
