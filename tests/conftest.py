"""Fixtures for every test: an own state folder, served drives, and a check for leaks."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(autouse=True)
def state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """TWORELAY_HOME of this test alone."""
    folder = tmp_path / "home"
    monkeypatch.setenv("TWORELAY_HOME", str(folder))
    monkeypatch.delenv("CI", raising=False)
    return folder


def _descriptors() -> set[str]:
    """Open sockets and pseudo-terminals of this process, where the system tells."""
    folder = Path("/proc/self/fd")
    found = set()
    if folder.exists():
        for entry in folder.iterdir():
            with contextlib.suppress(OSError):
                target = str(entry.readlink())
                if target.startswith("socket:") or "/dev/pts/" in target or "ptmx" in target:
                    found.add(target)
    return found


@pytest.fixture(autouse=True)
def no_leaks() -> Iterator[None]:
    """A test leaves no thread and no socket behind."""
    threads, descriptors = set(threading.enumerate()), _descriptors()
    yield
    gc.collect()
    left = [t.name for t in threading.enumerate() if t not in threads and t.is_alive()]
    assert not left, f"threads left: {left}"
    assert not (more := _descriptors() - descriptors), f"descriptors left: {more}"


Serve = Callable[..., list[str]]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Serve a virtual axis from another process: serve("bench", "--slcan", "pty") → LINKs."""
    servers: list[subprocess.Popen[str]] = []

    def start(axis: str, *arguments: str, links: int = 1) -> list[str]:
        state = tmp_path / f"drive-{len(servers)}.json"
        command = [sys.executable, "-m", "commissioning", "virtual", "serve", axis, *arguments]
        server = subprocess.Popen(
            [*command, "--state", str(state)], stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        servers.append(server)
        assert server.stdout is not None
        found = [server.stdout.readline().strip() for _ in range(links)]
        assert all(found), "the virtual drive did not start"
        return found

    yield start
    for server in servers:
        server.send_signal(signal.SIGTERM)
        try:
            server.wait(10)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
        assert server.stdout is not None
        server.stdout.close()
        assert server.returncode in (143, -signal.SIGKILL), "it ends by its signal, not by a bug"


WIRES = {
    "modbus-tcp": ("--modbus-tcp", "127.0.0.1:0"),
    "modbus-rtu": ("--modbus-rtu", "pty"),
    "modbus-rtu-tcp": ("--modbus-rtu-tcp", "127.0.0.1:0"),
    "socketcand": ("--socketcand", "127.0.0.1:0"),
    "slcan": ("--slcan", "pty"),
}
# tests in real time share one worker: two at once on two cores would disturb each other
real_time = pytest.mark.xdist_group("real time")


@pytest.fixture(params=[*WIRES])
def wire(request: pytest.FixtureRequest) -> str:
    """Each wire that crosses processes."""
    if request.param in ("slcan", "modbus-rtu") and os.name == "nt":
        pytest.skip("no pseudo-terminals on Windows")
    return str(request.param)


@pytest.fixture(params=["modbus-tcp", "socketcand", "slcan"])
def live_wire(request: pytest.FixtureRequest) -> str:
    """The wires that are tried in real time, too."""
    if request.param == "slcan" and os.name == "nt":
        pytest.skip("no pseudo-terminals on Windows")
    return str(request.param)


Tworelay = Callable[..., "subprocess.CompletedProcess[str]"]


def command_line(*arguments: str) -> list[str]:
    """The command as a user types it."""
    return [sys.executable, "-m", "commissioning", *arguments]


@pytest.fixture
def tworelay() -> Tworelay:
    """Run the command line; returns the finished process with its texts."""

    def run(*arguments: str, environment: dict[str, str] | None = None) -> object:
        return subprocess.run(
            command_line(*arguments), capture_output=True, text=True, cwd=ROOT, timeout=150,
            stdin=subprocess.DEVNULL, env={**os.environ, **(environment or {})}, check=False,
        )  # fmt: skip

    return run  # type: ignore[return-value]


@contextlib.contextmanager
def running(*arguments: str) -> Generator[subprocess.Popen[str]]:
    """A command under way."""
    with subprocess.Popen(
        command_line(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=ROOT, stdin=subprocess.DEVNULL, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()
