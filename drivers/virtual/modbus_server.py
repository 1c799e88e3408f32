"""The virtual drive on Modbus: connections and serial lines around the slave."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable

from drivers.virtual.modbus_framing import Framing
from drivers.virtual.pseudo_terminal import pseudo_terminal

__all__ = ["ModbusServer", "SerialLine"]

_SILENCE = (
    0.02  # s after which what has come is all of a frame; on TCP, and where others run, no less
)
_CHUNK = 4096

NewFraming = Callable[[], Framing]


class _Silence:
    """Tells a framing when nothing more has come."""

    def __init__(self, framing: Framing, write: Callable[[list[bytes]], None]) -> None:
        self._framing, self._write = framing, write
        self._timer: asyncio.TimerHandle | None = None

    def restart(self) -> None:
        """Something came."""
        self.cancel()
        if self._framing.is_incomplete:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(_SILENCE, self._tell)

    def _tell(self) -> None:
        self._write(self._framing.silence())

    def cancel(self) -> None:
        """The line is gone."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _after(wait: float, send: Callable[[bytes], None], part: bytes) -> None:
    if wait:
        asyncio.get_running_loop().call_later(wait, send, part)
    else:
        send(part)


class _Connection(asyncio.Protocol):
    """A client; one that does not read its answers is not listened to until it does.

    No buffer grows.
    """

    def __init__(self, server: ModbusServer) -> None:
        self._server = server
        self._framing = server.framing()
        self._silence = _Silence(self._framing, self._write)
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A client has come."""
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._server.connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """It has gone."""
        self._silence.cancel()
        self._server.connections.discard(self)

    def data_received(self, data: bytes) -> None:
        """It asks something."""
        self._write(self._framing.feed(data))
        self._silence.restart()
        if self._framing.is_closed and self.transport is not None:
            self.transport.abort()

    def _write(self, answers: list[bytes]) -> None:
        for answer in answers:
            for wait, part in self._framing.due(answer):
                _after(wait, self._send, part)

    def _send(self, part: bytes) -> None:
        if self.transport is not None and not self.transport.is_closing():
            self.transport.write(part)

    def pause_writing(self) -> None:
        """More than asyncio's mark waits to be read."""
        if self.transport is not None:
            self.transport.pause_reading()

    def resume_writing(self) -> None:
        """It reads again."""
        if self.transport is not None:
            self.transport.resume_reading()


class ModbusServer:
    """Listens on a port; each connection has a framing of its own."""

    def __init__(self, framing: NewFraming) -> None:
        self.framing = framing
        self.connections: set[_Connection] = set()
        self._server: asyncio.Server | None = None

    async def start(self, host: str, port: int) -> int:
        """Listen on host:port (0: any free one); return the port."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Connection(self), host, port)
        return int(self._server.sockets[0].getsockname()[1])

    def let_go(self) -> None:
        """End every connection, whether or not its client has read all, and listen no more."""
        for connection in list(self.connections):
            if connection.transport is not None:
                connection.transport.abort()
        if self._server is not None:
            self._server.close()


class SerialLine:
    """The far end of a pseudo-terminal, with the drive on it."""

    def __init__(self, framing: Framing) -> None:
        self._framing = framing
        self._master, self._slave, self.path = pseudo_terminal()
        self._silence = _Silence(framing, self._write)
        self._is_closed = False
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            self._write(self._framing.feed(os.read(self._master, _CHUNK)))
            self._silence.restart()

    def _write(self, answers: list[bytes]) -> None:
        for answer in answers:
            for wait, part in self._framing.due(answer):
                _after(wait, self._send, part)

    def _send(self, part: bytes) -> None:
        if not self._is_closed:
            with contextlib.suppress(BlockingIOError, OSError):  # nobody reads: the line forgets
                os.write(self._master, part)

    def close(self) -> None:
        """Take the line away."""
        self._is_closed = True
        self._silence.cancel()
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
