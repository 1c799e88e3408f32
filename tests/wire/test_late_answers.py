"""Answers that come late on a line are not taken for the next one's: by their pairs, read by read.

TWORELAY_READS=10000 python -m pytest tests/wire/test_late_answers.py -s
"""

from __future__ import annotations

import contextlib
import os
import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.errors import NoAnswer
from drivers.modbus.client import Client
from drivers.modbus.wires import TcpWire
from drivers.virtual.modbus_framing import crc

READS = int(os.environ.get("TWORELAY_READS", "400"))
PATIENCE = 0.003  # s


@contextmanager
def slave(delays: Iterator[float]) -> Iterator[int]:
    """RTU frames over TCP: each register reads as its own address, after some time."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection, contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while request := connection.recv(8):
                time.sleep(next(delays))
                start, count = (int.from_bytes(request[at : at + 2], "big") for at in (2, 4))
                words = b"".join((start + n).to_bytes(2, "big") for n in range(count))
                head = bytes((1, 3, len(words))) + words
                connection.sendall(head + crc(head).to_bytes(2, "little"))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        thread.join()
        listener.close()


@pytest.mark.parametrize("in_cycle", [False, True])
def test_no_late_answer_is_taken_for_another_register_s(in_cycle: bool) -> None:
    draw = random.Random(4)

    def delays() -> Iterator[float]:
        while True:
            yield draw.uniform(0.0, 2 * PATIENCE)

    wrong = missed = 0
    with slave(delays()) as port:
        client = Client(TcpWire("127.0.0.1", port, rtu=True), 1, PATIENCE, longest_answer=1.0)
        for n in range(READS):
            register, count = draw.randrange(1000), 1 + n % 2
            try:
                words = client.read(3, register, count, PATIENCE, in_cycle=in_cycle)
            except NoAnswer:
                missed += 1
            else:
                wrong += words != [register + k for k in range(count)]
        client.close()
    print(f"{READS} reads, {missed} missed, {wrong} wrong")  # noqa: T201
    assert wrong == 0
    assert missed > 0


def test_an_answer_later_than_all_patience_is_known_by_its_length() -> None:
    """After `longest_answer` nothing more is expected: the next read is one of another length."""
    delays = iter([0.0, 0.3, *[0.0] * 100])
    with slave(delays) as port:
        client = Client(TcpWire("127.0.0.1", port, rtu=True), 1, 1.0, longest_answer=0.02)
        assert client.read(3, 10, 2, 1.0) == [10, 11]
        with pytest.raises(NoAnswer):
            client.read(3, 20, 2, 0.02)
        found = []
        for register in (30, 40, 50):
            with contextlib.suppress(NoAnswer):
                found.append((register, client.read(3, register, 2, 1.0)))
        assert found
        assert all(words == [register, register + 1] for register, words in found)
        client.close()


def test_on_tcp_nothing_is_owed_for_answers_have_numbers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = Client(TcpWire("127.0.0.1", listener.getsockname()[1]), 1, 0.02)
        connection, _ = listener.accept()
        with connection, pytest.raises(NoAnswer):
            client.read(3, 0, 1)
        assert not client.owes
        client.close()
