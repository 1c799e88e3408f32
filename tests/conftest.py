"""Fixtures for every test: an own state folder, served drives, and a check for leaks."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
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
    if _descriptors() - descriptors:
        gc.collect()  # cycles of garbage may hold them
    left = [t.name for t in threading.enumerate() if t not in threads and t.is_alive()]
    assert not left, f"threads left: {left}"
    assert not (more := _descriptors() - descriptors), f"descriptors left: {more}"


@dataclass(frozen=True)
class Home:
    """State that a command left, and what it said."""

    folder: Path
    said: subprocess.CompletedProcess[str]


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


Tworelay = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def tworelay() -> Tworelay:
    """Run the command line in this process; returns its exit code and its texts."""
    return in_this_process


@pytest.fixture(scope="session")
def homes() -> dict[tuple[str, ...], Home]:
    """What commands left, and said, that tests begin with."""
    return {}


@pytest.fixture
def after(
    state_folder: Path, homes: dict[tuple[str, ...], Home], tmp_path_factory: pytest.TempPathFactory
) -> Tworelay:
    """Begin after a command on a virtual:// axis, which is run once a session.

    Returns what it said.
    """

    def begin(*arguments: str) -> subprocess.CompletedProcess[str]:
        if arguments not in homes:
            home = tmp_path_factory.mktemp("home")
            said = in_this_process(*arguments, environment={"TWORELAY_HOME": str(home)})
            homes[arguments] = Home(home, said)
        kept = homes[arguments]
        shutil.copytree(kept.folder, state_folder)
        return kept.said

    return begin
