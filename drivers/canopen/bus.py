"""CANopen as a bus: SDO for access, RPDO → SYNC → TPDO for the cycle (CiA 301)."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from time import perf_counter
from typing import TypeVar

from drivers import error_codes
from drivers.bus import GUARDS, Exchange
from drivers.canopen.liveness import Liveness
from drivers.canopen.pdo import (
    HEARTBEAT_PRODUCER,
    MAPPING,
    Objects,
    Pdo,
    agree,
    code_of,
    complete,
    name_of,
    objects_of,
)
from drivers.canopen.pdo_parameters import PRE_OPERATIONAL, PdoParameters
from drivers.canopen.sync import check_sync
from drivers.canopen.wire import HEARTBEAT, SYNC, CanWire
from drivers.errors import (
    AccessDenied,
    LinkError,
    LinkLost,
    PreflightRefused,
    WriteDenied,
    WriteFailed,
)
from drivers.pace import Pace
from drivers.patience import patiently
from drivers.serial_port import SerialPort, Stream
from drivers.stepping import Simulation, set_simulation
from profiles.address import Address, CanopenAddress
from profiles.errors import ProfileError, TwoRelayError
from profiles.identity import Identity
from profiles.parameter import Access
from profiles.schema import Profile

__all__ = ["NAMELESS", "CanopenBus", "identify"]

MISSED_CYCLES = 3  # consecutive cycles without a sample are a lost link (safety, receive deadline)

NMT_OPERATIONAL = 0x01
_STATE_OPERATIONAL = 0x05
# NMT command that brings a node into the state that its heartbeat told
_COMMANDS: dict[int | None, int] = {
    0x00: PRE_OPERATIONAL, 0x04: 0x02, 0x05: NMT_OPERATIONAL, 0x7F: PRE_OPERATIONAL,
}  # fmt: skip
_STATES = {0x00: "booting", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}
_CONSUMER_BEGINS = 0.005  # s from the first beat to the second, before the node is started again
_EVENT_DRIVEN = 255
_EVERY_SYNC = 1


T = TypeVar("T")


NAMELESS = Identity(
    vendor="0x00000000", product="0x00000000", revision="0x00000000", serial="0x00000000"
)


def identify(wire: CanWire, patience: float = 0.0) -> Identity:
    """Identity object 1018h.

    A node that is busy is asked for `patience` s, without any it is NAMELESS.
    """
    numbers = []
    for sub in (1, 2, 3, 4):
        try:
            data = patiently(partial(wire.upload, 0x1018, sub), patience, wire.let_pass)
            numbers.append(int.from_bytes(data[:4], "little"))
        except AccessDenied as error:
            if error.busy and patience:
                raise
            if error.busy:
                return NAMELESS  # half a name would be another drive's
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
        written = {
            (at.index, at.sub)
            for at, access in ((p.address, p.access) for p in profile.parameters.values())
            if isinstance(at, CanopenAddress) and access is not Access.READ_ONLY
        }
        self._pdos = PdoParameters(wire, profile.link.patience, written)
        self._widths: dict[CanopenAddress, int] = {}  # bytes, where they are not the profile's
        self._rpdo = Pdo(
            0x1400 + cycle.rpdo - 1,
            _EVENT_DRIVEN,
            0x100 + 0x100 * cycle.rpdo + wire.node,
            self._out,
        )
        self._tpdo = Pdo(
            0x1800 + cycle.tpdo - 1, _EVERY_SYNC, 0x80 + 0x100 * cycle.tpdo + wire.node, self._in
        )
        self._posted: dict[tuple[int, int], tuple[Address, int]] = {}
        self._old: Objects = {}  # what was there before `start`
        self._running = False
        self._state_before: int | None = None  # of the node, as it said before `start`
        self._idle: tuple[int, ...] = ()
        watchdog = profile.watchdog
        self._watched_by = watchdog.kind if watchdog.kind in ("heartbeat", "guarding") else ""
        self._liveness = Liveness(wire, self._pdos, is_guarded=self._watched_by == "guarding")
        self._heartbeat = HEARTBEAT + watchdog.node
        self._heartbeat_every = watchdog.timeout / GUARDS
        self._heartbeat_due = -1.0
        if pace.stepping:
            self._simulate("simulation_cycle", pace.cycle)

    def _simulate(self, name: Simulation, seconds: float) -> None:
        """Let the clock of a drive that steps know."""

        def write(address: Address, raw: int) -> None:
            self._patiently(lambda: self.write(address, raw))

        set_simulation(write, self._profile, name, seconds, self._is_twin)

    def _is_twin(self) -> bool:
        """Whether the device name 1008h is that of a virtual drive in another one's clothes."""
        try:
            return self._upload(0x1008, 0).startswith(b"twin of ")
        except AccessDenied:
            return False

    def _patiently(self, action: Callable[[], T]) -> T:
        """What `action` gives, asked again while the node says that it is busy."""
        return patiently(action, self._profile.link.patience, self._wire.let_pass)

    def _upload(self, index: int, sub: int) -> bytes:
        return self._patiently(lambda: self._wire.upload(index, sub))

    def identify(self) -> Identity:
        """Ask the drive who it is."""
        return identify(self._wire, self._profile.link.patience)

    def read(self, address: Address) -> int:
        """Raw value by SDO, as wide as the drive has it; raises LinkError, AccessDenied."""
        at = _canopen(address)
        data = self._wire.upload(at.index, at.sub)
        width = struct.calcsize(code_of(at))
        if len(data) != width and self._wire.is_sized:
            if len(data) < min(width // 2, 2) or len(data) not in (1, 2, 4, 8):
                raise LinkError(
                    f"{at} has {len(data)} byte{'s' * (len(data) != 1)} in the drive, and {width} "
                    f"in profile '{self._profile.name}': does its value lie behind sub-index 1? "
                    "Then it needs a profile of its own ('tworelay profile new')",
                    code="link.length",
                )
            self._widths[at] = width = len(data)
        elif len(data) < width:
            raise LinkError(
                f"{at}: the answer has {len(data)} bytes, not {width}", code="link.length"
            )
        return int(struct.unpack_from("<" + code_of(at, width), data)[0])

    def _packed(self, at: CanopenAddress, raw: int) -> bytes:
        """A raw value, as wide as the drive has it; raises WriteDenied."""
        layout = struct.Struct("<" + code_of(at, self._widths.get(at)))
        try:
            return layout.pack(raw)
        except struct.error:
            raise WriteDenied(
                f"{at}: {raw} does not fit into {layout.size} bytes, which the drive has for it"
            ) from None

    def write(self, address: Address, raw: int) -> None:
        """Write a raw value by SDO; raises LinkError, WriteDenied."""
        at = _canopen(address)
        width = self._widths.get(at)
        try:
            self._wire.download(at.index, at.sub, self._packed(at, raw))
        except WriteDenied as error:
            if not error.length:
                raise
            if width is None:
                self.read(address)  # which tells how wide it is
            else:
                del self._widths[at]  # it tells one width, and takes another
            if self._widths.get(at) == width:
                raise
            self._wire.download(at.index, at.sub, self._packed(at, raw))

    def post(self, address: Address, raw: int) -> None:
        """By RPDO where the value is mapped and the cycle runs, and by SDO; without waiting."""
        at = _canopen(address)
        if self._running and at in self._out:
            frame = list(self._idle)
            frame[self._out.index(at)] = raw
            self._idle = tuple(frame)
            with contextlib.suppress(struct.error):  # whatever it is, the SDO goes out
                self._wire.send(self._rpdo.cob_id, self._rpdo.pack(self._idle))
        self._posted[at.index, at.sub] = address, raw
        self._wire.post_download(at.index, at.sub, self._packed(at, raw))

    def refused_posts(self) -> list[tuple[Address, int]]:
        """Posts that the node has refused for now, since this was asked last."""
        refused, self._wire.refused_posts = self._wire.refused_posts, []
        return [self._posted[at] for at in refused if at in self._posted]

    def descriptor(self) -> int | None:
        """Descriptor of a serial adapter; other adapters are shared."""
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
        data = self._packed(at, raw)
        return self._wire.serial_line(at.index, at.sub, data)

    # -- cycle -----------------------------------------------------------------------------------

    def start(self, idle: tuple[int, ...]) -> None:
        """Map the PDOs, start the node, and expect its TPDO with every SYNC."""
        self._idle = idle
        self._heartbeat_due = -1.0
        self._wire.emergency = None  # what it reported so far is past
        if self._running:
            self._start_again()
            return
        if self._wire.awaits_sync:
            check_sync(self._wire, self.cycle)
        self._wire.drain()
        if self.in_real_time:
            self._liveness.ask(partial(self._old.__setitem__, HEARTBEAT_PRODUCER))
        if self._state_before is None:
            self._state_before = self._wire.heartbeat_state
        self._wire.nmt(PRE_OPERATIONAL)
        for pdo in (self._rpdo, self._tpdo):
            there = self._pdos.there(pdo.communication)
            wanted = pdo.wanted(there)
            if not agree(there, wanted):
                self._old |= there | self._pdos.beyond(pdo, there)
                self._set_up(pdo, there, wanted)
        self._wire.listen_tpdo(self._tpdo.cob_id)
        self._wire.nmt(NMT_OPERATIONAL)
        self._wire.heard_at = perf_counter()
        self._running = True
        self._beat()  # the drive watches from the first one on: before it is enabled, not after
        self._wire.drain()
        self._liveness.supervise()

    def _set_up(self, pdo: Pdo, there: Objects, wanted: Objects) -> None:
        """Map a PDO, as wide as the drive has its objects.

        Where the drive keeps its own mapping, that one serves if it has what is needed. Raises
        WriteDenied, PreflightRefused, ProfileError.
        """
        try:
            self._pdos.map(pdo, wanted)
        except WriteDenied as denied:
            if denied.busy:
                raise
            too_much: ProfileError | None = None
            if self._is_wider(pdo):
                try:
                    pdo.lay_out(self._widths)
                    self._pdos.map(pdo, pdo.wanted(there))
                except ProfileError as error:
                    too_much = error
                except WriteDenied:
                    pass
                else:
                    return
            try:
                self._pdos.keep_its_mapping(pdo, there, denied)
            except PreflightRefused as refused:
                raise too_much or refused from None

    def _is_wider(self, pdo: Pdo) -> bool:
        """Whether the drive has an object of a PDO wider than the profile, or narrower; asks it."""
        for at in pdo.mapped:
            with contextlib.suppress(AccessDenied):  # what can only be written
                self._patiently(partial(self.read, at))
        return bool(self._widths.keys() & set(pdo.mapped))

    def _start_again(self) -> None:
        """A node that has lost our heartbeat is not operational any more (1029h:01 = 0)."""
        self._beat()
        self._wire.drain()
        self._liveness.supervise()
        if not self._watched_by:
            return
        self.wait(_CONSUMER_BEGINS)
        self._heartbeat_due = -1.0
        self._beat()
        self._wire.nmt(NMT_OPERATIONAL)

    def changes(self) -> dict[str, tuple[int, int]]:
        """PDO parameters and heartbeat time that `start` changes.

        What is there, and what will be.
        """
        found: dict[str, tuple[int, int]] = {}
        if self._running:
            return found
        for pdo in (self._rpdo, self._tpdo):
            there = self._pdos.there(pdo.communication)
            wanted = pdo.wanted(there)
            if not agree(there, wanted):
                there |= self._pdos.beyond(pdo, there)
                found |= {name_of(at): (old, wanted.get(at, 0)) for at, old in there.items()}
        every = self._liveness.time() if self.in_real_time else None
        if every is not None and every != self._liveness.wanted(every):
            found[name_of(HEARTBEAT_PRODUCER)] = every, self._liveness.wanted(every)
        return found

    def put_back(self, old: dict[str, int]) -> bool:
        """Write back what `changes` named; the cycle ends with it. False: all was as before."""
        ours = {pdo.communication for pdo in (self._rpdo, self._tpdo)}
        objects = objects_of(old, ours)
        for communication in {index & ~MAPPING for index, _ in objects} & ours:
            complete(communication, objects)
        self._running = False
        return self._put_back(objects)

    def _put_back(self, objects: Objects) -> bool:
        """Each PDO by itself, then the heartbeat.

        Raises WriteFailed for those that are not back.
        """
        changed, failures = False, []
        for communication in (self._rpdo.communication, self._tpdo.communication):
            part = {at: raw for at, raw in objects.items() if at[0] & ~MAPPING == communication}
            try:
                changed |= bool(part) and self._pdos.put_back(communication, part)
            except (AccessDenied, WriteFailed) as error:
                failures.append(str(error))
        every = objects.get(HEARTBEAT_PRODUCER)
        if every is not None and self._liveness.time() not in (None, every):
            changed = True
            try:
                self._pdos.download(HEARTBEAT_PRODUCER, every)
            except AccessDenied as error:
                failures.append(str(error))
        command = _COMMANDS.get(self._state_before)
        left = bool(self._watched_by)  # a node that hears nothing leaves 'operational' by itself
        if command is not None and (left or self._wire.nmt_commanded != command):
            self._wire.nmt(command)
        if failures:
            raise WriteFailed("; ".join(failures), code="write.bus")
        self._old = {at: raw for at, raw in self._old.items() if at not in objects}
        return changed

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        """Command by RPDO now, SYNC at the deadline, feedback by TPDO."""
        wire, pace = self._wire, self._pace
        payload = self._rpdo.pack(values)
        missed = 0
        if wire.awaits_sync:
            wire.drain()
            missed, wire.syncs = wire.syncs, 0  # those that nobody was there for
        lost = silent = 0
        self._liveness.supervise()  # before the command, as far as has been heard
        while True:
            wire.send(self._rpdo.cob_id, payload)
            sent = pace.now()
            self._beat()
            if wire.awaits_sync:
                self._liveness.supervise()
                silent += not wire.await_sync(self._deadline)
                lateness, time = missed * self.cycle, pace.now()
                wire.syncs = 0
            else:
                lateness = pace.next_deadline()
                wire.drain()
                self._liveness.supervise()
                time = pace.now()
                wire.send(SYNC, b"")
            data = wire.take_tpdo(self._deadline)
            if data is not None and len(data) >= self._tpdo.size:
                return Exchange(self._tpdo.unpack(data), values, sent, time, lateness, missed)
            missed, lost = missed + 1, lost + 1
            if silent >= MISSED_CYCLES:
                raise LinkLost(
                    f"no SYNC on the bus for {silent} cycles of {self.cycle * 1000:g} ms: its "
                    "producer has stopped (sync=bus in the link waits for it)",
                    code="sync.stopped",
                )
            if lost >= MISSED_CYCLES:
                raise LinkLost(
                    f"no TPDO from node {wire.node} for {lost} cycles of "
                    f"{self.cycle * 1000:g} ms: the link is lost{self._last_word()}",
                    code="link.tpdo",
                )

    def _beat(self) -> None:
        """Our sign of life, where the drive watches it and it is due.

        A heartbeat, or a guard's request.
        """
        now = self._pace.now()
        if not self._watched_by or now < self._heartbeat_due:
            return
        if self._watched_by == "heartbeat":
            self._wire.send(self._heartbeat, bytes((_STATE_OPERATIONAL,)))
        else:
            self._wire.guard()
        self._heartbeat_due = now + self._heartbeat_every

    def _last_word(self) -> str:
        """What the node or the adapter said last, as far as it explains a silence."""
        wire = self._wire
        if wire.bus_trouble:
            return f"; {wire.bus_trouble}"
        state = wire.heartbeat_state
        if not self._liveness.is_told or state in (None, _STATE_OPERATIONAL):
            return ""
        return f"; its heartbeat says '{_STATES.get(state, f'{state:02X}h')}'"

    def wait(self, seconds: float) -> None:
        """Let time pass; on a stepping drive, by asking it to."""
        if self._pace.stepping:
            self._simulate("simulation_advance", seconds)
        self._pace.pass_time(seconds)
        if self._running and self.in_real_time:
            self._wire.drain()
            self._liveness.supervise()

    def answering_within(self, seconds: float) -> AbstractContextManager[None]:
        """Requests meanwhile may take so long to be answered, if that is more than usual."""
        return self._wire.answering_within(seconds)

    def now(self) -> float:
        """Time of the cycle's clock, s."""
        return self._pace.now()

    def own_address(self) -> str:
        """There is none here."""
        return ""

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
        meaning, kinds = error_codes.words(code), error_codes.register_words(register)
        return (
            f"emergency {code:04X}h{meaning and f' ({meaning})'}, error register {register:02X}h"
            f"{kinds and f' ({kinds})'}"
        )

    def close(self) -> None:
        """Put back what `start` changed, and let go of the adapter."""
        self._running = False
        try:
            # a dead link is reported by whoever used it
            with contextlib.suppress(TwoRelayError):
                self._put_back(self._old)
        finally:
            self._wire.close()


def _canopen(address: Address) -> CanopenAddress:
    assert isinstance(address, CanopenAddress)  # the profile's bus was checked when it was loaded
    return address
