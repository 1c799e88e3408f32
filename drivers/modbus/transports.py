"""pymodbus' clients on the wires that they speak through: TCP, TLS, RTU over TCP, serial."""

from __future__ import annotations

import logging
import select
import socket
import ssl
from collections.abc import Callable
from time import perf_counter
from typing import Any, Protocol

from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.register_message import (
    MaskWriteRegisterRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.errors import LinkError
from drivers.modbus.wires import LocalWire, RtuLine, TcpWire

__all__ = [
    "NEVER_DISCONNECT",
    "Came",
    "ConnectionException",
    "FramerType",
    "LocalClient",
    "MaskWriteRegisterRequest",
    "ModbusException",
    "ModbusPDU",
    "Packet",
    "SerialClient",
    "TcpClient",
    "WriteMultipleRegistersRequest",
    "WriteSingleRegisterRequest",
    "connected",
    "local",
]

logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

Packet = Callable[[bool, bytes], bytes]
Came = Callable[[bytes], bytes]
_CHUNK = 4096
NEVER_DISCONNECT = 1_000_000  # the receive deadline is ours to judge, not the library's


class TcpClient(ModbusTcpClient):
    """The library's client, which is given answers by `came` and not bytes.

    Attributes
    ----------
    until : when an answer is given up, s of the performance counter
    """

    until = 0.0
    came: Came

    def raw(self, seconds: float) -> bytes:
        """What comes within some time, as soon as anything does.

        Raises ConnectionException, OSError.
        """
        stream = self.socket
        if stream is None:
            raise ConnectionException(str(self))
        stream.setblocking(False)
        pending = getattr(stream, "pending", None)  # of TLS: decrypted, and not yet read
        if (
            not (pending and pending())
            and not select.select([stream], [], [], max(seconds, 0.0))[0]
        ):
            return b""
        try:
            data: bytes = stream.recv(_CHUNK)
        except (BlockingIOError, ssl.SSLWantReadError):
            return b""
        if not data:
            self.close()  # type: ignore[no-untyped-call]
            raise ConnectionException(str(self))
        return data

    def recv(self, size: int | None) -> bytes:
        """The next answer, or a part of one; empty when its time has passed."""
        return _received(self, self.came)


class _Raw(Protocol):
    until: float

    def raw(self, seconds: float) -> bytes: ...


def _received(client: _Raw, came: Came) -> bytes:
    while (left := client.until - perf_counter()) > 0:
        data = client.raw(left)
        found = came(data) if data else b""
        if found:
            return found
    return b""


def connected(wire: TcpWire, timeout: float, on_packet: Packet, came: Came) -> TcpClient:
    """A client on an open socket; raises LinkError."""
    framer = FramerType.RTU if wire.rtu else FramerType.SOCKET
    client = TcpClient(
        wire.host, port=wire.port, framer=framer, timeout=timeout, retries=0,
        trace_packet=on_packet,
    )  # fmt: skip
    client.came = came
    place = f"{wire.host}:{wire.port}"
    try:
        plain = socket.create_connection((wire.host, wire.port), timeout)
    except TimeoutError:
        raise LinkError(
            f"{place} does not answer within {timeout:g} s",
            code="link.connect",
            hint="is the address right, the cable in, the drive on?",
        ) from None
    except OSError as error:
        raise LinkError(
            f"cannot connect to {place}: {error.strerror or error}",
            code="link.connect",
            hint="is the address right, and Modbus TCP switched on in the drive?",
        ) from None
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    client.socket = plain if wire.tls is None else wire.tls.wrap(plain, wire.host)
    return client


class _Pipe:
    """What pymodbus takes for a socket, and leads to a unit in this process."""

    def __init__(self, answers: Callable[[bytes], bytes]) -> None:
        self._answers = answers
        self.came = b""

    def send(self, data: bytes) -> int:
        self.came += self._answers(bytes(data))
        return len(data)

    def getsockname(self) -> tuple[str, int]:
        return "127.0.0.1", 0

    def close(self) -> None:
        self.came = b""


class LocalClient(TcpClient):
    """A client without a socket."""

    def raw(self, seconds: float) -> bytes:
        """What has come; nothing comes later."""
        pipe: Any = self.socket
        if pipe is None:
            raise ConnectionException(str(self))
        data: bytes = pipe.came
        pipe.came = b""
        if not data:
            self.until = 0.0
        return data


def local(wire: LocalWire, timeout: float, on_packet: Packet, came: Came) -> LocalClient:
    """A client of a unit in this process."""
    client = LocalClient("local", framer=FramerType.SOCKET, timeout=timeout, retries=0,
                         trace_packet=on_packet)  # fmt: skip
    client.came = came
    client.socket = _Pipe(wire.answers)  # type: ignore[assignment]
    return client


_WORDS = {
    2: "there is no such port; is the adapter plugged in, and its driver there?",
    13: "this user may not use it (on Linux: add the user to group dialout, then log in again)",
    16: "another program has it open",
}


class SerialClient(ModbusSerialClient):
    """A client on an open serial port; raises LinkError.

    It waits for bytes, where the library's own looks for them every millisecond.
    """

    until = 0.0

    def __init__(self, line: RtuLine, timeout: float, on_packet: Packet, came: Came) -> None:
        super().__init__(
            line.port, baudrate=line.baudrate, parity=line.parity, stopbits=line.stopbits,
            timeout=timeout, retries=0, trace_packet=on_packet,
        )  # fmt: skip
        self.came = came
        try:
            self.socket = line.opened_as(timeout).open()
        except OSError as error:
            number = getattr(error, "errno", None) or 0
            text = str(error)
            words = _WORDS.get(number, "") or (_WORDS[16] if "lock" in text else "")
            raise LinkError(
                f"cannot open {line.port}: {words or text}", code="link.connect"
            ) from None

    def raw(self, seconds: float) -> bytes:
        """What comes within some time, as soon as anything does; raises ConnectionException."""
        port = self.socket
        if port is None:
            raise ConnectionException(str(self))
        try:
            port.timeout = max(seconds, 0.0)
            first: bytes = port.read(1)
            return first + port.read(port.in_waiting) if first else b""
        except OSError:
            self.close()  # type: ignore[no-untyped-call]
            raise ConnectionException(str(self)) from None

    def recv(self, size: int | None) -> bytes:
        """The next answer, or a part of one; empty when its time has passed."""
        return _received(self, self.came)
