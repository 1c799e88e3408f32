"""What the links sustain: against the bare library, against the clock, and in a scan."""

from __future__ import annotations

import socket
import statistics
import struct
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
from can.interfaces.slcan import slcanBus
from pymodbus.client import ModbusTcpClient

from drivers.link import axis_of, open_drive
from drivers.scan import scan
from profiles.procedures import Mode
from tests.peers import Nodes, gateway

__all__ = ["WIRES", "links", "served"]

HERE = Path(__file__).parent
WIRES = {
    "Modbus TCP": ("--modbus-tcp", "127.0.0.1:0"),
    "Modbus RTU pty": ("--modbus-rtu", "pty"),
    "socketcand": ("--socketcand", "127.0.0.1:0"),
    "slcan pty": ("--slcan", "pty"),
}
_CYCLES = 2000
_BATCH, _BATCHES = 200, 21


@contextmanager
def served(*arguments: str, axis: str = "bench") -> Iterator[str]:
    """LINK to an axis that another process serves."""
    command = [sys.executable, "-m", "commissioning", "virtual", "serve", axis, *arguments]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=HERE.parent)
    assert server.stdout is not None
    try:
        yield server.stdout.readline().strip()
    finally:
        server.terminate()
        server.wait()


def links() -> list[str]:
    """All three tables."""
    return [
        "# What the links sustain",
        "",
        "Written by `make bench`, in one run; the drive is served from another process on this machine.",
        "",
        *_against_the_library(),
        *_against_the_clock(),
        *_scans(),
    ]


# -- against the bare library -----------------------------------------------------------------------


@contextmanager
def _bare_modbus(drive: Any) -> Iterator[Callable[[], None]]:
    """pymodbus' own client and FC 23 with the same registers, on a connection of its own."""
    host, port = _place(drive.link)
    client = ModbusTcpClient(host, port=port, timeout=1.0, retries=0)
    client.connect()  # type: ignore[no-untyped-call]
    assert isinstance(client.socket, socket.socket)
    client.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def exchange() -> None:
        answer = client.readwrite_registers(
            read_address=0x0200, read_count=5, write_address=0x0100, values=[0, 0, 0], device_id=1
        )
        assert len(answer.registers) == 5

    try:
        yield exchange
    finally:
        client.close()  # type: ignore[no-untyped-call]


def _place(link: str) -> tuple[str, int]:
    host, _, port = link.partition("://")[2].partition("?")[0].rpartition(":")
    return host, int(port)


def _raw_socket(link: str) -> Callable[[], None]:
    """The same transaction by thirty lines without a library: a socket, a frame, a receive."""
    stream = socket.create_connection(_place(link))
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    request = struct.pack(">BHHHHBHHH", 23, 0x0200, 5, 0x0100, 3, 6, 0, 0, 0)
    number = 0

    def exchange() -> None:
        nonlocal number
        number = (number + 1) & 0xFFFF
        stream.sendall(struct.pack(">HHHB", number, 0, len(request) + 1, 1) + request)
        answer = b""
        while len(answer) < 19:
            answer += stream.recv(64)
        assert struct.unpack_from(">H", answer)[0] == number
        assert len(struct.unpack_from(">5H", answer, 9)) == 5

    return exchange


@contextmanager
def _bare_can(drive: Any) -> Iterator[Callable[[], None]]:
    """python-can's own send and receive of the same frames; by its own client of a serial adapter."""
    bus = drive._bus._wire._bus
    own = isinstance(bus, slcanBus)
    if own:
        bus = can.Bus(
            interface="slcan", channel=bus.serialPortOrig.port, sleep_after_open=0, timeout=0
        )

    def send(cob_id: int, data: bytes) -> None:
        bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def exchange() -> None:
        send(0x205, bytes(8))
        send(0x080, b"")
        while (message := bus.recv(1.0)) is None or message.arbitration_id != 0x185:
            assert message is not None

    try:
        yield exchange
    finally:
        if own:
            bus.shutdown()


def _rate(exchange: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    for _ in range(_BATCH):
        exchange()
    return _BATCH / (time.perf_counter() - begin)


def _against_the_library() -> list[str]:
    lines = [
        "## Cycles a second, as fast as it goes (`clock=step`)",
        "",
        f"Median of {_BATCHES} batches of {_BATCH} cycles, the driver's and the bare library's in turn on one drive;",
        "the driver's include scaling, the status and the sample.",
        "",
        "Raw socket: the same transaction on a connection of its own, without a library.",
        "",
        "| link | raw socket | bare library | driver | driver / library |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, bare in (
        ("Modbus TCP", _bare_modbus),
        ("socketcand", _bare_can),
        ("slcan pty", _bare_can),
    ):
        rates: list[list[float]] = [[], [], []]
        with served(*WIRES[name], "--clock", "step") as link:
            drive = open_drive(axis_of(link), cycle=0.002)
            with bare(drive) as library:
                drive.enable(Mode.TORQUE)
                raw = _raw_socket(link) if bare is _bare_modbus else None
                for _ in range(_BATCHES):
                    rates[0].append(_rate(library))
                    if raw is not None:
                        rates[2].append(_rate(raw))
                    rates[1].append(_rate(lambda drive=drive: drive.exchange(0.0)))  # type: ignore[misc]
                drive.stop()
                drive.close()
        bare_rate, driver_rate = map(statistics.median, rates[:2])
        raw_rate = f"{statistics.median(rates[2]):.0f}" if rates[2] else "–"
        lines.append(
            f"| {name} | {raw_rate} | {bare_rate:.0f} | {driver_rate:.0f} | {driver_rate / bare_rate:.2f} |"
        )
    return [*lines, ""]


# -- against the clock --------------------------------------------------------------------------------


def _against_the_clock() -> list[str]:
    lines = [
        "## Cycle and lateness in real time",
        "",
        f"{_CYCLES} cycles each. Lateness is against the absolute deadline of the cycle; an overrun is a cycle",
        "that began more than a tenth of the cycle late.",
        "",
        "| link | cycle | achieved | lateness median | p99 | worst | overruns | missed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, arguments in WIRES.items():
        for cycle in (0.001, 0.002, 0.005):
            with served(*arguments) as link:
                drive = open_drive(axis_of(link), cycle=cycle)
                drive.enable(Mode.TORQUE)
                samples = [drive.exchange(0.0) for _ in range(_CYCLES)]
                drive.stop()
                drive.close()
            late = sorted(s.lateness for s in samples)
            achieved = (samples[-1].time - samples[0].time) / (len(samples) - 1)
            overruns = sum(lateness > 0.1 * cycle for lateness in late) / len(late)
            lines.append(
                f"| {name} | {cycle * 1000:g} ms | {achieved * 1000:.3f} ms | "
                f"{late[_CYCLES // 2] * 1000:.3f} ms | {late[_CYCLES * 99 // 100] * 1000:.3f} ms | "
                f"{late[-1] * 1000:.2f} ms | {100 * overruns:.1f} % | {sum(s.missed for s in samples)} |"
            )
    return [*lines, ""]


# -- scans ----------------------------------------------------------------------------------------------


def _scans() -> list[str]:
    lines = [
        "## Scans",
        "",
        "| bus | there | found | missed | time |",
        "| --- | --- | --- | --- | --- |",
    ]
    there = dict.fromkeys(range(3, 248, 6), "data")
    for otherwise, words in (("gateway", "answers for them"), ("silence", "is silent, 0.1 s each")):
        with gateway(there, otherwise) as port:
            begin = time.perf_counter()
            timeout = 0.1 if otherwise == "silence" else None
            found = scan(
                f"modbus-tcp://127.0.0.1:{port}", range(1, 248), timeout, lambda unit: None
            )
            spent = time.perf_counter() - begin
        missed = set(there) - {item.address for item in found}
        lines.append(
            f"| Modbus TCP, 247 units, the gateway {words} | {len(there)} | {len(found)} | "
            f"{len(missed)} | {spent:.2f} s |"
        )
    nodes = set(range(1, 128))
    channel = uuid.uuid4().hex
    peers = Nodes(channel, nodes, set())
    try:
        begin = time.perf_counter()
        drives = scan(f"canopen://virtual/{channel}", range(0), None, lambda unit: None)
        spent = time.perf_counter() - begin
    finally:
        peers.close()
    lost = nodes - {item.address for item in drives}
    lines.append(
        f"| CANopen, 127 nodes | {len(nodes)} | {len(drives)} | {len(lost)} | {spent:.2f} s |"
    )
    return lines
