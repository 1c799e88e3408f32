"""The virtual drive as a CANopen node (CiA 301 and 402): frames in, frames out, no I/O.

SDO server (expedited and segmented), NMT, heartbeat producer and consumer, EMCY, SYNC-driven and
event-driven PDOs with their event timers.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from drivers.virtual.aborts import (
    ABORT_BLOCK_SIZE,
    ABORT_COMMAND,
    ABORT_LENGTH,
    ABORT_NO_OBJECT,
    ABORT_NO_SUB,
    ABORT_RANGE,
    ABORT_READ_ONLY,
    ABORT_TOGGLE,
    ABORT_WRITE_ONLY,
    DENIALS,
    Abort,
)
from drivers.virtual.block_upload import BlockUpload
from drivers.virtual.device import Device
from drivers.virtual.dictionary import OWN, Dictionary
from drivers.virtual.mirror import Mirror
from drivers.virtual.node_pdo import OFF, NodePdo
from drivers.virtual.own_eds import own_eds
from drivers.virtual.states import ERROR_COMMUNICATION, ERROR_HEARTBEAT, ERROR_PDO_TIMEOUT, Denied

__all__ = ["CanopenNode", "Frame"]

_MS = 1_000_000  # ns

_PRE_OPERATIONAL, _OPERATIONAL, _STOPPED = 0x7F, 0x05, 0x04
_AFTER_AN_ERROR = {0: _PRE_OPERATIONAL, 2: _STOPPED}  # by 1029h:01
_IDENTIFIER = (1 << 30) - 1  # of a COB-ID: may not change while the PDO exists
_EVENT = 254  # transmission types from here on are event-driven
_RESERVED = range(241, 254)  # and those that only a remote frame asks for, which it does not answer
_INHIBIT = 100_000  # ns a step

# CiA 301, SDO abort codes
_STORED_EDS = 0x1021


class Frame(NamedTuple):
    """One CAN frame with an 11-bit identifier."""

    cob_id: int
    data: bytes


class CanopenNode:
    """Frames in by `receive`, time by `poll`; both return the frames that the node sends.

    `dictionary`: the objects that it has; another drive's make it that drive's twin.
    """

    def __init__(
        self,
        device: Device,
        node_id: int,
        dictionary: Dictionary = OWN,
        mirror: Mirror | None = None,
    ) -> None:
        self.device = device
        self._dictionary = dictionary
        self._mirror = mirror or Mirror(device)
        self.node_id = node_id
        self.state = _PRE_OPERATIONAL
        self._producer = 0  # ms, object 1017h
        self._produced = 0  # ns
        self._consumer_node = 0
        self._outbox: list[Frame] = []
        self._upload: bytes | None = None
        self._download: tuple[int, int, bytearray] | None = None
        self._declared: int | None = None  # bytes of a download in segments
        self._block: BlockUpload | None = None
        self._toggle = 0
        self._error_behaviour = 0  # 1029h:01, on a communication error: pre-operational
        self._reset_pdos()
        device.firmware.silence_code = ERROR_HEARTBEAT
        device.firmware.on_emergency = self._emergency
        device.firmware.on_silence = self._heartbeat_lost

    def _reset_pdos(self) -> None:
        n = self.node_id
        self._rpdos = [
            NodePdo(0x200 + n, 255, [0x60400010]),
            NodePdo(OFF | 0x300 + n, 255, [0x60400010, 0x60600008]),
            NodePdo(OFF | 0x400 + n, 255, [0x60400010, 0x60710010]),
            NodePdo(OFF | 0x500 + n, 255, [0x60400010, 0x607A0020]),
        ]
        self._tpdos = [
            NodePdo(0x180 + n, 255, [0x60410010]),
            NodePdo(OFF | 0x280 + n, 255, [0x60410010, 0x60610008]),
            NodePdo(OFF | 0x380 + n, 255, [0x60410010, 0x60770010]),
            NodePdo(OFF | 0x480 + n, 255, [0x60410010, 0x60640020]),
        ]

    def boot(self) -> list[Frame]:
        """Boot-up message."""
        return [Frame(0x700 + self.node_id, b"\0")]

    def receive(self, cob_id: int, data: bytes, *, remote: bool = False) -> list[Frame]:
        """Take one frame from the bus; those that ask for data it does not answer."""
        device = self.device
        device.catch_up()
        if remote:
            return []
        if cob_id == 0x000 and len(data) == 2 and data[1] in (0, self.node_id):
            self._nmt(data[0])
        elif cob_id == 0x080:
            self._sync()
        elif cob_id == 0x600 + self.node_id and self.state != _STOPPED:
            self._sdo(data)
        elif cob_id == 0x700 + self._consumer_node and self._consumer_node:
            device.firmware.feed_watchdog()
        elif self.state == _OPERATIONAL:
            for pdo in self._rpdos:
                if pdo.active and cob_id == pdo.cob_id & 0x7FF:
                    self._take_rpdo(pdo, data)
        return self._flush()

    def poll(self) -> list[Frame]:
        """Let the timers of the node run."""
        self.device.catch_up()
        self._timers()
        return self._flush()

    def _flush(self) -> list[Frame]:
        frames, self._outbox = self._outbox, []
        return frames

    def _send(self, cob_id: int, data: bytes) -> None:
        self._outbox.append(Frame(cob_id, data))

    # -- network management, errors, timers --------------------------------------------------------

    def _nmt(self, command: int) -> None:
        if command == 0x01:
            self.state = _OPERATIONAL
        elif command == 0x02:
            if self.state != _STOPPED:  # an abort of the connection, too (6007h)
                self.device.firmware.communication_lost(ERROR_COMMUNICATION)
            self.state = _STOPPED
        elif command == 0x80:
            self.state = _PRE_OPERATIONAL
        elif command in (0x81, 0x82):
            if command == 0x81:
                self.device.firmware.restart()
            self._reset_pdos()
            self._producer = 0
            self.state = _PRE_OPERATIONAL
            self._outbox += self.boot()

    def _emergency(self, code: int) -> None:
        data = struct.pack("<HB5x", code, self._error_register(code))
        self._send(0x080 + self.node_id, data)

    def _heartbeat_lost(self) -> None:
        """Error behaviour (CiA 301, 7.5.2.30)."""
        if self.state == _OPERATIONAL:
            self.state = _AFTER_AN_ERROR.get(self._error_behaviour, self.state)

    @staticmethod
    def _error_register(code: int) -> int:
        if code == 0:
            return 0
        return 0x11 if code >> 8 in (0x81, 0x82) else 0x01  # generic, communication

    def _timers(self) -> None:
        now = self.device.firmware.now
        if self._producer and now - self._produced >= self._producer * _MS:
            self._produced = now
            self._send(0x700 + self.node_id, bytes((self.state,)))
        for pdo in self._rpdos:
            if pdo.armed and pdo.event_timer and now - pdo.since > pdo.event_timer * _MS:
                pdo.armed = False
                self.device.firmware.communication_lost(ERROR_PDO_TIMEOUT)
        if self.state == _OPERATIONAL:
            for pdo in self._tpdos:
                if pdo.active and pdo.transmission >= _EVENT:
                    self._event(pdo, now - pdo.since)

    def _event(self, pdo: NodePdo, since: int) -> None:
        """Send an event-driven TPDO whose values have changed, or whose event timer has run out.

        `since`: it was sent last, ns.
        """
        changed = since >= pdo.inhibit * _INHIBIT and self._packed(pdo) != pdo.sent
        if changed or (pdo.event_timer and since >= pdo.event_timer * _MS):
            self._send_tpdo(pdo)

    # -- PDO --------------------------------------------------------------------------------------

    def _take_rpdo(self, pdo: NodePdo, data: bytes) -> None:
        pdo.since = self.device.firmware.now
        pdo.armed = True
        if pdo.transmission <= 240:
            pdo.pending = data
        else:
            self._apply(pdo, data)

    def _apply(self, pdo: NodePdo, data: bytes) -> None:
        wanted = sum(length for _, length in pdo.mapped(self._dictionary))
        if len(data) < wanted:
            self._emergency(0x8210)  # PDO not processed: length
            return
        if len(data) > wanted:
            self._emergency(0x8220)  # PDO length exceeded
        for entry, length in pdo.mapped(self._dictionary):
            value = struct.unpack("<" + entry.code, data[:length])[0]
            data = data[length:]
            try:
                self._mirror.set(entry, value)
            except Denied:
                self._emergency(0x6320)  # parameter error

    def _sync(self) -> None:
        if self.state != _OPERATIONAL:
            return
        for pdo in self._rpdos:
            if pdo.pending is not None:
                data, pdo.pending = pdo.pending, None
                self._apply(pdo, data)
        self.device.end_cycle()
        self._timers()
        for pdo in self._tpdos:
            if pdo.active and 1 <= pdo.transmission <= 240:
                pdo.syncs += 1
                if pdo.syncs >= pdo.transmission:
                    pdo.syncs = 0
                    self._send_tpdo(pdo)

    def _send_tpdo(self, pdo: NodePdo) -> None:
        pdo.since = self.device.firmware.now
        pdo.sent = self._packed(pdo)
        self._send(pdo.cob_id & 0x7FF, pdo.sent)

    def _packed(self, pdo: NodePdo) -> bytes:
        return b"".join(
            struct.pack("<" + entry.code, self._mirror.value(entry))
            for entry, _ in pdo.mapped(self._dictionary)
        )

    # -- SDO server -------------------------------------------------------------------------------

    def _sdo(self, data: bytes) -> None:
        if len(data) != 8:
            return
        index, sub = struct.unpack_from("<HB", data, 1)
        try:
            specifier = data[0] >> 5
            if specifier == 2:
                self._begin_upload(index, sub)
            elif specifier == 3:
                self._upload_segment(data[0])
            elif specifier == 1:
                self._begin_download(index, sub, data)
            elif specifier == 0:
                self._download_segment(data)
            elif specifier == 5:
                self._block_upload(index, sub, data)
            elif specifier == 4:
                self._upload = self._download = self._block = None
            else:
                raise Abort(ABORT_COMMAND)
        except Abort as abort:
            self._upload = self._download = self._block = None
            self._answer(struct.pack("<BHBI", 0x80, index, sub, abort.code))

    def _answer(self, data: bytes) -> None:
        self._send(0x580 + self.node_id, data.ljust(8, b"\0"))

    def _begin_upload(self, index: int, sub: int) -> None:
        value = self._read(index, sub)
        if len(value) <= 4:
            command = 0x43 | (4 - len(value)) << 2
            self._answer(struct.pack("<BHB", command, index, sub) + value)
        else:
            self._upload, self._toggle = value, 0
            self._answer(struct.pack("<BHBI", 0x41, index, sub, len(value)))

    def _upload_segment(self, command: int) -> None:
        if self._upload is None:
            raise Abort(ABORT_COMMAND)
        if command >> 4 & 1 != self._toggle:
            raise Abort(ABORT_TOGGLE)
        part, rest = self._upload[:7], self._upload[7:]
        last = 0 if rest else 1
        self._answer(bytes((self._toggle << 4 | (7 - len(part)) << 1 | last,)) + part)
        self._toggle ^= 1
        self._upload = rest or None

    def _block_upload(self, index: int, sub: int, data: bytes) -> None:
        command, block = data[0] & 3, self._block
        if command == 0:  # initiate: block size in byte 4
            value = self._read(index, sub)
            if not 1 <= data[4] <= 127:
                raise Abort(ABORT_BLOCK_SIZE)
            self._block = BlockUpload(value, data[4])
            self._answer(struct.pack("<BHBI", 0xC6, index, sub, len(value)))
            return
        if block is None:
            raise Abort(ABORT_COMMAND)
        if command == 3:
            segments = block.block()
        elif command == 2 and not block.ended:
            segments = block.confirmed(data[1], data[2])
        elif command == 1 and block.ended:
            self._block = None
            return
        else:
            raise Abort(ABORT_COMMAND)
        for segment in segments:
            self._answer(segment)

    def _begin_download(self, index: int, sub: int, data: bytes) -> None:
        command = data[0]
        if command & 0x02:
            size = 4 - (command >> 2 & 3) if command & 0x01 else 4
            self._write(index, sub, data[4 : 4 + size], sized=bool(command & 0x01))
        else:
            self._download, self._toggle = (index, sub, bytearray()), 0
            self._declared = struct.unpack_from("<I", data, 4)[0] if command & 0x01 else None
        self._answer(struct.pack("<BHB", 0x60, index, sub))

    def _download_segment(self, data: bytes) -> None:
        if self._download is None:
            raise Abort(ABORT_COMMAND)
        command = data[0]
        if command >> 4 & 1 != self._toggle:
            raise Abort(ABORT_TOGGLE)
        index, sub, collected = self._download
        collected += data[1 : 8 - (command >> 1 & 7)]
        if len(collected) > 1024:
            raise Abort(ABORT_LENGTH)
        if command & 1:
            self._download = None
            if self._declared not in (None, len(collected)):
                raise Abort(ABORT_LENGTH)
            self._write(index, sub, bytes(collected), sized=True)
        self._answer(bytes((0x20 | self._toggle << 4,)))
        self._toggle ^= 1

    # -- object dictionary ------------------------------------------------------------------------

    def _read(self, index: int, sub: int) -> bytes:
        entry = self._dictionary.objects.get((index, sub))
        if entry is not None:
            if entry.access == "wo":
                raise Abort(ABORT_WRITE_ONLY)
            try:
                value = self._mirror.value(entry)
            except Denied as denied:
                raise Abort(DENIALS[denied.reason]) from None
            return struct.pack("<" + entry.code, value)
        pdo = self._pdo(index)
        if pdo is not None:
            return pdo.read(index, sub)
        if (index, sub) == (_STORED_EDS, 0):
            own = self._dictionary
            return own_eds(own.objects, own.identity, own.strings[0x1008].decode())
        if index in self._dictionary.strings and sub == 0:
            return self._dictionary.strings[index]
        if index in self._dictionary.counts and sub == 0:
            return bytes((self._dictionary.counts[index],))
        firmware = self.device.firmware
        identity = (*self._dictionary.identity, firmware.axis.serial)
        plain: dict[tuple[int, int], bytes] = {
            (0x1000, 0): struct.pack("<I", 0x00020192),
            (0x1001, 0): bytes((self._error_register(firmware.error_code),)),
            (0x1005, 0): struct.pack("<I", 0x80),
            (0x1010, 1): struct.pack("<I", 1),
            (0x1016, 1): struct.pack(
                "<I", self._consumer_node << 16 | firmware.values["watchdog_time"]
            ),
            (0x1017, 0): struct.pack("<H", self._producer),
            (0x1029, 1): bytes((self._error_behaviour,)),
            **{(0x1018, n + 1): struct.pack("<I", number) for n, number in enumerate(identity)},
        }
        found = plain.get((index, sub))
        if found is None or index in self._dictionary.lacks:
            raise Abort(self._missing(index))
        return found

    def _missing(self, index: int) -> int:
        own = self._dictionary
        known = index in own.counts or index in own.strings or (index, 0) in own.objects
        return ABORT_NO_SUB if known or self._pdo(index) is not None else ABORT_NO_OBJECT

    def _write(self, index: int, sub: int, data: bytes, *, sized: bool) -> None:
        entry = self._dictionary.objects.get((index, sub))
        if entry is not None:
            if entry.access == "ro":
                raise Abort(ABORT_READ_ONLY)
            value = self._number(data, entry.code, sized=sized)
            try:
                self._mirror.set(entry, value)
            except Denied as denied:
                raise Abort(DENIALS[denied.reason]) from None
            return
        pdo = self._pdo(index)
        if index in self._dictionary.lacks:
            raise Abort(ABORT_NO_OBJECT)
        if pdo is not None:
            self._write_pdo(pdo, index, sub, data)
        elif (index, sub) == (0x1010, 1):
            if data != b"save":
                raise Abort(ABORT_RANGE)
            self._to_device("store_command", 1)
        elif (index, sub) == (0x1016, 1):
            value = self._number(data, "I", sized=sized)
            self._to_device("watchdog_time", value & 0xFFFF)
            self._consumer_node = value >> 16 & 0x7F
            self.device.firmware.unwatch()
        elif (index, sub) == (0x1029, 1):
            value = self._number(data, "B", sized=sized)
            if value > 2:
                raise Abort(ABORT_RANGE)
            self._error_behaviour = value
        elif (index, sub) == (0x1017, 0):
            self._producer = self._number(data, "H", sized=sized)
            self._produced = self.device.firmware.now
        else:
            known = True
            try:
                self._read(index, sub)
            except Abort:
                known = False
            raise Abort(ABORT_READ_ONLY if known else self._missing(index))

    def _to_device(self, key: str, value: int) -> None:
        try:
            self.device.write(key, value)
        except Denied as denied:
            raise Abort(DENIALS[denied.reason]) from None

    @staticmethod
    def _number(data: bytes, code: str, *, sized: bool) -> Any:
        size = struct.calcsize("<" + code)
        if sized and len(data) != size:
            raise Abort(ABORT_LENGTH)
        return struct.unpack("<" + code, data[:size])[0]

    def _write_pdo(self, pdo: NodePdo, index: int, sub: int, data: bytes) -> None:
        pdo.write(index, sub, data, self._dictionary.objects)

    def _pdo(self, index: int) -> NodePdo | None:
        for base, pdos in (
            (0x1400, self._rpdos),
            (0x1600, self._rpdos),
            (0x1800, self._tpdos),
            (0x1A00, self._tpdos),
        ):
            if base <= index < base + len(pdos):
                return pdos[index - base]
        return None
