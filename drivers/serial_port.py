"""A serial port, and one that another process owns: the owner passes the bytes on.

Where a process cannot inherit an open port (Windows), the guardian owns it while the axis may move,
and the loop speaks through a socket. When the guardian ends, the loop opens the port itself.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import serial

__all__ = ["Lending", "LentPort", "SerialPort", "Stream"]

_CHUNK = 4096
_PAUSE = 0.02  # s between two tries to open a port whose owner is about to end
_LOOK = 0.05  # s between two looks whether there is still somebody to pass bytes on to


class Stream(Protocol):
    """What the libraries ask of a serial port; the time-outs, in s, bound `read` and `write`."""

    timeout: float | None
    write_timeout: float | None

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""

    def read(self, size: int = 1) -> bytes:
        """At most `size` bytes, as many as come within `timeout`."""

    def write(self, data: bytes, /) -> int | None:
        """Send bytes; raises OSError."""

    def flush(self) -> None:
        """Wait until they have left."""

    def reset_input_buffer(self) -> None:
        """Forget what has come."""

    def fileno(self) -> int:
        """What select waits on."""

    def close(self) -> None:
        """Give the port back."""


@dataclass(frozen=True, slots=True)
class SerialPort:
    """Where a port is and how it is set.

    Parameters
    ----------
    device : /dev/ttyUSB0 or COM5
    baudrate : bits a second
    parity : N, E or O
    stopbits : 1 or 2
    timeout, write_timeout : s that a read or a write may take; None: no end
    """

    device: str
    baudrate: int
    parity: str = "N"
    stopbits: float = 1
    timeout: float | None = None
    write_timeout: float | None = None

    def open(self) -> serial.Serial:
        """The open port, for this process alone; raises OSError, whatever the system raises."""
        try:
            return serial.Serial(
                self.device, baudrate=self.baudrate, parity=self.parity, stopbits=self.stopbits,
                timeout=self.timeout, write_timeout=self.write_timeout, exclusive=True,
            )  # fmt: skip
        except OSError:
            raise
        except Exception as error:  # termios' errors, which are no OSErrors
            raise OSError(*error.args) from None

    def open_when_free(self, patience: float = 2.0) -> serial.Serial:
        """The open port, as soon as its owner has ended, at most `patience` s from now.

        Raises OSError.
        """
        for _ in range(round(patience / _PAUSE)):
            with contextlib.suppress(OSError):
                return self.open()
            time.sleep(_PAUSE)
        return self.open()


class LentPort:
    """A port that another process owns, spoken to through `link`.

    This process' own once that is gone.

    `patience` : s that the owner may take to end once it has hung up
    """

    def __init__(self, link: socket.socket, port: SerialPort, patience: float = 2.0) -> None:
        self.timeout = port.timeout
        self.write_timeout = port.write_timeout
        self._link = link
        self._port = port
        self._patience = patience
        self._own: serial.Serial | None = None
        self._heard = bytearray()

    def reclaim(self) -> None:
        """Open the port here: its owner has ended. Raises OSError."""
        if self._own is None:
            self._link.close()
            self._own = self._port.open_when_free(self._patience)

    def _fill(self, seconds: float) -> None:
        """Take what comes within `seconds`; raises OSError."""
        if self._own is None and self._link.fileno() < 0:
            self.reclaim()
        if self._own is not None:
            self._own.timeout = seconds
            self._heard += self._own.read(max(self._own.in_waiting, 1))
            return
        try:
            if select.select([self._link], [], [], seconds)[0]:
                heard = self._link.recv(_CHUNK)
                if not heard:
                    raise ConnectionResetError
                self._heard += heard
        except ConnectionError:
            self.reclaim()

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._fill(0.0)
        return len(self._heard)

    def read(self, size: int = 1) -> bytes:
        """At most `size` bytes, as many as come within `timeout`."""
        until = None if self.timeout is None else time.perf_counter() + self.timeout
        while len(self._heard) < size:
            left = _LOOK if until is None else until - time.perf_counter()
            if left < 0 and until is not None:
                break
            self._fill(max(left, 0.0))
        found = bytes(self._heard[:size])
        del self._heard[:size]
        return found

    def write(self, data: bytes) -> int:
        """Send bytes; by the port itself where its owner is gone. Raises OSError."""
        if self._own is None:
            try:
                self._link.sendall(data)
                return len(data)
            except OSError:
                self.reclaim()
        assert self._own is not None
        return self._own.write(data) or 0

    def flush(self) -> None:
        """Wait until they have left."""
        if self._own is not None:
            self._own.flush()

    def reset_input_buffer(self) -> None:
        """Forget what has come."""
        self._fill(0.0)
        self._heard.clear()

    def fileno(self) -> int:
        """What select waits on."""
        return int((self._own or self._link).fileno())

    def close(self) -> None:
        """Give the port back."""
        (self._own or self._link).close()


class Lending:
    """An open port whose owner passes bytes between it and a borrower, until it speaks."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port
        self._is_lent = True
        self._turn = threading.Lock()
        port.timeout, port.write_timeout = _LOOK, None

    def pass_on(self, link: socket.socket) -> None:
        """Begin to pass bytes on, both ways; a port that fails ends the borrower's connection."""
        first_to_end = threading.Semaphore(1)

        def to_borrower() -> None:
            while self._is_lent:
                if heard := self._port.read(max(self._port.in_waiting, 1)):
                    link.sendall(heard)

        def to_port() -> None:
            while said := link.recv(_CHUNK):
                with self._turn:
                    if not self._is_lent:
                        return
                    self._port.write(said)

        def ending(way: Callable[[], None]) -> None:
            with contextlib.suppress(OSError, TypeError):  # TypeError: closed meanwhile
                way()
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            if not first_to_end.acquire(blocking=False):
                link.close()

        for way in (to_borrower, to_port):
            threading.Thread(target=ending, args=(way,), daemon=True).start()

    def write(self, data: bytes) -> None:
        """What the owner says; from now on what the borrower says goes nowhere."""
        self._is_lent = False
        if self._turn.acquire(
            timeout=_LOOK
        ):  # a borrower's write that hangs does not hold the owner up
            self._turn.release()
        self._port.write(data)

    def close(self) -> None:
        """Give the port back."""
        self._port.close()
