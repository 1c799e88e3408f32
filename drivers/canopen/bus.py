"""CANopen as a bus: SDO for access, RPDO → SYNC → TPDO for the cycle (CiA 301)."""

from __future__ import annotations

import contextlib
import re
import struct
from contextlib import AbstractContextManager
from itertools import combinations
from statistics import median
from time import perf_counter

from drivers.canopen.wire import SYNC, CanWire
from drivers.drive import Exchange
from drivers.pace import Pace
from drivers.serial_port import SerialPort, Stream
from drivers.stepping import set_simulation
from profiles.errors import (
    AccessDenied,
    LinkError,
    LinkLost,
    PreflightRefused,
    ProfileError,
    TwoRelayError,
    UsageError,
    WriteDenied,
    WriteFailed,
)
from profiles.schema import WIDTH_BITS, Address, CanopenAddress, Identity, Profile

__all__ = ["CanopenBus", "identify", "sync_period"]

MISSED_CYCLES = 3  # consecutive cycles without a sample are a lost link (safety, receive deadline)

NMT_OPERATIONAL = 0x01
NMT_PRE_OPERATIONAL = 0x80
_STATE_OPERATIONAL = 0x05
# NMT command that brings a node into the state that its heartbeat told
_COMMANDS: dict[int | None, int] = {
    0x00: NMT_PRE_OPERATIONAL, 0x04: 0x02, 0x05: NMT_OPERATIONAL, 0x7F: NMT_PRE_OPERATIONAL,
}  # fmt: skip
_STATES = {0x00: "booting", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}
_HEARTBEAT_EVERY = 100  # ms, asked of a node that has none
_HEARTBEATS_MISSED = 3
_CONSUMER_BEGINS = 0.005  # s from the first beat to the second, before the node is started again
_SYNCS_LOOKED_AT = 20
_SYNC_PATIENCE = 1.0  # s
_SYNC_TOLERANCE = 0.1  # of the cycle
_PDO_OFF = 1 << 31
_PDO_FLAGS = 3 << 29  # no RTR, 29-bit frame: the drive's own
_EVENT_DRIVEN = 255
_EVERY_SYNC = 1
_HEARTBEAT_PRODUCER = 0x1017, 0
_MAPPING = 0x200  # from a PDO's communication parameters to its mapping
_OBJECT = re.compile(r"([0-9A-F]{4})h:([0-9A-F]{2})")

Objects = dict[tuple[int, int], int]  # raw values by index and sub-index

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

    def __init__(
        self, wire: CanWire, profile: Profile, pace: Pace, lacking: tuple[str, ...] = ()
    ) -> None:
        self.cycle = pace.cycle
        self.in_real_time = not pace.stepping
        self.lacking = lacking
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
        self._rpdo = _Pdo(
            0x1400 + cycle.rpdo - 1,
            _EVENT_DRIVEN,
            0x100 + 0x100 * cycle.rpdo + wire.node,
            self._out,
        )
        self._tpdo = _Pdo(
            0x1800 + cycle.tpdo - 1, _EVERY_SYNC, 0x80 + 0x100 * cycle.tpdo + wire.node, self._in
        )
        self._old: Objects = {}  # what was there before `start`
        self._running = False
        self._state_before: int | None = (
            None  # of the node, as its heartbeat said it before `start`
        )
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
        """Write a raw value by SDO; raises LinkError, WriteDenied."""
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

    def port(self) -> SerialPort | None:
        """The port of a serial adapter."""
        return self._wire.port()

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on."""
        self._wire.speak_through(stream)

    def frame(self, address: Address, raw: int) -> bytes:
        """An SDO download as a serial adapter takes it."""
        at = _canopen(address)
        data = struct.pack("<" + _CODE[at.type], raw)
        return self._wire.serial_line(at.index, at.sub, data)

    # -- cycle -----------------------------------------------------------------------------------

    def start(self, idle: tuple[int, ...]) -> None:
        """Map the PDOs, start the node, and expect its TPDO with every SYNC."""
        self._idle = idle
        self._heartbeat_due = -1.0
        if self._running:
            self._start_again()
            return
        if self._wire.awaits_sync:
            self._check_sync()
        self._wire.drain()
        if self._state_before is None:
            self._state_before = self._wire.heartbeat_state
        self._wire.nmt(NMT_PRE_OPERATIONAL)
        for pdo in (self._rpdo, self._tpdo):
            there = self._there(pdo.communication)
            wanted = pdo.wanted(there)
            if not _agree(there, wanted):
                self._old |= there | self._beyond(pdo, there)
                self._configure(pdo.communication, wanted)
                self._check_mapping(pdo)
        self._wire.listen_tpdo(self._tpdo.cob_id)
        if self.in_real_time:
            self._ask_for_heartbeat()
        self._wire.nmt(NMT_OPERATIONAL)
        self._wire.restarted = False
        self._wire.heard_at = perf_counter()
        self._running = True
        self._beat()  # the drive watches from the first one on: before it is enabled, not after

    def _start_again(self) -> None:
        """A node that has lost our heartbeat is not operational any more (1029h:01 = 0)."""
        self._beat()
        if self._heartbeat is None:
            return
        self.wait(_CONSUMER_BEGINS)
        self._heartbeat_due = -1.0
        self._beat()
        self._wire.nmt(NMT_OPERATIONAL)

    def changes(self) -> dict[str, tuple[int, int]]:
        """PDO parameters and heartbeat time that `start` changes: what is there, and what will be."""
        found: dict[str, tuple[int, int]] = {}
        if self._running:
            return found
        for pdo in (self._rpdo, self._tpdo):
            there = self._there(pdo.communication)
            wanted = pdo.wanted(there)
            if not _agree(there, wanted):
                there |= self._beyond(pdo, there)
                found |= {_name(at): (old, wanted.get(at, 0)) for at, old in there.items()}
        if self.in_real_time and self._heartbeat_time() == 0:
            found[_name(_HEARTBEAT_PRODUCER)] = 0, _HEARTBEAT_EVERY
        return found

    def put_back(self, old: dict[str, int]) -> bool:
        """Write back what `changes` named; the cycle ends with it. False: all was as before."""
        ours = {pdo.communication for pdo in (self._rpdo, self._tpdo)}
        objects: Objects = {}
        for name, raw in old.items():  # from a journal, which anybody may have written
            match = _OBJECT.fullmatch(name)
            at = (int(match[1], 16), int(match[2], 16)) if match is not None else (0, 0)
            if not (at == _HEARTBEAT_PRODUCER or at[0] & ~_MAPPING in ours):
                raise UsageError(f"'{name}' is no parameter of the profile, and none of its PDOs")
            if not 0 <= raw < 1 << 8 * _size(at):
                raise UsageError(f"{name}: {raw} does not fit into {_size(at)} bytes")
            objects[at] = raw
        for communication in {index & ~_MAPPING for index, _ in objects} & ours:
            _complete(communication, objects)
        self._running = False
        return self._put_back(objects)

    def _put_back(self, objects: Objects) -> bool:
        """Each PDO by itself, then the heartbeat; raises WriteFailed for those that are not back."""
        changed, failures = False, []
        for communication in (self._rpdo.communication, self._tpdo.communication):
            part = {at: raw for at, raw in objects.items() if at[0] & ~_MAPPING == communication}
            try:
                changed |= bool(part) and self._put_back_pdo(communication, part)
            except (AccessDenied, WriteFailed) as error:
                failures.append(str(error))
        every = objects.get(_HEARTBEAT_PRODUCER)
        if every is not None and self._heartbeat_time() not in (None, every):
            changed = True
            try:
                self._download(_HEARTBEAT_PRODUCER, every)
            except AccessDenied as error:
                failures.append(str(error))
        command = _COMMANDS.get(self._state_before)
        left = self._heartbeat is not None  # a node that hears none leaves 'operational' by itself
        if command is not None and (left or self._wire.nmt_commanded != command):
            self._wire.nmt(command)
        if failures:
            raise WriteFailed("; ".join(failures))
        self._old = {at: raw for at, raw in self._old.items() if at not in objects}
        return changed

    def _put_back_pdo(self, communication: int, objects: Objects) -> bool:
        """False: it was as before. Raises AccessDenied, WriteFailed."""
        mapping = communication + _MAPPING
        unused = {
            at: raw
            for at, raw in objects.items()
            if at[0] == mapping and at[1] > objects[mapping, 0]
        }
        used = {at: raw for at, raw in objects.items() if at not in unused}
        if self._there(communication) == used and all(
            self._number(*at) == raw for at, raw in unused.items()
        ):
            return False
        self._wire.nmt(NMT_PRE_OPERATIONAL)
        self._configure(communication, used, unused)
        there = self._there(communication)
        if not _agree(there, used):
            wrong = [_name(at) for at, raw in used.items() if there.get(at) != raw]
            raise WriteFailed(f"the drive did not take {', '.join(wrong)} back")
        return True

    def _there(self, communication: int) -> Objects:
        """Parameters of a PDO as the drive has them; entries only as far as they count."""
        mapping = communication + _MAPPING
        there = {(communication, sub): self._number(communication, sub) for sub in (1, 2)}
        count = there[mapping, 0] = self._number(mapping, 0)
        for sub in range(1, count + 1):
            there[mapping, sub] = self._number(mapping, sub)
        return there

    def _beyond(self, pdo: _Pdo, there: Objects) -> Objects:
        """Entries of a mapping that do not count, as far as ours will lie there and they can be read."""
        mapping, found = pdo.communication + _MAPPING, Objects()
        for sub in range(there[mapping, 0] + 1, len(pdo.entries) + 1):
            with contextlib.suppress(AccessDenied):
                found[mapping, sub] = self._number(mapping, sub)
        return found

    def _configure(
        self, communication: int, objects: Objects, unused: Objects | None = None
    ) -> None:
        """Write the parameters of one PDO in the order of CiA 301, 7.5.2.36: off, entries, on.

        Of entries that do not count, what the drive does not take stays: it has no effect.
        """
        mapping = communication + _MAPPING
        number = objects[communication, 1]
        self._download((communication, 1), number | _PDO_OFF)
        self._download((communication, 2), objects[communication, 2])
        self._download((mapping, 0), 0)
        for sub in range(1, objects[mapping, 0] + 1):
            self._download((mapping, sub), objects[mapping, sub])
        for at, raw in (unused or {}).items():
            with contextlib.suppress(AccessDenied):
                self._download(at, raw)
        self._download((mapping, 0), objects[mapping, 0])
        self._download((communication, 1), number)

    def _check_mapping(self, pdo: _Pdo) -> None:
        mapping = pdo.communication + _MAPPING
        found = [self._number(mapping, sub + 1) for sub in range(len(pdo.entries))]
        if found != pdo.entries:
            raise WriteDenied(
                f"the drive did not take the mapping of {mapping:04X}h: it reads "
                + ", ".join(f"{entry:08X}h" for entry in found)
            )

    def _number(self, index: int, sub: int) -> int:
        return int.from_bytes(self._wire.upload(index, sub)[: _size((index, sub))], "little")

    def _download(self, at: tuple[int, int], raw: int) -> None:
        self._wire.download(*at, raw.to_bytes(_size(at), "little"))

    def _check_sync(self) -> None:
        """See that SYNC comes as often as the cycle says; raises PreflightRefused."""
        wire, arrivals = self._wire, []
        wire.drain()
        for _ in range(_SYNCS_LOOKED_AT):
            wire.syncs = 0
            if not wire.await_sync(max(_SYNC_PATIENCE, 3 * self.cycle)):
                raise PreflightRefused(
                    f"no SYNC on the bus within {_SYNC_PATIENCE:g} s: is its producer on? Without "
                    "sync=bus in the link, tworelay produces it"
                )
            arrivals.append(perf_counter())
        period = sync_period(arrivals)
        if abs(period - self.cycle) > _SYNC_TOLERANCE * self.cycle:
            raise PreflightRefused(
                f"SYNC comes every {period * 1000:g} ms and the cycle is {self.cycle * 1000:g} ms: give "
                f"--cycle {period:g}"
            )

    def _heartbeat_time(self) -> int | None:
        """Producer heartbeat time (1017h), ms; None: the node has none."""
        try:
            return self._number(*_HEARTBEAT_PRODUCER)
        except AccessDenied:
            return None

    def _ask_for_heartbeat(self) -> None:
        """See that the node produces a heartbeat (1017h); one without it is known by its TPDO only."""
        every = self._heartbeat_time()
        if every == 0:
            every = _HEARTBEAT_EVERY
            try:
                self._download(_HEARTBEAT_PRODUCER, every)
            except AccessDenied:
                return
            self._old[_HEARTBEAT_PRODUCER] = 0
        if every is not None:
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
            self._beat()
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

    def _beat(self) -> None:
        """Our heartbeat, where the drive watches it and it is due."""
        now = self._pace.now()
        if self._heartbeat is not None and now >= self._heartbeat_due:
            self._wire.send(self._heartbeat, bytes((_STATE_OPERATIONAL,)))
            self._heartbeat_due = now + self._heartbeat_every

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

    def answering_within(self, seconds: float) -> AbstractContextManager[None]:
        """Requests meanwhile may take so long to be answered, if that is more than usual."""
        return self._wire.answering_within(seconds)

    def now(self) -> float:
        """Time of the cycle's clock, s."""
        return self._pace.now()

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
        """Put back what `start` changed, and let go of the adapter."""
        self._running = False
        try:
            # a dead link is reported by whoever used it
            with contextlib.suppress(TwoRelayError):
                self._put_back(self._old)
        finally:
            self._wire.close()


class _Pdo:
    """A PDO and what it is to carry; its COB-ID once it is known."""

    def __init__(
        self, communication: int, transmission: int, default_id: int, mapped: list[CanopenAddress]
    ) -> None:
        self.communication = communication
        self.transmission = transmission
        self.default_id = default_id
        self.entries = [a.index << 16 | a.sub << 8 | WIDTH_BITS[a.type] for a in mapped]
        self.cob_id = 0

    def wanted(self, there: Objects) -> Objects:
        """Its parameters, with the COB-ID that the drive has for it, where it has one."""
        communication, mapping = self.communication, self.communication + _MAPPING
        number = there[communication, 1]
        self.cob_id = number & 0x7FF or self.default_id
        return {
            (communication, 1): number & _PDO_FLAGS | self.cob_id,
            (communication, 2): self.transmission,
            (mapping, 0): len(self.entries),
            **{(mapping, n): entry for n, entry in enumerate(self.entries, 1)},
        }


def sync_period(arrivals: list[float]) -> float:
    """Period of messages, s, to 0.1 ms; late arrivals count little (slope of Theil and Sen)."""
    pairs = combinations(enumerate(arrivals), 2)
    return round(median((after - before) / (n - m) for (m, before), (n, after) in pairs), 4)


def _agree(there: Objects, wanted: Objects) -> bool:
    """Whether the drive has a PDO as it is wanted; flags that are not ours do not count."""
    return there.keys() == wanted.keys() and all(
        there[at] == raw
        or (at[1] == 1 and not at[0] & _MAPPING and not (there[at] | raw) & _PDO_OFF)
        for at, raw in wanted.items()
    )


def _size(at: tuple[int, int]) -> int:
    """Bytes of an object (CiA 301, 7.5.2)."""
    index, sub = at
    if at == _HEARTBEAT_PRODUCER:
        return 2
    if sub == 0 or (sub == 2 and not index & _MAPPING):
        return 1  # number of entries, transmission type
    return 4


def _complete(communication: int, objects: Objects) -> None:
    """Raise UsageError where the journal does not hold all of a PDO."""
    mapping = communication + _MAPPING
    wanted = [(communication, 1), (communication, 2), (mapping, 0)]
    wanted += [(mapping, sub) for sub in range(1, objects.get((mapping, 0), 0) + 1)]
    for at in wanted:
        if at not in objects:
            raise UsageError(f"the journal holds only a part of a PDO: {_name(at)} is missing")


def _name(at: tuple[int, int]) -> str:
    return f"{at[0]:04X}h:{at[1]:02X}"


def _canopen(address: Address) -> CanopenAddress:
    assert isinstance(address, CanopenAddress)  # the profile's bus was checked when it was loaded
    return address
