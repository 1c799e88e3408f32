"""python-can and canopen, behind one door: one thread owns the bus and receives where it waits.

No notifier thread, no callback, no lock: whoever waits for an answer pumps the bus, and everything
that arrives meanwhile is sorted by COB-ID.
"""

from __future__ import annotations

import contextlib
import logging
import struct
import sys
import time
from collections.abc import Callable, Generator
from typing import Any

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen import bus_state
from drivers.canopen.adapters import BusABC, CanError, Message, Slcan, Socketcand, first_line
from drivers.errors import AccessDenied, LinkError, LinkLost, NoAnswer, WriteDenied
from drivers.patience import patiently
from drivers.serial_port import SerialPort, Stream

__all__ = ["CanWire", "NoAnswer"]

for _name in ("can", "canopen"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)

SYNC = 0x080
EMERGENCY = 0x080
HEARTBEAT = 0x700
NMT = 0x000
BOOT_UP = 0x00  # as a heartbeat's state (CiA 301, 7.2.8.3.3)
_WITH_MULTIPLEXER = (2, 3, 4)  # SDO server: upload and download begin, abort (CiA 301, 7.2.4.3)
_WRONG_LENGTH = 0x06070010, 0x06070012, 0x06070013  # SDO abort codes (CiA 301, table 22)
_ABORT = 0x80
_MISSING = 0x06020000, 0x06090011  # object, sub-index
# what may go a little later: of the application, local control, the device's state
_BUSY = 0x08000020, 0x08000021, 0x08000022
_UNSIZED = 0x42  # an expedited upload that does not tell how many of its bytes count
_NO_OBJECT = b"\0\0\0"  # some drives abort so
_SEGMENT, _LARGEST_OBJECT = 7, 5_000_000  # bytes; the largest object is an EDS (1021h)
_POST_ANSWER = 0.05  # s that the answer to a posted download may take


CanTrace = Callable[[bool, int, bytes | None], None]  # sending, COB-ID, data; None: a remote frame


def _expedited(index: int, sub: int, data: bytes) -> bytes:
    """An expedited download with its size (CiA 301, 7.2.4.3.3)."""
    command = 0x23 | (4 - len(data)) << 2
    return struct.pack("<BHB", command, index, sub) + data.ljust(4, b"\0")


def _is_whole(data: bytes) -> bool:
    """Whether an SDO answer has all its bytes: some servers leave out those that mean nothing."""
    if len(data) == 8:
        return True
    command = data[0] if data else 0xFF
    if command == 0x60:  # download begun, or done
        return len(data) >= 4
    if command & 0xF3 == 0x43:  # expedited upload with its size
        return len(data) >= 8 - (command >> 2 & 3)
    if command & 0xEF == 0x20:  # segment taken
        return len(data) >= 1
    return False


class CanWire:
    """The bus as one node's master sees it.

    Attributes
    ----------
    patience : s that a service waits for its answer
    emergency : last EMCY (code, register) of the node, or None
    heartbeat_state : last NMT state heard, or None
    nmt_commanded : last NMT command sent to the node, or None
    heard_at : when that was, s of the performance counter
    guarded_at : when it was first asked for its state and has not answered since; None: it has
    restarted : the node said that it has booted, since this was last set to False
    bus_trouble : what the adapter last said of the bus, for people; '' when it is well
    foreign_master : COB-ID of a frame that only another master would send, or None
    syncs : SYNC messages of another producer, since this was last set to 0
    awaits_sync : another device of the bus produces SYNC, and so paces the cycle
    is_sized : the last answer of the node told how many of its bytes count
    garbled : frames that could not be read
    refused_posts : objects of posted downloads that the node refused for now
    error_frames : that the adapter reported
    descriptor : of a serial adapter, or None
    """

    def __init__(
        self,
        bus: BusABC,
        node: int,
        timeout: float,
        trace: CanTrace | None = None,
        *,
        awaits_sync: bool = False,
    ) -> None:
        self.node = node
        self.patience = timeout
        self.awaits_sync = awaits_sync
        self.emergency: tuple[int, int] | None = None
        self.heartbeat_state: int | None = None
        self.nmt_commanded: int | None = None
        self.heard_at = 0.0
        self.guarded_at: float | None = None
        self.restarted = False
        self.bus_trouble = ""
        self.foreign_master: int | None = None
        self.syncs = 0
        self.garbled = 0
        self.is_sized = True
        self.error_frames = 0
        self._bus = bus
        self._trace = trace
        self._tpdo_id = 0
        self._tpdo: bytes | None = None
        self._closed = False
        self._posted = 0
        self.refused_posts: list[tuple[int, int]] = []
        # waiting on a descriptor beats the library's polling
        self._serial: Slcan | None = None
        if sys.platform != "win32" and isinstance(bus, Slcan):
            self._serial = bus
        self.descriptor = None if self._serial is None else int(self._serial.fileno())
        self._sdo = _PumpedSdo(self, node, timeout)

    def port(self) -> SerialPort | None:
        """The port of a serial adapter, as it is set; None for other adapters."""
        if not isinstance(self._bus, Slcan):
            return None
        port = self._bus.serialPortOrig
        return SerialPort(
            str(port.port),
            port.baudrate,
            port.parity,
            port.stopbits,
            port.timeout,
            port.write_timeout,
        )

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on.

        The channel stays open.
        """
        assert isinstance(self._bus, Slcan)
        self._bus.serialPortOrig.close()
        if stream is not None:
            self._bus.serialPortOrig = stream  # type: ignore[assignment]

    # -- frames ----------------------------------------------------------------------------------

    def send(self, cob_id: int, data: bytes) -> None:
        """Send one frame; raises LinkLost."""
        self._transmit(Message(arbitration_id=cob_id, data=data, is_extended_id=False))
        if self._trace is not None:
            self._trace(True, cob_id, data)

    def _transmit(self, message: Message) -> None:
        try:
            self._bus.send(message, timeout=0.1)
        except (CanError, OSError, ValueError) as error:
            reason = self.bus_trouble or first_line(error)
            raise LinkLost(f"cannot send on the CAN bus: {reason}", code="link.send") from None

    @property
    def can_guard(self) -> bool:
        """Whether the adapter sends remote frames; the socketcand protocol has none."""
        return not isinstance(self._bus, Socketcand)

    def guard(self) -> None:
        """Ask the node for its state by a remote frame, as a master that guards it.

        Raises LinkLost.
        """
        cob_id = HEARTBEAT + self.node
        self.guarded_at = self.guarded_at or time.perf_counter()
        self._transmit(
            Message(arbitration_id=cob_id, is_remote_frame=True, dlc=1, is_extended_id=False)
        )
        if self._trace is not None:
            self._trace(True, cob_id, None)

    send_message = send  # the name under which canopen's SDO client knows it

    def pump(self, timeout: float) -> bool:
        """Receive and sort one frame; False when nothing came within `timeout` s."""
        try:
            if self._serial is not None:
                if not self._serial.await_data(timeout):
                    return False
                message = self._bus.recv(0)
                if message is None:
                    return not self._serial.is_dead  # a part of a line, or an acknowledgement
            else:
                message = self._bus.recv(timeout)
        except (ValueError, IndexError):
            self.garbled += 1
            return True
        except (CanError, OSError) as error:
            raise LinkLost(
                f"the CAN adapter failed: {first_line(error)}", code="link.adapter-failed"
            ) from None
        if message is None:
            return False
        data = bytes(message.data)
        cob_id = message.arbitration_id
        if self._trace is not None:
            self._trace(False, cob_id, None if message.is_remote_frame else data)
        if message.is_error_frame:
            self.error_frames += 1
            self.bus_trouble = bus_state.words(cob_id, data)
        if not (message.is_error_frame or message.is_extended_id or message.is_remote_frame):
            self._sort(cob_id, data)
        return True

    def _sort(self, cob_id: int, data: bytes) -> None:
        """One data frame to whom it is for."""
        if cob_id == self._tpdo_id:
            self._tpdo = data
        elif cob_id == self._sdo.tx_cobid:
            if _is_whole(data):
                self._sdo.take(data.ljust(8, b"\0"))
            else:
                self.garbled += 1
        elif cob_id == EMERGENCY + self.node and len(data) == 8:
            code, register = struct.unpack_from("<HB", data)
            self.emergency = (code, register) if code else None
        elif cob_id == HEARTBEAT + self.node and len(data) == 1:
            self.heartbeat_state = data[0] & 0x7F
            self.heard_at, self.guarded_at = time.perf_counter(), None
            self.restarted = self.restarted or self.heartbeat_state == BOOT_UP
        elif cob_id == SYNC and self.awaits_sync:
            self.syncs += 1
        elif cob_id in (NMT, SYNC, 0x200 + self.node, 0x600 + self.node):
            self.foreign_master = cob_id

    def pump_until(self, done: Callable[[], bool], timeout: float) -> bool:
        """Pump until `done()`, at most `timeout` s; return whether it is done."""
        deadline = time.perf_counter() + timeout
        while not done():
            left = deadline - time.perf_counter()
            if left <= 0:
                return False
            if not self.pump(left) and left > 0.002:
                time.sleep(0.0002)  # a dead adapter returns at once, and for ever
        return True

    def let_pass(self, seconds: float = 0.05) -> float:
        """Take frames for some time of the wall, s: as long as a busy node is left alone."""
        self.pump_until(lambda: False, seconds)
        return seconds

    def await_sync(self, timeout: float) -> bool:
        """Wait for another producer's SYNC, at most `timeout` s; False: it did not come."""
        return self.pump_until(lambda: self.syncs > 0, timeout)

    # -- PDO -------------------------------------------------------------------------------------

    def listen_tpdo(self, cob_id: int) -> None:
        """Which TPDO to keep."""
        self._tpdo_id = cob_id

    def drain(self) -> None:
        """Take what has arrived, and forget a TPDO that came too late."""
        for _ in range(1000):
            if not self.pump(0):
                break
        self._tpdo = None

    def take_tpdo(self, timeout: float) -> bytes | None:
        """The TPDO, as soon as it is there; None after `timeout` s."""
        self.pump_until(lambda: self._tpdo is not None, timeout)
        data, self._tpdo = self._tpdo, None
        return data

    # -- SDO -------------------------------------------------------------------------------------

    def upload(self, index: int, sub: int) -> bytes:
        """Read an object; raises NoAnswer, AccessDenied."""
        with (
            self._translated(index, sub),
            self._sdo.open(index, sub, "rb", buffering=0) as stream,  # type: ignore[no-untyped-call]
        ):
            return self._whole(stream)

    def has(self, index: int, sub: int, patience: float) -> bool:
        """Whether the node has an object; one that is busy is asked for `patience` s.

        Raises NoAnswer.
        """
        try:
            patiently(lambda: self.upload(index, sub), patience, self.let_pass)
        except AccessDenied as error:
            return not error.missing
        return True

    def upload_large(self, index: int, sub: int) -> bytes:
        """Read an object of many bytes, by block transfer where the node knows it.

        Raises as `upload`.
        """
        try:
            with (
                self._translated(index, sub),
                self._sdo.open(  # type: ignore[no-untyped-call]
                    index, sub, "rb", buffering=0, block_transfer=True
                ) as stream,
            ):
                self._sdo.about = b""  # from here on an answer begins with its number
                return self._whole(stream)
        except (AccessDenied, NoAnswer):
            return self.upload(index, sub)

    def _whole(self, stream: Any) -> bytes:
        """All that a node sends of an object; raises LinkError where it does not end."""
        found = b""
        while part := stream.read(_SEGMENT):
            found += part
            if len(found) > _LARGEST_OBJECT:
                raise LinkError(
                    f"node {self.node} sends more than {_LARGEST_OBJECT} bytes of one object: no "
                    "drive does",
                    code="link.too-long",
                )
        return found

    def download(self, index: int, sub: int, data: bytes) -> None:
        """Write an object; raises NoAnswer, WriteDenied."""
        with self._translated(index, sub, WriteDenied):
            self._sdo.download(index, sub, data)

    def post_download(self, index: int, sub: int, data: bytes) -> None:
        """Send an expedited download and wait for nothing."""
        self.send(0x600 + self.node, _expedited(index, sub, data))
        self._posted += 1

    def serial_line(self, index: int, sub: int, data: bytes) -> bytes:
        """An expedited download for a serial adapter (slcan).

        A line begun ends, the channel is opened.
        """
        frame = _expedited(index, sub, data)
        return f"\rO\rt{0x600 + self.node:03X}8{frame.hex().upper()}\r".encode("ascii")

    def _settle_posts(self) -> None:
        """Let the answers to posted downloads come in, so that they answer nothing else."""
        if self._posted:
            responses = self._sdo.responses
            self.pump_until(lambda: responses.qsize() >= self._posted, _POST_ANSWER)
            self._posted = 0
            while not responses.empty():
                command, index, sub, code = struct.unpack_from("<BHBI", responses.get())
                if command == _ABORT and code in _BUSY:
                    self.refused_posts.append((index, sub))

    @contextlib.contextmanager
    def _translated(self, index: int, sub: int, denied: type[AccessDenied] = AccessDenied) -> Any:
        self._settle_posts()
        self._sdo.about = self._sdo.last = struct.pack("<HB", index, sub)
        try:
            yield
        except SdoAbortedError as error:
            text = SdoAbortedError.CODES.get(error.code, "unknown abort code")
            raise denied(
                f"{index:04X}h:{sub:02X}: node {self.node} refuses it: {text} ({error.code:08X}h)",
                busy=error.code in _BUSY,
                missing=error.code in _MISSING,
                length=error.code in _WRONG_LENGTH,
            ) from None
        except SdoCommunicationError as error:
            raise NoAnswer(
                f"node {self.node} does not answer to SDO {index:04X}h:{sub:02X} within "
                f"{self._sdo.RESPONSE_TIMEOUT:g} s ({error}); "
                + (
                    self.bus_trouble
                    or "are bit rate, node number and channel right, and is the drive on?"
                )
            ) from None
        finally:
            self._sdo.about = b""

    @contextlib.contextmanager
    def answering_within(self, seconds: float) -> Generator[None]:
        """SDO requests may meanwhile take so long, if that is more than usual."""
        usual = self._sdo.RESPONSE_TIMEOUT
        self._sdo.RESPONSE_TIMEOUT = max(usual, seconds)
        try:
            yield
        finally:
            self._sdo.RESPONSE_TIMEOUT = usual

    def nmt(self, command: int) -> None:
        """Send an NMT command to the node."""
        self.nmt_commanded = command
        self.send(NMT, bytes((command, self.node)))

    def close(self) -> None:
        """Let go of the adapter."""
        if not self._closed:
            self._closed = True
            with contextlib.suppress(CanError, OSError, ValueError):
                self._bus.shutdown()


class _PumpedSdo(SdoClient):
    """canopen's SDO client on a wire without a receive thread; one request, no retry."""

    MAX_RETRIES = 1

    def __init__(self, wire: CanWire, node: int, timeout: float) -> None:
        super().__init__(0x600 + node, 0x580 + node, ObjectDictionary())  # type: ignore[no-untyped-call]
        self.RESPONSE_TIMEOUT = timeout
        self.network = wire  # type: ignore[assignment]
        self._wire = wire
        self.about = (
            b""  # index and sub-index that are asked for; empty: answers to posts are awaited
        )
        self.last = bytes(3)  # of what was asked last

    def abort(self, abort_code: int = 0x08000000) -> None:
        """Abort the transfer, and say which (CiA 301, 7.2.4.3.17); the library says 0000h:00."""
        self.send_request(b"\x80" + self.last + struct.pack("<I", abort_code))  # type: ignore[no-untyped-call]

    def take(self, data: bytes) -> None:
        """An answer; one about another object came late, or twice, and is nobody's any more."""
        self._wire.is_sized = data[0] & 0xE3 != _UNSIZED
        begins = data[0] >> 5 in _WITH_MULTIPLEXER
        if not self.about or not begins or data[1:4] in (self.about, _NO_OBJECT):
            self.responses.put(data)

    def read_response(self) -> bytes:
        """Pump the wire until the response is there."""
        if not self._wire.pump_until(lambda: not self.responses.empty(), self.RESPONSE_TIMEOUT):
            raise SdoCommunicationError("No SDO response received")
        response: bytes = super().read_response()  # type: ignore[no-untyped-call]
        return response
