"""A bus on which another device produces SYNC: it paces the cycle."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Generator

import can
import pytest

from drivers.realtime import real_time as urgent
from tests.command import in_process
from tests.conftest import Serve, Tworelay
from tests.punctual import real_time
from tests.serving import WIRES

PERIOD = 0.01  # s


@contextlib.contextmanager
def sync_producer(link: str) -> Generator[None]:
    """SYNC on the bus of a served drive, by another client of its socketcand server."""
    host, port = link.split("/")[3].split(":")
    bus = can.Bus(interface="socketcand", host=host, port=int(port), channel=link.split("/")[4][:4])
    end = threading.Event()

    def produce() -> None:
        due = time.perf_counter()
        with urgent():
            while not end.wait(max(due - time.perf_counter(), 0.0)):
                bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
                due += PERIOD
                while bus.recv(0) is not None:
                    pass

    thread = threading.Thread(target=produce)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()
        bus.shutdown()


@real_time
def test_another_device_paces_the_experiment(serve: Serve) -> None:
    """In processes of their own: the producer's thread is in this one."""
    link = serve("bench", *WIRES["socketcand"])[0]
    options = ("--travel", "20", "--yes")
    with sync_producer(link):
        refused = in_process("identify", link, "--cycle", str(PERIOD), *options)
        assert refused.returncode == 3
        assert "COB-ID 080h was heard" in refused.stderr
        assert "sync=bus in the link" in refused.stderr

        refused = in_process("identify", f"{link}&sync=bus", "--cycle", "0.004", *options)
        assert refused.returncode == 3
        assert "SYNC comes every 10 ms and the cycle is 4 ms: give --cycle 0.01" in refused.stderr

        done = in_process(
            "identify", f"{link}&sync=bus", "--cycle", str(PERIOD), *options, "--json", "-"
        )
        assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.1)


def test_without_the_producer_nothing_is_moved(serve: Serve, tworelay: Tworelay) -> None:
    link = serve("bench", *WIRES["socketcand"])[0]
    done = tworelay("identify", f"{link}&sync=bus", "--travel", "3", "--yes")
    assert done.returncode == 3
    assert "no SYNC on the bus within 1 s" in done.stderr
    done = tworelay("identify", f"{link}&sync=bus&clock=step", "--travel", "3", "--yes")
    assert done.returncode == 2
    assert "goes without clock=step" in done.stderr
