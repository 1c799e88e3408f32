"""A Modbus TCP gateway that breaks one transaction, in one of the ways in which transactions break."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from enum import StrEnum

__all__ = ["Proxy", "Way"]


class Way(StrEnum):
    """What happens to the transaction, or from then on."""

    LOST_REQUEST = "request lost"
    LOST_ANSWER = "answer lost"
    LATE = "answer with the next one's"
    TWICE = "answer twice"
    TRUNCATED = "answer truncated"
    CORRUPTED = "function code of the answer changed"
    RESET = "connection reset"
    SILENT = "silent for ever"


class Proxy:
    """One client at a time, request by request; counts them, and breaks number `at` (from 0)."""

    def __init__(self, port: int, at: int | None = None, way: Way = Way.LOST_ANSWER) -> None:
        self._server = port
        self._at, self._way = at, way
        self.count = 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._closing = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End, whatever the client does."""
        self._closing = True
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", self.port)).close()
        self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        while not self._closing:
            client, _ = self._listener.accept()
            with client, contextlib.suppress(OSError):
                client.settimeout(30)
                self._serve(client)

    def _serve(self, client: socket.socket) -> None:
        with socket.create_connection(("127.0.0.1", self._server)) as drive:
            kept = b""
            while not self._closing:
                request = _frame(client)
                number, self.count = self.count, self.count + 1
                broken = self._at is not None and number >= self._at
                if broken and (number == self._at or self._way is Way.SILENT):
                    kept = self._broken(client, drive, request)
                    continue
                drive.sendall(request)
                client.sendall(kept + _frame(drive))
                kept = b""

    def _broken(self, client: socket.socket, drive: socket.socket, request: bytes) -> bytes:
        """Break one; return what is to come with the next answer."""
        way = self._way
        if way in (Way.LOST_REQUEST, Way.SILENT):
            return b""
        if way is Way.RESET:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()
            raise OSError
        drive.sendall(request)
        answer = _frame(drive)
        if way is Way.LATE:
            return answer
        if way is Way.TWICE:
            client.sendall(answer + answer)
        elif way is Way.TRUNCATED:
            client.sendall(answer[: len(answer) - 2])
        elif way is Way.CORRUPTED:
            client.sendall(answer[:7] + bytes((answer[7] ^ 0x20,)) + answer[8:])
        return b""


def _frame(stream: socket.socket) -> bytes:
    """One frame of Modbus TCP; raises OSError at the end."""
    head = _bytes(stream, 6)
    return head + _bytes(stream, int.from_bytes(head[4:6]))


def _bytes(stream: socket.socket, count: int) -> bytes:
    found = b""
    while len(found) < count:
        more = stream.recv(count - len(found))
        if not more:
            raise OSError
        found += more
    return found
