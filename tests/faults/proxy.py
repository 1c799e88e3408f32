"""A wire that breaks one transaction, in one of the ways in which transactions break."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.link import parse
from tests.faults.framing import Framing, ModbusRtu, ModbusTcp, Slcan, Socketcand
from tests.faults.two_key import TWO_KEY

__all__ = ["NEED_NO_ANSWER", "OF_TWO_KEYS", "WATCHED", "WIRES", "Proxy", "Way", "Wire", "drive_end"]


WATCHED = (
    "max_torque", "max_speed", "abort_connection_option", "quick_stop_option", "watchdog_time",
    "mode_of_operation", "torque_target", "coulomb_positive", "coulomb_negative",
    "viscous_gain", "torque_offset",
)  # fmt: skip
OF_TWO_KEYS = (
    "max_torque", "max_speed", "watchdog_time", "control_mode", "key_1", "key_2", "halt",
    "torque_target",
    "torque_offset", "friction_positive", "friction_negative",
)  # fmt: skip


class Way(StrEnum):
    """What happens to the transaction, or from then on."""

    LOST_REQUEST = "request lost"
    LOST_ANSWER = "answer lost"
    LATE = "answer with the next one's"
    TWICE = "answer twice"
    TRUNCATED = "answer truncated"
    CORRUPTED = "answer corrupted"
    RESET = "connection reset, or adapter unplugged"
    SILENT = "silent for ever"


NEED_NO_ANSWER = frozenset({Way.LOST_REQUEST})  # the others are those of the next transaction


@dataclass(frozen=True)
class Wire:
    """How a wire is served, and what a link through the proxy looks like.

    Attributes
    ----------
    serve : arguments of `virtual serve`
    profile : built-in one, or a file
    link : with {} for the place of the proxy
    pty : the host's end is a pseudo-terminal
    watched : parameters that must be as before
    is_own : it is not our own virtual drive, and so is looked at by its own profile
    """

    framing: Callable[[], Framing]
    serve: tuple[str, ...]
    profile: str
    link: str
    pty: bool
    watched: tuple[str, ...] = WATCHED
    is_own: bool = False


WIRES = {
    "modbus-tcp": Wire(
        ModbusTcp, ("--modbus-tcp", "127.0.0.1:0"), "virtual-modbus",
        "modbus-tcp://127.0.0.1:{}?unit=1", pty=False,
    ),
    "modbus-rtu": Wire(
        ModbusRtu, ("--modbus-rtu-tcp", "127.0.0.1:0"), "virtual-modbus",
        "modbus-rtu://{}?baudrate=115200&unit=1", pty=True,
    ),
    "slcan": Wire(
        Slcan, ("--slcan", "pty"), "virtual-canopen",
        "canopen://slcan/{}?node=5&bitrate=500000", pty=True,
    ),
    "socketcand": Wire(
        Socketcand, ("--socketcand", "127.0.0.1:0"), "virtual-canopen",
        "canopen://socketcand/127.0.0.1:{}/can0?node=5", pty=False,
    ),
    "two-key": Wire(
        ModbusTcp, ("--profile", TWO_KEY, "--modbus-tcp", "127.0.0.1:0"), TWO_KEY,
        "modbus-tcp://127.0.0.1:{}?unit=1", pty=False, watched=OF_TWO_KEYS, is_own=True,
    ),
}  # fmt: skip


class Proxy:
    """Between one host at a time and the drive.

    Counts transactions, and breaks number `at` (from 0).

    Attributes
    ----------
    place : port, or path of the host's pseudo-terminal
    answered : of each transaction, whether the drive answers to it
    """

    def __init__(
        self, wire: Wire, drive: int | str, at: int | None = None, way: Way = Way.LOST_ANSWER
    ) -> None:
        self.answered: list[bool] = []
        self._wire, self._drive = wire, drive
        self._at, self._way = at, way
        self._wake, self._bell = os.pipe()
        self._listener: socket.socket | None = None
        self._pty: tuple[int, int] | None = None
        if wire.pty:
            import tty

            self._pty = os.openpty()
            tty.setraw(self._pty[1])
            self.place = os.ttyname(self._pty[1]).replace(
                "/", "/" if wire.profile.endswith("modbus") else "%2F"
            )
        else:
            self._listener = socket.create_server(("127.0.0.1", 0))
            self.place = str(self._listener.getsockname()[1])
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def count(self) -> int:
        """Transactions so far."""
        return len(self.answered)

    def cut(self) -> None:
        """Silent from now on, both ways."""
        self._session.silent = True

    def close(self) -> None:
        """End, whatever the host does."""
        os.write(self._bell, b"x")
        self._thread.join()
        if self._listener is not None:
            self._listener.close()
        for end in (*(self._pty or ()), self._wake, self._bell):
            os.close(end)

    def _run(self) -> None:
        while True:
            with contextlib.ExitStack() as stack:
                host = self._host(stack)
                if host is None:
                    return
                drive = _open(self._drive, stack)
                self._session = _Session(self, host, drive)
                if not self._session.run():
                    return

    def _host(self, stack: contextlib.ExitStack) -> int | None:
        """The end to the next host; None: the proxy ends."""
        if self._pty is not None:
            return self._pty[0]
        assert self._listener is not None
        ready, _, _ = select.select([self._listener.fileno(), self._wake], [], [])
        if self._wake in ready:
            return None
        client, _ = self._listener.accept()
        stack.enter_context(client)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setblocking(False)
        self._client = client
        return client.fileno()

    def _hang_up(self) -> None:
        """Reset the connection, or take the adapter away."""
        if self._pty is not None:
            for end in self._pty:
                os.close(end)
            self._pty = None
            return
        self._client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._client.close()


def drive_end(link: str) -> int | str:
    """Port or path of the drive's end of a wire, from the drive's own link."""
    place = parse(link).place
    if "slcan" in place:
        return place.removeprefix("slcan/").replace("%2F", "/")
    return int(place.removeprefix("socketcand/").split("/")[0].rpartition(":")[2])


def _open(drive: int | str, stack: contextlib.ExitStack) -> int:
    if isinstance(drive, str):
        descriptor = os.open(drive, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        stack.callback(os.close, descriptor)
        return descriptor
    stream = stack.enter_context(socket.create_connection(("127.0.0.1", drive)))
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setblocking(False)
    return stream.fileno()


class _Session:
    """One host, one connection to the drive."""

    def __init__(self, proxy: Proxy, host: int, drive: int) -> None:
        self._proxy, self._host, self._drive = proxy, host, drive
        self._framing = proxy._wire.framing()
        self._begun = {host: b"", drive: b""}
        self._breaks: Way | None = None  # the next answer
        self._kept = b""
        self.silent = False

    def run(self) -> bool:
        """Until the host goes; False: the proxy ends."""
        proxy = self._proxy
        while True:
            ready, _, _ = select.select([self._host, self._drive, proxy._wake], [], [])
            if proxy._wake in ready:
                return False
            for end in ready:
                data = _read(end)
                if not data:
                    return proxy._pty is None
                messages, self._begun[end] = self._framing.split(
                    self._begun[end] + data, from_host=end == self._host
                )
                for message in messages:
                    if end == self._drive:
                        self._from_drive(message)
                    elif not self._from_host(message):
                        proxy._hang_up()
                        return proxy._listener is not None

    def _from_host(self, message: bytes) -> bool:
        """Pass a message on; False: the connection ends here."""
        proxy, way = self._proxy, self._proxy._way
        if self._framing.counts(message):
            proxy.answered.append(self._framing.is_answered(message))
            if len(proxy.answered) - 1 == proxy._at:
                if way is Way.RESET:
                    return False
                self.silent = way is Way.SILENT
                if way is Way.LOST_REQUEST:
                    return True
                self._breaks = way
        if not self.silent:
            _write(self._drive, message)
        return True

    def _from_drive(self, message: bytes) -> None:
        way, self._breaks = self._breaks, None
        if self.silent or way is Way.LOST_ANSWER:
            return
        if way is Way.LATE:
            self._kept = message
            return
        if way is Way.TWICE:
            message += message
        elif way is Way.TRUNCATED:
            message = self._framing.truncated(message)
        elif way is Way.CORRUPTED:
            message = self._framing.corrupted(message)
        _write(self._host, self._kept + message)
        self._kept = b""


def _read(end: int) -> bytes:
    try:
        return os.read(end, 4096)
    except BlockingIOError:
        return b""
    except OSError:
        return b""


def _write(end: int, data: bytes) -> None:
    with contextlib.suppress(OSError):
        os.write(end, data)
