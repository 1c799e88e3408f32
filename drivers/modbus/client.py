"""pymodbus, behind one door: requests with one answer or one of our errors, never a retry."""

from __future__ import annotations

import contextlib
import struct
import sys
from collections.abc import Callable, Generator
from time import perf_counter
from typing import Any

from drivers.errors import LinkError, LinkLost, NoAnswer
from drivers.modbus.answers import (
    ACKNOWLEDGE,
    EXCEPTIONS,
    NO_TARGET,
    ExceptionAnswer,
    Kind,
    is_about,
    silence_text,
)
from drivers.modbus.incoming import Incoming, LineIncoming, MbapIncoming
from drivers.modbus.transports import (
    NEVER_DISCONNECT,
    ConnectionException,
    MaskWriteRegisterRequest,
    ModbusException,
    ModbusPDU,
    SerialClient,
    TcpClient,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
    connected,
    local,
)
from drivers.modbus.wires import LocalWire, RtuLine, TcpWire, Wire
from drivers.pace import Silence
from drivers.serial_port import SerialPort, Stream
from profiles.procedures import LinkDefaults

__all__ = ["POST_ANSWER", "Client", "NoAnswer"]


BytesTrace = Callable[[bool, bytes], None]

POST_ANSWER = 0.01  # s that a posted write may hold up the next one
_QUIET_TIME = 0.001  # s before a request outside the cycle
_WATCHDOG_MARGIN = 1.5  # the longest answer: a watchdog whose three missed cycles outlast it
_NO_TIME = 5e-4  # s


class Client:
    """One connection to one unit.

    Parameters
    ----------
    wire : where the drive is, and how it is talked to there
    unit : address of the drive on that wire
    timeout : s, for connecting and for requests outside the cycle
    trace : called with (sending, bytes) for every packet, once
    longest_answer : s; on a line, whose answers do not say what they answer, nothing is sent after
        a missed one until it has come late, or so long has passed

    Attributes
    ----------
    quiet_time : s for which a line is listened to before a request outside the cycle: nothing may
        come

    Raises
    ------
    LinkError
        The host or the port cannot be reached.
    """

    def __init__(
        self,
        wire: Wire,
        unit: int,
        timeout: float,
        trace: BytesTrace | None = None,
        longest_answer: float = LinkDefaults().longest_answer,
    ) -> None:
        self._wire = wire
        self.turn_to(unit)
        self._timeout = timeout
        self._trace = trace
        self._longest = longest_answer
        self._silence = Silence(wire.silence) if wire.silence else None
        self._is_line = isinstance(wire, RtuLine) or wire.rtu
        self._incoming: Incoming = LineIncoming() if self._is_line else MbapIncoming()
        self.quiet_time = _QUIET_TIME
        self._owed = 0  # answers that have not come
        self._owed_until = 0.0
        self._late = b""  # of them
        self._client: TcpClient | SerialClient
        if isinstance(wire, RtuLine):
            self._client = SerialClient(wire, timeout, self._sent, self._came)
        elif isinstance(wire, LocalWire):
            self._client = local(wire, timeout, self._sent, self._came)
        else:
            self._client = connected(wire, timeout, self._sent, self._came)

    def turn_to(self, unit: int) -> None:
        """Talk to another unit on the same connection from now on."""
        self.where = f"{self._wire} unit {unit}"
        self._unit = unit
        # whose answer may still come, after all; function and register of a read that it has
        # answered
        self._missed: Kind | None = None
        self._readable: tuple[int, int] | None = None

    @property
    def own_address(self) -> str:
        """Address of this computer on the connection; '' on a line."""
        name = getattr(self._client.socket, "getsockname", None)
        return str(name()[0]) if name is not None else ""

    @property
    def owes(self) -> bool:
        """Whether an answer may still come late."""
        return self._owed > 0

    @property
    def oddity(self) -> str:
        """What is not as it is to be on this link, and was borne with; ''."""
        return self._incoming.oddity

    def _sent(self, sending: bool, data: bytes) -> bytes:
        """A request leaves; what comes is seen where it is received."""
        if sending:
            self._incoming.ask(data)
            if self._trace is not None:
                self._trace(True, data)
        return data

    def _came(self, data: bytes) -> bytes:
        if self._trace is not None:
            self._trace(False, data)
        return self._incoming.take(data)

    def _ask(
        self,
        request: Callable[..., ModbusPDU],
        kind: Kind,
        timeout: float | None,
        *,
        at_once: bool = False,
        in_cycle: bool = False,
        **arguments: Any,
    ) -> ModbusPDU:
        """One request, one answer; both of pymodbus' error channels become our errors.

        `at_once`: whatever may still come, for a stop. `in_cycle`: one that has to wait is missed.
        """
        client = self._client
        if client.socket is None:
            raise LinkLost(f"the connection to {self.where} is closed", code="link.closed")
        patience = self._timeout if timeout is None else timeout
        if self._is_line:
            self._settle(kind, 0.0 if at_once else patience, in_cycle=in_cycle)
        client.transaction.count_until_disconnect = NEVER_DISCONNECT
        client.comm_params.timeout_connect = patience
        client.transaction.comm_params.timeout_connect = patience
        if self._silence is not None:
            self._silence.keep()
        client.until = perf_counter() + patience
        try:
            answer = request(device_id=self._unit, **arguments)
        except ConnectionException:
            raise LinkLost(
                f"{self.where} closed the connection (cable, power, or too many masters?)",
                code="link.closed",
            ) from None
        except OSError as error:
            self._drop()
            raise LinkLost(
                f"the connection to {self.where} broke: {error.strerror or error}",
                code="link.closed",
            ) from None
        except ModbusException:
            has_come = self._incoming.is_broken()
            if self._is_line and not has_come:
                self._owe(kind)
            raise NoAnswer(silence_text(self.where, self._unit, self._incoming, patience)) from None
        except (IndexError, ValueError, KeyError, AttributeError, TypeError, struct.error) as error:
            # a malformed answer trips the library's decoder
            raise LinkError(
                f"{self.where} sent an answer that is no Modbus ({type(error).__name__}: {error})",
                code="link.answer",
            ) from None
        finally:
            if self._silence is not None:
                self._silence.begin()
        function = answer.function_code & 0x7F
        if function != kind.function or not is_about(answer, arguments):
            if self._is_line:
                raise self._of_before(kind)
            raise LinkError(
                f"{self.where} answers a write of register {arguments.get('address', 0):04X}h with "
                "something else: that is no answer to it",
                code="link.answer",
                hint="is this drive's profile right?",
            )
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            raise ExceptionAnswer(
                f"{self.where} refuses function {function}: exception {code} "
                f"({EXCEPTIONS.get(code, 'unknown')})",
                code,
            )
        return answer

    # -- a line, whose answers do not say what they answer ----------------------------------------

    def _owe(self, kind: Kind) -> None:
        """An answer did not come: it may come late."""
        self._owed += 1
        self._owed_until = perf_counter() + self._longest
        self._missed = kind

    def _of_before(self, kind: Kind) -> NoAnswer:
        """An answer came late, after all; that to the last request is still to come."""
        self._owed = max(self._owed - 1, 0)
        self._owe(kind)
        return NoAnswer(f"{self.where} answered to an earlier request, late")

    def _settle(self, kind: Kind, patience: float, *, in_cycle: bool) -> None:
        """Let what is owed come in, for `patience` s at most.

        Raises NoAnswer where it does not, LinkLost.

        In the cycle one that had to wait is missed. Where the late answer never came, the next
        request is one whose answer cannot be taken for it.
        """
        begun = now = perf_counter()
        until = self._owed_until
        if in_cycle or not patience:
            until = min(until, begun + patience)
        is_owed = bool(self._owed)
        quiet = self.quiet_time if patience and not in_cycle else 0.0
        self._late += self._incoming.rest
        is_stray = self._take_late(quiet) and not is_owed
        while self._owed and (now := perf_counter()) < until:
            self._take_late(until - now)
        if not patience:
            return
        if self._owed and now < self._owed_until:
            raise NoAnswer(
                f"{self.where} still owes an answer: nothing is sent until it has come, or "
                f"{self._longest:g} s have passed ([link] longest_answer in the profile: no longer "
                "than answers may be late); a --watchdog of "
                f"{_WATCHDOG_MARGIN * self._longest:.2g} bears it"
            )
        missed = self._missed if self._owed else None
        self._owed, self._late, self._missed = 0, b"", None
        if is_stray and not in_cycle:
            raise LinkError(
                f"{self.where} sent an answer that nobody waited for: do answers come twice, or "
                "does another master ask on this line? No value can be relied on: find out first",
                code="link.answer",
            )
        if in_cycle and (is_stray or now - begun > _NO_TIME):
            raise NoAnswer(f"{self.where} answered late: this cycle is missed")
        if missed == kind and self._readable is not None:
            function, address = self._readable
            count = 1 if kind != Kind(function, 1) else 2
            with contextlib.suppress(ExceptionAnswer):
                self.read(function, address, count, patience)

    def _take_late(self, seconds: float) -> bool:
        """What comes within some time, or is there; whether it is a whole answer."""
        try:
            data = self._client.raw(seconds)
        except (ConnectionException, OSError):
            raise LinkLost(
                f"{self.where} closed the connection (cable, power?)", code="link.closed"
            ) from None
        if data and self._trace is not None:
            self._trace(False, data)
        self._late, answers = self._incoming.late_in(self._late + data)
        self._owed = max(self._owed - answers, 0)
        return answers > 0

    def read(
        self,
        function: int,
        address: int,
        count: int,
        timeout: float | None = None,
        *,
        in_cycle: bool = False,
    ) -> list[int]:
        """Registers by FC 3 or 4."""
        request = (
            self._client.read_holding_registers
            if function == 3
            else self._client.read_input_registers
        )
        kind = Kind(function, count)
        answer = self._ask(request, kind, timeout, in_cycle=in_cycle, address=address, count=count)
        self._readable = function, address
        return self._registers(answer, count, kind)

    def write(
        self,
        function: int,
        address: int,
        words: list[int],
        timeout: float | None = None,
        *,
        at_once: bool = False,
        in_cycle: bool = False,
    ) -> None:
        """Registers by FC 6 or 16; by FC 22 `words` are the AND and the OR mask of one register.

        `at_once`: whatever may still come, for a stop. `in_cycle`: one that has to wait is missed.
        """
        client, request = self._client, dict[str, Any](address=address)
        send: Callable[..., ModbusPDU]
        if function == 22:
            send = client.mask_write_register
            request |= {"and_mask": words[0], "or_mask": words[1]}
        elif function == 6 and len(words) == 1:
            send = client.write_register
            request |= {"value": words[0]}
        else:
            function, send = 16, client.write_registers
            request |= {"values": words}
        kind = Kind(function, 0)
        try:
            self._ask(send, kind, timeout, at_once=at_once, in_cycle=in_cycle, **request)
        except ExceptionAnswer as error:
            if error.exception == ACKNOWLEDGE:
                return  # it is accepted, and in work
            if error.exception == NO_TARGET and not (at_once or in_cycle):
                # whether it was done nobody knows: it is looked at, and not sent again
                raise NoAnswer(str(error)) from None
            raise

    def read_write(
        self,
        read_address: int,
        count: int,
        write_address: int,
        words: list[int],
        timeout: float | None,
        *,
        in_cycle: bool = False,
    ) -> list[int]:
        """Write, then read, in one transaction (FC 23)."""
        kind = Kind(23, count)
        answer = self._ask(
            self._client.readwrite_registers,
            kind,
            timeout,
            in_cycle=in_cycle,
            read_address=read_address,
            read_count=count,
            write_address=write_address,
            values=words,
        )
        self._readable = 3, read_address
        return self._registers(answer, count, kind)

    def post(self, function: int, address: int, words: list[int]) -> None:
        """Send a write; an answer that does not come at once is not waited for. Raises LinkLost.

        Drives take one transaction at a time, so a second post must not overtake the first.
        """
        with contextlib.suppress(NoAnswer):
            self.write(function, address, words, POST_ANSWER, at_once=True)

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
        """Descriptor of the port or the connection.

        None where it cannot be lent (TLS, closed, a port on Windows).
        """
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
        """Give the serial port back and speak through `stream` from now on.

        None: through nothing, yet.
        """
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
        kind, request = Kind(43, 0), self._client.read_device_information
        answer = self._ask(request, kind, None, read_code=1, object_id=0)
        for key, value in getattr(answer, "information", {}).items():
            text = value if isinstance(value, bytes) else b"".join(value)
            found[int(key)] = text.decode("ascii", "replace").strip()
        return found

    def _registers(self, answer: ModbusPDU, count: int, kind: Kind) -> list[int]:
        registers = list(getattr(answer, "registers", []))
        if len(registers) != count:
            if self._is_line:
                raise self._of_before(kind)
            raise LinkError(
                f"{self.where} sent {len(registers)} registers where {count} were asked for",
                code="link.answer",
            )
        return registers

    def _drop(self) -> None:
        with contextlib.suppress(OSError):
            self._client.close()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Close the connection."""
        self._drop()
