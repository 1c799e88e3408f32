"""Fixtures for every test: an own state folder, served drives, and a check for leaks."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests import serving
from tests.command import in_this_process
from tests.punctual import Punctual


def pytest_configure(config: pytest.Config) -> None:
    """Tests in real time have a runner of their own."""
    config.pluginmanager.register(Punctual())


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
    with contextlib.ExitStack() as servers:
        count = itertools.count()

        def start(axis: str, *arguments: str, links: int = 1) -> list[str]:
            state = tmp_path / f"drive-{next(count)}.json"
            return servers.enter_context(serving.serve(axis, *arguments, links=links, state=state))

        yield start


@pytest.fixture(params=[*serving.WIRES])
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


@pytest.fixture
def tworelay() -> Tworelay:
    """Run the command line in this process; returns its exit code and its texts."""
    return in_this_process
