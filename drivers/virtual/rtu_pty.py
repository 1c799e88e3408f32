"""A serial line to the virtual drive: a pseudo-terminal, joined to a server of RTU frames on loopback."""

from __future__ import annotations

import asyncio
import contextlib
import os

from drivers.virtual.pseudo_terminal import pseudo_terminal

__all__ = ["RtuPty"]

_CHUNK = 4096


class RtuPty:
    """The far end of a pseudo-terminal; what comes in goes to a server on loopback, and back."""

    def __init__(self) -> None:
        self._master, self._slave, self.path = pseudo_terminal()
        self._back: asyncio.Task[None] | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def join(self, port: int) -> None:
        """Connect to the server on 127.0.0.1:`port`."""
        reader, self._writer = await asyncio.open_connection("127.0.0.1", port)
        loop = asyncio.get_running_loop()
        loop.add_reader(self._master, self._forward, self._writer)
        self._back = loop.create_task(self._answers(reader))

    def _forward(self, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            writer.write(os.read(self._master, _CHUNK))

    async def _answers(self, reader: asyncio.StreamReader) -> None:
        while data := await reader.read(_CHUNK):
            with contextlib.suppress(BlockingIOError, OSError):  # nobody reads: the line forgets
                os.write(self._master, data)

    async def close(self) -> None:
        """Give everything back."""
        asyncio.get_running_loop().remove_reader(self._master)
        if self._back is not None:
            self._back.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._back
        if self._writer is not None:
            self._writer.transport.abort()
        os.close(self._master)
        os.close(self._slave)
