"""Wires for a virtual CAN bus between processes: slcan on a pty, and the socketcand protocol.

The bus carries frames between all its clients and the node, as a real one does.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Sequence

from drivers.virtual.canopen_node import CanopenNode, Frame
from drivers.virtual.pseudo_terminal import pseudo_terminal

__all__ = ["CanBus", "SlcanPty", "SocketcandServer"]

Deliver = Callable[[Frame], None]
_LONGEST_LINE = 200
_MOST_UNREAD = 1_000_000  # bytes that a client may leave unread: ten thousands of frames


class CanBus:
    """Nodes and their clients on one bus; the nodes have one clock."""

    def __init__(self, nodes: Sequence[CanopenNode]) -> None:
        self._nodes = nodes
        self._clock = nodes[0].device.clock
        self._clients: list[Deliver] = []

    def attach(self, deliver: Deliver) -> None:
        """Add a client that gets every frame but its own."""
        self._clients.append(deliver)

    def detach(self, deliver: Deliver) -> None:
        """Remove a client."""
        self._clients.remove(deliver)

    def transmit(self, frame: Frame, origin: Deliver | None, *, remote: bool = False) -> None:
        """A client sends; the others and the nodes hear it, and a node's answers go to all.

        `remote`: it asks for a frame, which is a node's alone.
        """
        for client in self._clients:
            if client is not origin and not remote:
                client(frame)
        self._clock.turn()
        for node in self._nodes:
            self._spread(node.receive(frame.cob_id, frame.data, remote=remote), node)

    def poll(self) -> None:
        """Let the nodes' timers run."""
        for node in self._nodes:
            self._spread(node.poll(), node)

    def _spread(self, frames: list[Frame], sender: CanopenNode) -> None:
        for frame in frames:
            for client in list(self._clients):
                client(frame)
            for node in self._nodes:
                if node is not sender:
                    self._spread(node.receive(frame.cob_id, frame.data), node)


class SlcanPty:
    """The adapter side of an slcan line (Lawicel protocol, 11-bit frames) on a pseudo-terminal."""

    def __init__(self, bus: CanBus) -> None:
        self._bus = bus
        self._master, self._slave, self.path = pseudo_terminal()
        self._buffer = b""
        self._open = False
        self._deliver: Deliver = self._to_client
        bus.attach(self._deliver)
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def _readable(self) -> None:
        try:
            self._buffer += os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return
        *lines, self._buffer = self._buffer.split(b"\r")
        if len(self._buffer) > _LONGEST_LINE:
            self._buffer = b""
        for line in lines:
            self._line(line)

    def _line(self, line: bytes) -> None:
        command = line[:1]
        if command in (b"t", b"r") and self._open:
            remote = command == b"r"
            try:
                length = int(line[4:5])
                data = b"" if remote else bytes.fromhex(line[5 : 5 + 2 * length].decode())
                frame = Frame(int(line[1:4], 16), data)
            except ValueError:
                self._write(b"\a")
                return
            if length > 8 or (len(data) != length and not remote):
                self._write(b"\a")
            else:
                self._bus.transmit(frame, self._deliver, remote=remote)
        elif command in (b"O", b"L"):
            self._open = True
        elif command == b"C":
            self._open = False
        elif command == b"V":
            self._write(b"V0101\r")
        elif command == b"N":
            self._write(b"N0001\r")

    def _to_client(self, frame: Frame) -> None:
        if self._open:
            self._write(b"t%03X%d%s\r" % (frame.cob_id, len(frame.data), frame.data.hex().encode()))

    def _write(self, data: bytes) -> None:
        # a client that does not read overruns its adapter, as with a real one
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def close(self) -> None:
        """Take the adapter away."""
        asyncio.get_running_loop().remove_reader(self._master)
        self._bus.detach(self._deliver)
        os.close(self._master)
        os.close(self._slave)


class SocketcandServer:
    """The socketcand protocol in raw mode, one virtual channel `can0`."""

    def __init__(self, bus: CanBus) -> None:
        self._bus = bus
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self, host: str, port: int) -> int:
        """Listen; return the port."""
        self._server = await asyncio.start_server(self._serve, host, port)
        return int(self._server.sockets[0].getsockname()[1])

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)

        def deliver(frame: Frame) -> None:
            if writer.transport.is_closing():
                return
            if writer.transport.get_write_buffer_size() > _MOST_UNREAD:
                writer.transport.abort()  # it does not read: it hears no more
                return
            stamp = f"{time.time():.6f}"
            writer.write(
                f"< frame {frame.cob_id:03X} {stamp} {frame.data.hex().upper()} >".encode()
            )

        attached = False
        try:
            writer.write(b"< hi >")
            while True:
                text = (await reader.readuntil(b">")).decode("ascii", "replace")
                words = text.strip().strip("<>").split()
                if not words:
                    continue
                if words[0] == "open":
                    writer.write(b"< ok >")
                elif words[0] == "rawmode":
                    writer.write(b"< ok >")
                    if not attached:
                        self._bus.attach(deliver)
                        attached = True
                elif words[0] == "send" and attached:
                    with contextlib.suppress(ValueError, IndexError):
                        length = int(words[2], 16)
                        data = bytes(int(word, 16) for word in words[3 : 3 + length])
                        self._bus.transmit(Frame(int(words[1], 16), data), deliver)
                elif words[0] == "echo":
                    writer.write(b"< echo >")
                await writer.drain()  # what it does not read holds up only itself
                await asyncio.sleep(0)  # however much it says, others have their turn
        except (
            asyncio.IncompleteReadError,
            asyncio.LimitOverrunError,
            asyncio.CancelledError,
            ConnectionError,
        ):
            return  # the client left, talks nonsense, or the server closes
        finally:
            if attached:
                self._bus.detach(deliver)
            self._tasks.discard(task)
            writer.transport.abort()  # whether or not it has read all

    async def close(self) -> None:
        """Stop listening and let the clients go."""
        if self._server is not None:
            self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
