"""Whatever a peer sends.

It is an answer, or an error in one line, and the next answer is understood.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.adapters import open_bus
from drivers.canopen.wire import CanWire
from drivers.modbus.client import Client
from drivers.modbus.wires import TcpWire
from profiles.errors import TwoRelayError
from tests.fuzz.mutation import fuzzed, mutated

_PATIENCE = 0.001  # s for an answer that is none


class Server:
    """Answers each Modbus TCP request by `answer`.

    Bytes behind the right transaction, or as they are.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.answer = b""
        self.right_transaction = True
        self.connected = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        connection, _ = self._listener.accept()
        self.connected.set()
        with connection, contextlib.suppress(ConnectionResetError):
            while request := connection.recv(300):
                answer = request[:2] + self.answer[2:] if self.right_transaction else self.answer
                connection.sendall(answer)

    def close(self) -> None:
        self._thread.join()
        self._listener.close()


@pytest.fixture(scope="module")
def modbus() -> Iterator[tuple[Server, Client]]:
    server = Server()
    client = Client(TcpWire("127.0.0.1", server.port), 1, 1.0)
    server.connected.wait()  # its socket is the fixture's, not a test's
    yield server, client
    client.close()
    server.close()


ANSWERS = (
    bytes.fromhex("0000 0000 0007 01 03 04 000F 4240"), bytes.fromhex("0000 0000 0003 01 83 02"),
    bytes.fromhex("0000 0000 0005 01 17 02 0001"), bytes.fromhex("0000 0000 0006 01 10 0100 0001"),
    bytes.fromhex("0000 0000 000D 01 2B 0E 01 01 00 00 01 00 02 4142"),
)  # fmt: skip


@given(st.one_of(mutated(*ANSWERS), st.binary(max_size=40)), st.booleans())
@fuzzed
def test_modbus_answers(modbus: tuple[Server, Client], data: bytes, right: bool) -> None:
    server, client = modbus
    server.answer, server.right_transaction = data, right
    with suppress(TwoRelayError):
        client.read(3, 0x0300, 2, _PATIENCE)


class Bus:
    """A CAN adapter that has some frames to say to the next request."""

    def __init__(self) -> None:
        self.frames: list[can.Message] = []
        self._waiting: list[can.Message] = []

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self._waiting, self.frames = self._waiting + self.frames, []

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self._waiting.pop(0) if self._waiting else None

    def shutdown(self) -> None:
        pass


FRAME = st.builds(
    lambda cob_id, data, error: can.Message(
        arbitration_id=cob_id, data=data, is_extended_id=False, is_error_frame=error
    ),
    st.sampled_from((0x585, 0x585, 0x585, 0x586, 0x085, 0x185, 0x705, 0x000, 0x080)),
    st.one_of(
        st.binary(max_size=8),
        st.builds(lambda head, tail: bytes((head,)) + b"\x41\x60\x00" + tail,
                  st.integers(0, 255), st.binary(min_size=4, max_size=4)),
    ),
    st.sampled_from((False, False, False, True)),
)  # fmt: skip


@given(st.lists(FRAME, max_size=6))
@fuzzed
def test_canopen_answers(frames: list[can.Message]) -> None:
    bus = Bus()
    wire = CanWire(bus, 5, _PATIENCE)  # type: ignore[arg-type]
    bus.frames = frames
    with suppress(TwoRelayError):
        wire.upload(0x6041, 0)
    wire.drain()
    answer = bytes.fromhex("4B41600037020000")
    bus.frames = [can.Message(arbitration_id=0x585, data=answer, is_extended_id=False)]
    assert wire.upload(0x6041, 0) == b"\x37\x02"


@pytest.fixture(scope="module")
def slcan() -> Iterator[tuple[int, CanWire]]:
    if sys.platform == "win32":
        pytest.skip("Windows has no pseudo-terminals")
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    wire = CanWire(open_bus("slcan", os.ttyname(slave), 500_000, 1.0), 5, 1.0)
    os.set_blocking(master, False)
    yield master, wire
    wire.close()
    os.close(master)
    os.close(slave)


@given(
    st.one_of(
        mutated(b"t58584B41600037020000\r", b"t1858370210270000190\r"), st.binary(max_size=40)
    )
)
@fuzzed
def test_slcan_lines(slcan: tuple[int, CanWire], data: bytes) -> None:
    master, wire = slcan
    with suppress(BlockingIOError):
        os.read(master, 4096)
    os.write(master, data[:1000] + b"\r" + b"t18581122334455667788\r")
    wire.listen_tpdo(0x185)
    last = bytes.fromhex("1122334455667788")
    found: list[bytes | None] = []
    while last not in found and len(found) < 1000:  # garbage may hold frames of its own
        found.append(wire.take_tpdo(1.0))
    assert last in found
