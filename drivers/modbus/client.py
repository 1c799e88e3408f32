"""pymodbus, behind one door: requests with one answer or one of our errors, never a retry."""

from __future__ import annotations

import contextlib
import logging
import socket
import sys
from collections.abc import Callable, Generator
from typing import Any

from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.register_message import (
    MaskWriteRegisterRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.modbus.wires import RtuLine, TcpWire, Wire
from drivers.pace import Silence
from drivers.serial_port import SerialPort, Stream
from profiles.errors import AccessDenied, LinkError, LinkLost, NoAnswer

__all__ = ["POST_ANSWER", "Client", "ExceptionAnswer", "NoAnswer"]

logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

# Modbus Application Protocol V1.1b3, section 7
_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    5: "acknowledge",
    6: "server device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}

_BUSY = 5, 6

Trace = Callable[[bool, bytes], None]

POST_ANSWER = 0.01  # s that a posted write may hold up the next one
_NEVER_DISCONNECT = 1_000_000  # the receive deadline is ours to judge, not the library's


class ExceptionAnswer(AccessDenied):
    """The unit, or a gateway before it, answers with an exception; `code` as in the standard."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message, busy=code in _BUSY)
        self.code = code


class Client:
    """One connection to one unit.

    Parameters
    ----------
    wire : where the drive is, and how it is talked to there
    unit : address of the drive on that wire
    timeout : s, for connecting and for requests outside the cycle
    trace : called with (sending, bytes) for every frame

    Raises
    ------
    LinkError
        The host or the port cannot be reached.
    """

    def __init__(self, wire: Wire, unit: int, timeout: float, trace: Trace | None = None) -> None:
        self._wire = wire
        self.turn_to(unit)
        self._timeout = timeout
        self._trace = trace
        self._heard = 0
        self._silence = Silence(wire.silence) if wire.silence else None
        self._no_transactions = isinstance(wire, TcpWire) and wire.rtu
        self._client: ModbusTcpClient | _SerialClient
        if isinstance(wire, RtuLine):
            self._client = _SerialClient(wire, timeout, self._on_packet)
        else:
            self._client = _connected(wire, timeout, self._on_packet)

    def turn_to(self, unit: int) -> None:
        """Talk to another unit on the same connection from now on."""
        self.where = f"{self._wire} unit {unit}"
        self._unit = unit

    def _on_packet(self, sending: bool, data: bytes) -> bytes:
        if not sending:
            self._heard += len(data)
        if self._trace is not None:
            self._trace(sending, data)
        return data

    def _ask(
        self, request: Callable[..., ModbusPDU], timeout: float | None, **arguments: Any
    ) -> ModbusPDU:
        """One request, one answer; both of pymodbus' error channels become our errors."""
        client = self._client
        if client.socket is None:
            raise LinkLost(f"the connection to {self.where} is closed")
        client.transaction.count_until_disconnect = _NEVER_DISCONNECT
        client.comm_params.timeout_connect = self._timeout if timeout is None else timeout
        client.transaction.comm_params.timeout_connect = client.comm_params.timeout_connect
        self._heard = 0
        if self._silence is not None:
            self._silence.keep()
        if self._no_transactions:
            self._forget(client.socket)
        try:
            answer = request(device_id=self._unit, **arguments)
        except ConnectionException:
            raise LinkLost(
                f"{self.where} closed the connection (cable, power, or too many masters?)"
            ) from None
        except (ModbusException, OSError) as error:
            if isinstance(error, OSError):
                self._drop()
                raise LinkLost(
                    f"the connection to {self.where} broke: {error.strerror or error}"
                ) from None
            if self._heard:
                raise NoAnswer(
                    f"{self.where} answers, but not to what was asked ({self._heard} bytes within "
                    f"{client.comm_params.timeout_connect * 1000:g} ms): is it a Modbus port, and "
                    "the unit right?"
                ) from None
            raise NoAnswer(
                f"{self.where} does not answer within "
                f"{client.comm_params.timeout_connect * 1000:g} ms"
            ) from None
        except (IndexError, ValueError, KeyError, AttributeError, TypeError) as error:
            # a malformed answer trips the library's decoder
            raise LinkError(
                f"{self.where} sent an answer that is no Modbus ({type(error).__name__}: {error})"
            ) from None
        finally:
            if self._silence is not None:
                self._silence.begin()
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            raise ExceptionAnswer(
                f"{self.where} refuses function {answer.function_code & 0x7F}: exception {code} "
                f"({_EXCEPTIONS.get(code, 'unknown')})",
                code,
            )
        return answer

    @staticmethod
    def _forget(stream: Any) -> None:
        """Drop what came late: an RTU frame does not say which request it answers."""
        stream.setblocking(False)
        with contextlib.suppress(OSError):
            while stream.recv(4096):
                pass

    def read(
        self, function: int, address: int, count: int, timeout: float | None = None
    ) -> list[int]:
        """Registers by FC 3 or 4."""
        request = (
            self._client.read_holding_registers
            if function == 3
            else self._client.read_input_registers
        )
        answer = self._ask(request, timeout, address=address, count=count)
        return self._registers(answer, count)

    def write(
        self, function: int, address: int, words: list[int], timeout: float | None = None
    ) -> None:
        """Registers by FC 6 or 16; by FC 22 `words` are the AND and the OR mask of one register."""
        if function == 22:
            keep, put = words
            self._ask(
                self._client.mask_write_register, timeout,
                address=address, and_mask=keep, or_mask=put,
            )  # fmt: skip
        elif function == 6 and len(words) == 1:
            self._ask(self._client.write_register, timeout, address=address, value=words[0])
        else:
            self._ask(self._client.write_registers, timeout, address=address, values=words)

    def read_write(
        self,
        read_address: int,
        count: int,
        write_address: int,
        words: list[int],
        timeout: float | None,
    ) -> list[int]:
        """Write, then read, in one transaction (FC 23)."""
        answer = self._ask(
            self._client.readwrite_registers,
            timeout,
            read_address=read_address,
            read_count=count,
            write_address=write_address,
            values=words,
        )
        return self._registers(answer, count)

    def post(self, function: int, address: int, words: list[int]) -> None:
        """Send a write; an answer that does not come at once is not waited for. Raises LinkLost.

        Drives take one transaction at a time, so a second post must not overtake the first.
        """
        with contextlib.suppress(NoAnswer):
            self.write(function, address, words, POST_ANSWER)

    @contextlib.contextmanager
    def answering_within(self, seconds: float) -> Generator[None]:
        """Requests outside the cycle may meanwhile take so long, if that is more than usual."""
        usual = self._timeout
        self._timeout = max(usual, seconds)
        try:
            yield
        finally:
            self._timeout = usual

    @property
    def serial(self) -> bool:
        """Whether the drive is on a serial port of this machine."""
        return isinstance(self._wire, RtuLine)

    def descriptor(self) -> int | None:
        """Of the port or the connection; None where it cannot be lent (TLS, closed, a port on Windows)."""
        stream = self._client.socket
        if sys.platform == "win32" and self.serial:
            return None
        if stream is None or (isinstance(self._wire, TcpWire) and self._wire.tls is not None):
            return None
        return int(stream.fileno())

    def port(self) -> SerialPort | None:
        """The serial port, where the drive is on one."""
        return self._wire.opened_as(self._timeout) if isinstance(self._wire, RtuLine) else None

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on; None: through nothing, yet."""
        self._drop()
        self._client.socket = stream  # type: ignore[assignment]

    def frame(self, function: int, address: int, words: list[int]) -> bytes:
        """The frame that `write` would send."""
        request: ModbusPDU
        if function == 22:
            request = MaskWriteRegisterRequest(address, words[0], words[1], dev_id=self._unit)
        elif function == 6 and len(words) == 1:
            request = WriteSingleRegisterRequest(
                address=address, registers=words, dev_id=self._unit
            )
        else:
            request = WriteMultipleRegistersRequest(
                address=address, registers=words, dev_id=self._unit
            )
        built: bytes = self._client.framer.buildFrame(request)
        return built

    def identification(self) -> dict[int, str]:
        """Basic device identification (FC 43/14), text by object id."""
        found: dict[int, str] = {}
        answer = self._ask(self._client.read_device_information, None, read_code=1, object_id=0)
        for key, value in getattr(answer, "information", {}).items():
            text = value if isinstance(value, bytes) else b"".join(value)
            found[int(key)] = text.decode("ascii", "replace").strip()
        return found

    def _registers(self, answer: ModbusPDU, count: int) -> list[int]:
        registers = list(getattr(answer, "registers", []))
        if len(registers) != count:
            raise LinkError(
                f"{self.where} sent {len(registers)} registers where {count} were asked for"
            )
        return registers

    def _drop(self) -> None:
        with contextlib.suppress(OSError):
            self._client.close()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Close the connection."""
        self._drop()


def _connected(
    wire: TcpWire, timeout: float, on_packet: Callable[[bool, bytes], bytes]
) -> ModbusTcpClient:
    """A client on an open socket; raises LinkError."""
    framer = FramerType.RTU if wire.rtu else FramerType.SOCKET
    client = ModbusTcpClient(
        wire.host, port=wire.port, framer=framer, timeout=timeout, retries=0,
        trace_packet=on_packet,
    )  # fmt: skip
    place = f"{wire.host}:{wire.port}"
    try:
        plain = socket.create_connection((wire.host, wire.port), timeout)
    except TimeoutError:
        raise LinkError(
            f"{place} does not answer within {timeout:g} s; is the address right, the cable in, the "
            "drive on?"
        ) from None
    except OSError as error:
        raise LinkError(
            f"cannot connect to {place}: {error.strerror or error}; is the address right, and Modbus "
            "TCP switched on in the drive?"
        ) from None
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    client.socket = plain if wire.tls is None else wire.tls.wrap(plain, wire.host)
    return client


_WORDS = {
    2: "there is no such port; is the adapter plugged in, and its driver there?",
    13: "this user may not use it (on Linux: add the user to group dialout, then log in again)",
    16: "another program has it open",
}


class _SerialClient(ModbusSerialClient):
    """A client on an open serial port; raises LinkError.

    It waits for bytes, where the library's own looks for them every millisecond.
    """

    def __init__(
        self, line: RtuLine, timeout: float, on_packet: Callable[[bool, bytes], bytes]
    ) -> None:
        super().__init__(
            line.port, baudrate=line.baudrate, parity=line.parity, stopbits=line.stopbits,
            timeout=timeout, retries=0, trace_packet=on_packet,
        )  # fmt: skip
        try:
            self.socket = line.opened_as(timeout).open()
        except OSError as error:
            number = getattr(error, "errno", None) or 0
            text = str(error)
            words = _WORDS.get(number, "") or (_WORDS[16] if "lock" in text else "")
            raise LinkError(f"cannot open {line.port}: {words or text}") from None

    def recv(self, size: int | None) -> bytes:
        """What there is, as soon as there is anything."""
        port = self.socket
        if port is None:
            raise ConnectionException(str(self))
        try:
            port.timeout = self.comm_params.timeout_connect
            first: bytes = port.read(1)
            return first + port.read(port.in_waiting) if first else b""
        except OSError:
            self.close()  # type: ignore[no-untyped-call]
            raise ConnectionException(str(self)) from None
