"""A virtual drive ends when it is told to, whatever its clients do,
and remembers little of what they say."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.command import ROOT

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="no limit of another process' files"
)

_FILES = 64
_MEMORY = 150.0  # MB, three times what it begins with
_SAID = 30_000_000  # bytes that a client says, at most
REQUESTS = {
    "--modbus-tcp": struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0x1000, 100) * 200,
    "--modbus-rtu-tcp": bytes.fromhex("0103100000644121") * 200,
    "--socketcand": b"< open can0 >< rawmode >" + b"< send 605 8 40 0 10 0 0 0 0 0 >" * 200,
}


@contextlib.contextmanager
def served(wire: str, folder: Path) -> Generator[tuple[subprocess.Popen[str], int]]:
    """A served drive that may open few files, and its port; it is told to end, and has to."""
    words = (
        "virtual",
        "serve",
        "bench",
        wire,
        "127.0.0.1:0",
        "--state",
        str(folder / "drive.json"),
    )
    with subprocess.Popen(
        [sys.executable, "-m", "commissioning", *words], cwd=ROOT, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            found = re.search(r"127\.0\.0\.1:(\d+)", process.stdout.readline())
            assert found is not None
            import resource

            resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (_FILES, _FILES))
            yield process, int(found[1])
            process.send_signal(signal.SIGTERM)
            assert process.wait(60) == 143
        finally:
            process.kill()


def memory(process: subprocess.Popen[str]) -> float:
    """MB in use, where the system tells."""
    status = Path(f"/proc/{process.pid}/status")
    if not status.exists():
        return 0.0
    found = re.search(r"VmRSS:\s+(\d+)", status.read_text())
    return int(found[1]) / 1000 if found else 0.0


@pytest.mark.parametrize("wire", REQUESTS)
@pytest.mark.parametrize("kind", ["asks and does not read", "talks nonsense"])
def test_a_client_that_does_not_read_keeps_it_neither_alive_nor_fat(
    wire: str, kind: str, tmp_path: Path
) -> None:
    said = REQUESTS[wire] if kind.startswith("asks") else os.urandom(10_000)
    with (
        served(wire, tmp_path) as (process, port),
        socket.create_connection(("127.0.0.1", port)) as client,
    ):
        client.settimeout(1.0)
        with contextlib.suppress(OSError):  # it listens no more, or has hung up
            for _ in range(0, _SAID, len(said)):
                client.sendall(said)
        assert memory(process) < _MEMORY


@pytest.mark.parametrize("wire", REQUESTS)
def test_connections_beyond_what_is_possible_are_one_line(wire: str, tmp_path: Path) -> None:
    with contextlib.ExitStack() as clients, served(wire, tmp_path) as (process, port):
        for _ in range(_FILES + 20):
            clients.enter_context(socket.create_connection(("127.0.0.1", port)))
        assert process.stderr is not None
        assert "as many open files as it may have" in process.stderr.readline()
        process.send_signal(signal.SIGTERM)
        assert process.stderr.read() == ""


def test_many_listeners_that_do_not_read_are_let_go_without_a_word(tmp_path: Path) -> None:
    """Each frame of one goes to all."""
    with contextlib.ExitStack() as clients, served("--socketcand", tmp_path) as (process, port):
        for _ in range(20):
            one = clients.enter_context(socket.create_connection(("127.0.0.1", port)))
            one.sendall(b"< open can0 >< rawmode >")
        with socket.create_connection(("127.0.0.1", port)) as flood, contextlib.suppress(OSError):
            flood.settimeout(1.0)
            for _ in range(500):
                flood.sendall(REQUESTS["--socketcand"])
        assert memory(process) < _MEMORY
        process.send_signal(signal.SIGTERM)
        assert process.stderr is not None
        assert process.stderr.read() == ""
