"""pymodbus' serial client, made prompt: it waits for bytes instead of looking for them every millisecond."""

from __future__ import annotations

from collections.abc import Callable

import serial
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ConnectionException

from drivers.modbus.wires import RtuLine
from profiles.errors import LinkError

__all__ = ["SerialClient"]

_WORDS = {
    2: "there is no such port; is the adapter plugged in, and its driver there?",
    13: "this user may not use it (on Linux: add the user to group dialout, then log in again)",
    16: "another program has it open",
}


class SerialClient(ModbusSerialClient):
    """A client on an open serial port; raises LinkError."""

    def __init__(
        self, line: RtuLine, timeout: float, on_packet: Callable[[bool, bytes], bytes]
    ) -> None:
        super().__init__(
            line.port, baudrate=line.baudrate, parity=line.parity, stopbits=line.stopbits,
            timeout=timeout, retries=0, trace_packet=on_packet,
        )  # fmt: skip
        try:
            self.socket = serial.serial_for_url(
                line.port, baudrate=line.baudrate, parity=line.parity, stopbits=line.stopbits,
                timeout=timeout, write_timeout=timeout, exclusive=True,
            )  # fmt: skip
        except (OSError, ValueError) as error:  # pyserial's own errors are OSErrors
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
