"""CAN adapters of every kind, by python-can, and what some of them need."""

from __future__ import annotations

import select
import socket
import sys
import time
from typing import Any

import can
from can import BusABC, CanError, Message
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcand import SocketCanDaemonBus

from drivers.errors import LinkError
from profiles.errors import UsageError

__all__ = ["BusABC", "CanError", "Message", "Slcan", "Socketcand", "first_line", "open_bus"]

_FRAMES = (b"t", b"T", b"r", b"R", b"x")  # lines of slcan that are frames; x: CANDapter's T
_LONGEST_LINE = 4096  # bytes without an end: no adapter of this kind


def open_bus(interface: str, channel: str, bitrate: int, timeout: float) -> can.BusABC:
    """Open a CAN adapter by python-can's names; raises LinkError, UsageError."""
    options: dict[str, Any] = {"bitrate": bitrate}
    if interface == "slcan":
        options["sleep_after_open"] = 0
        options["timeout"] = 0.001 if sys.platform == "win32" else 0
    elif interface == "socketcand":
        host, port, channel = _socketcand_address(channel)
        _greet(host, port, timeout)
        options = {"host": host, "port": port, "tcp_tune": True}
    elif interface in ("virtual", "socketcan"):
        options = {}
    try:
        if interface == "socketcand":
            bus: can.BusABC = Socketcand(channel=channel, **options)  # type: ignore[no-untyped-call]
        elif interface == "slcan":
            bus = Slcan(channel=channel, **options)
        else:
            bus = can.Bus(interface=interface, channel=channel, **options)
    except can.CanInterfaceNotImplementedError as error:
        if interface not in can.VALID_INTERFACES:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise UsageError(f"no CAN interface '{interface}'; python-can has: {known}") from None
        raise LinkError(
            f"CAN interface '{interface}' cannot be used here: {first_line(error)}",
            code="link.adapter",
            hint="is its driver installed?",
        ) from None
    except Exception as error:
        raise LinkError(
            f"cannot open CAN channel '{channel}' on '{interface}': {first_line(error)}",
            code="link.adapter",
            hint="is the adapter plugged in, and free?",
        ) from None
    if interface == "socketcand":
        _untangle_socketcand(bus)
    return bus


class Socketcand(SocketCanDaemonBus):
    """python-can's client, which takes a frame within a busy bus' greeting for an error.

    Here such a frame is delivered, with the next one.
    """

    def _expect_msg(self, message: str) -> None:
        stream: socket.socket = self._SocketCanDaemonBus__socket  # type: ignore[attr-defined]
        heard = ""
        while len(heard) < len(message):
            more = stream.recv(256).decode("ascii", "replace")
            if not more:
                break
            heard += more
        if not heard.startswith(message):
            stream.close()
            raise can.CanError(f"it says '{heard[:40]}' where '{message}' is expected")
        self._SocketCanDaemonBus__receive_buffer: str = heard[len(message) :]


class Slcan(slcanBus):
    """python-can's client, which asks the system for every byte: here for all that has come.

    The adapter's acknowledgements are passed over; a line that cannot be read is lost alone.
    """

    is_dead = False  # at the last read nothing was there

    def await_data(self, timeout: float) -> bool:
        """Wait until something can be read, at most `timeout` s."""
        return b"\r" in self._buffer or bool(select.select([self.fileno()], [], [], timeout)[0])

    def _read(self, timeout: float | None) -> str | None:
        port, deadline = self.serialPortOrig, time.perf_counter() + (timeout or 0.0)
        self.is_dead, is_late = True, False
        while True:
            while (end := self._buffer.find(b"\r")) >= 0:
                line = self._buffer[:end].lstrip(b"\a")
                del self._buffer[: end + 1]
                self.is_dead = False
                if line[:1] in _FRAMES:
                    return line.decode("ascii")
            if is_late:
                return None
            try:
                data = port.read(max(port.in_waiting, 1))
            except (OSError, TypeError) as error:  # TypeError: closed meanwhile
                raise can.CanOperationError(
                    f"cannot read from the serial device: {error}"
                ) from error
            self.is_dead = self.is_dead and not data
            self._buffer += data
            if len(self._buffer) > _LONGEST_LINE and b"\r" not in data:
                self._buffer.clear()
            is_late = time.perf_counter() >= deadline


def _untangle_socketcand(bus: can.BusABC) -> None:
    """Bound the time that a send to a full socket may block."""
    stream = getattr(bus, "_SocketCanDaemonBus__socket", None)
    if isinstance(stream, socket.socket):
        stream.settimeout(1.0)


def _socketcand_address(channel: str) -> tuple[str, int, str]:
    place, slash, name = channel.partition("/")
    host, colon, port = place.rpartition(":")
    if not slash or not colon or not port.isdigit() or not name:
        raise UsageError(
            f"'{channel}': a socketcand link is canopen://socketcand/HOST:PORT/CHANNEL?node=N"
        )
    return host, int(port), name


def _greet(host: str, port: int, timeout: float) -> None:
    """See that a socketcand server answers, quickly.

    The library would wait for 10 s or for ever.
    """
    try:
        with socket.create_connection((host, port), timeout) as stream:
            stream.settimeout(timeout)
            hello = stream.recv(64)
    except TimeoutError:
        raise LinkError(
            f"{host}:{port} does not greet as socketcand within {timeout:g} s: is it that port?",
            code="link.socketcand",
        ) from None
    except OSError as error:
        raise LinkError(
            f"cannot connect to socketcand at {host}:{port}: {error.strerror or error}",
            code="link.connect",
        ) from None
    if not hello.startswith(b"< hi"):
        raise LinkError(
            f"{host}:{port} is no socketcand server: it says {hello[:20]!r}", code="link.socketcand"
        )


def first_line(error: Exception) -> str:
    """Libraries put tracebacks into their messages.

    People get the first line, and the system's reason.
    """
    lines = str(error).splitlines()
    if not lines:
        return type(error).__name__
    line = lines[0].removesuffix("Traceback (most recent call last):").strip()
    reason = getattr(error.__cause__, "strerror", None) or str(error.__cause__ or "").strip()
    return f"{line} ({reason})" if reason and reason not in line else line
