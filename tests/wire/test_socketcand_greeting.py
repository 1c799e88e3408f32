"""A socketcand server on a busy bus: frames come together with its greeting."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import can

from drivers.canopen.adapters import open_bus
from drivers.errors import LinkError
from tests.raising import raises

FRAME = b"< frame 085 1795563402.206018 3081110000000000 >"


@contextlib.contextmanager
def server(second: bytes) -> Iterator[int]:
    """Its port; what it says after rawmode is `second`."""
    listener = socket.create_server(("127.0.0.1", 0))
    clients: list[socket.socket] = []

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = listener.accept()
                clients.append(client)
                with contextlib.suppress(OSError):
                    client.sendall(b"< hi >")
                    if client.recv(100).startswith(b"< open"):
                        client.sendall(b"< ok >")
                        client.recv(100)
                        client.sendall(second)
                        client.recv(100)
                        client.sendall(FRAME)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield int(listener.getsockname()[1])
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()
        for client in clients:
            client.close()


def test_a_frame_with_the_greeting_is_received() -> None:
    with server(b"< ok >" + FRAME) as port:
        bus = open_bus("socketcand", f"127.0.0.1:{port}/can0", 500_000, 1.0)
        try:
            bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
            messages = [bus.recv(1.0), bus.recv(1.0)]
        finally:
            bus.shutdown()
    for message in messages:
        assert message is not None
        assert message.arbitration_id == 0x085
        assert message.data == bytes.fromhex("3081110000000000")


def test_a_server_that_refuses_the_channel_is_told() -> None:
    with (
        server(b"< error no such channel >") as port,
        raises(LinkError, "link.adapter"),
    ):
        open_bus("socketcand", f"127.0.0.1:{port}/can0", 500_000, 1.0)
