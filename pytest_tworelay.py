"""pytest fixtures for a machine builder's CI: tworelay and its virtual drives.

`tworelay_home` · `tworelay` · `virtual_drive` · `virtual_fleet` · `fleet_axis`. They call the
command and import nothing of it, so that a project's own `drivers` or `profiles` are not in its
way. Which command: TWORELAY_COMMAND, else the interpreter that runs pytest where tworelay is
installed beside it, else `tworelay` of the PATH.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

__all__ = ["Done", "FleetAxis", "VirtualDrive", "VirtualFleet"]

_PATIENCE = 60.0  # s, for a drive to be ready
_LONGEST = 900.0  # s, of one command
_WITH_JSON = ("identify", "commission", "apply", "verify", "analyze", "tune")  # --json FILE
_FLEET_JSON = ("run", "rehearse", "report")
_PRINTS_JSON = ("history", "compare")


class TworelayNotFoundError(Exception):
    """There is no command to call."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`tworelay_fleet` in the project's settings."""
    parser.addini("tworelay_fleet", "fleet file whose axes `fleet_axis` is parametrised over")


def pytest_configure(config: pytest.Config) -> None:
    """The marker that names a fleet file."""
    config.addinivalue_line(
        "markers", "fleet(file): fleet file whose axes `fleet_axis` is parametrised over"
    )


# -- the command ----------------------------------------------------------------------------------


def command() -> list[str]:
    """How tworelay is called; raises TworelayNotFoundError."""
    told = os.environ.get("TWORELAY_COMMAND")
    if told:
        return shlex.split(told, posix=os.name != "nt")
    try:
        importlib.metadata.distribution("tworelay")
    except importlib.metadata.PackageNotFoundError:
        found = shutil.which("tworelay")
        if found is None:
            raise TworelayNotFoundError(
                "tworelay is neither installed for this Python nor on the PATH: install it, or set "
                "TWORELAY_COMMAND"
            ) from None
        return [found]
    return [sys.executable, "-P", "-m", "commissioning"]


def _found() -> list[str]:
    """The command; fails the test where there is none."""
    try:
        words = command()
    except TworelayNotFoundError as error:
        pytest.fail(str(error), pytrace=False)
    if not words or shutil.which(words[0]) is None:
        pytest.fail(
            f"TWORELAY_COMMAND: there is no program '{words[0] if words else ''}'", pytrace=False
        )
    return words


def _environment(home: Path) -> dict[str, str]:
    """Of a child: its own home, and no path of the project's, whose folders may be called so."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")
    kept = {key: value for key, value in os.environ.items() if key not in hidden}
    return {**kept, "TWORELAY_HOME": str(home), "PYTHONIOENCODING": "utf-8"}


@dataclass(frozen=True)
class Done:
    """A command that has ended.

    Attributes
    ----------
    result : what it said as JSON; None where it says none
    """

    arguments: Sequence[str]
    returncode: int
    stdout: str
    stderr: str
    result: Any = None

    def check(self, *codes: int) -> Done:
        """Itself, where it ended with one of these exit codes (0 where none is given)."""
        if self.returncode not in (codes or (0,)):
            said = (self.stderr.strip() or self.stdout.strip()).splitlines()[-5:]
            pytest.fail(
                f"tworelay {shlex.join(self.arguments)}: exit code {self.returncode}\n"
                + "\n".join(said),
                pytrace=False,
            )
        return self


@dataclass
class _Tworelay:
    """The command, as the fixture gives it."""

    home: Path
    folder: Path
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def __call__(
        self,
        *arguments: str | os.PathLike[str],
        timeout: float = _LONGEST,
        env: Mapping[str, str] | None = None,
        cwd: str | os.PathLike[str] | None = None,
    ) -> Done:
        words = [os.fspath(word) for word in arguments]
        target = self._json_file(words)
        more = [] if target is None else ["--json", str(target)]
        prints = words[:1] and words[0] in _PRINTS_JSON and "--json" in words
        done = subprocess.run(
            [*_found(), *words, *more], env={**_environment(self.home), **(env or {})},
            stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout, check=False, cwd=cwd,
        )  # fmt: skip
        out, err = (text.decode("utf-8", "replace") for text in (done.stdout, done.stderr))
        text = out if prints else None
        if target is not None and target.exists():
            text = target.read_text("utf-8")
        return Done(tuple(words), done.returncode, out, err, _parsed(text))

    def _json_file(self, words: Sequence[str]) -> Path | None:
        """Where the result is to go; None where the user says it, or there is none."""
        has = words[:1] and words[0] in _WITH_JSON
        has = has or (list(words[:1]) == ["fleet"] and words[1:2] and words[1] in _FLEET_JSON)
        if not has or any(word.split("=")[0] in ("--json", "--help") for word in words):
            return None
        return self.folder / f"result-{next(self._numbers)}.json"


def _parsed(text: str | None) -> Any:
    try:
        return None if not text else json.loads(text)
    except ValueError:
        return None


# -- drives ---------------------------------------------------------------------------------------


@dataclass
class VirtualDrive:
    """A virtual drive that is served.

    Attributes
    ----------
    name : of its axis
    links : LINKs that lead to it, one a wire
    profile : of the drive whose twin it is; for `identify`, where that cannot find it: --profile
    """

    name: str
    links: list[str]
    process: subprocess.Popen[bytes]
    profile: str | None = None

    @property
    def link(self) -> str:
        """Its LINK."""
        return self.links[0]

    def stop(self) -> None:
        """Switch it off, as a lost supply does."""
        _end(self.process)


@dataclass
class VirtualFleet:
    """Twins of all axes of a fleet file that have a bus, on buses like those of the file.

    Attributes
    ----------
    drives : by the name of their axis
    """

    file: Path
    drives: dict[str, VirtualDrive]

    def link(self, axis: str) -> str:
        """LINK to the twin of an axis."""
        return self.drives[axis].link


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
    process.wait()
    for stream in (process.stdout, process.stderr):
        if stream is not None:
            stream.close()


@dataclass
class _Server:
    """Serves drives until the session ends."""

    home: Path
    folder: Path
    running: list[subprocess.Popen[bytes]] = field(default_factory=list)
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def start(self, words: Sequence[str]) -> list[VirtualDrive]:
        number = next(self._numbers)
        ready, log = self.folder / f"ready-{number}.json", self.folder / f"serve-{number}.log"
        with log.open("wb") as said:
            process = subprocess.Popen(
                [*_found(), "virtual", "serve", *words, "--ready", str(ready), "--with-parent"],
                env=_environment(self.home), stdin=subprocess.DEVNULL, stdout=said, stderr=said,
            )  # fmt: skip
        self.running.append(process)
        until = time.monotonic() + _PATIENCE
        while not ready.exists():
            if process.poll() is not None or time.monotonic() > until:
                late = "" if process.poll() is not None else f" not ready in {_PATIENCE:g} s:"
                _end(process)
                text = log.read_text("utf-8", "replace").strip()
                pytest.fail(
                    f"tworelay virtual serve {shlex.join(words)}:{late} {text}", pytrace=False
                )
            time.sleep(0.02)
        told = json.loads(ready.read_text("utf-8"))
        return [VirtualDrive(one["name"], one["links"], process) for one in told]

    def close(self) -> None:
        for process in self.running:
            _end(process)


@pytest.fixture(scope="session")
def tworelay_home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """TWORELAY_HOME of this session, or of this worker of it: runs, journal, memories of drives."""
    return tmp_path_factory.mktemp("tworelay")


@pytest.fixture
def tworelay(tworelay_home: Path, tmp_path: Path) -> Callable[..., Done]:
    """The command: tworelay("identify", link, "--yes") → exit code, texts, and the parsed JSON."""
    return _Tworelay(tworelay_home, tmp_path)


@pytest.fixture(scope="session")
def _server(tworelay_home: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Server]:
    server = _Server(tworelay_home, tmp_path_factory.mktemp("served"))
    yield server
    server.close()


@pytest.fixture(scope="session")
def virtual_drive(_server: _Server) -> Callable[..., VirtualDrive]:
    """Serve a virtual drive until the session ends.

    virtual_drive("bench?coulomb=0.2") : on Modbus TCP, any free port, in simulated time
    virtual_drive("bench", wire="--socketcand", profile="cia402", clock="wall") : otherwise
    virtual_drive(run="20261126-…") : the twin of the axis that a run measured
    """

    def served(
        axis: str | None = None,
        *options: str,
        run: str | None = None,
        wire: str | None = "--modbus-tcp",
        profile: str | None = None,
        clock: str = "step",
    ) -> VirtualDrive:
        if (axis is None) == (run is None):
            raise ValueError("give an axis, or run=")
        words = ["--from", run] if run is not None else [str(axis)]
        if wire is not None:
            words += [wire, "pty" if wire in ("--slcan", "--modbus-rtu") else "127.0.0.1:0"]
        words += ["--profile", profile] if profile is not None else []
        drive = _server.start([*words, "--clock", clock, *options])[0]
        drive.profile = profile
        return drive

    return served


@pytest.fixture(scope="session")
def virtual_fleet(_server: _Server) -> Callable[..., VirtualFleet]:
    """Serve twins of the axes of a fleet file: virtual_fleet("line.toml").link("axis")."""

    def served(file: str | os.PathLike[str], *options: str, clock: str = "step") -> VirtualFleet:
        drives = _server.start([os.fspath(file), "--clock", clock, *options])
        return VirtualFleet(Path(file), {one.name: one for one in drives})

    return served


# -- axes of a fleet file -------------------------------------------------------------------------


@dataclass(frozen=True)
class FleetAxis:
    """One axis of a fleet file.

    Attributes
    ----------
    file : its axis file; None where its keys stand in the fleet file
    fleet : the fleet file
    keys : what the fleet file says of it
    """

    name: str
    file: Path | None
    fleet: Path
    keys: Mapping[str, Any]

    def __str__(self) -> str:
        return self.name


def axes_of(fleet: Path) -> list[FleetAxis]:
    """The axes of a fleet file, in its order; raises ValueError where it is none."""
    try:
        entries = tomllib.loads(fleet.read_text("utf-8"))["axes"]
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(f"{fleet}: cannot be read as a fleet file: {error!r}") from None
    found = []
    for entry in entries:
        pattern = entry.get("file")
        files: list[Path | None] = [None]
        if pattern is not None:
            there = sorted(fleet.parent.glob(pattern)) or [fleet.parent / pattern]
            files = list(there)
        found += [FleetAxis(_name(entry, file), file, fleet, entry) for file in files]
    return found


def _name(entry: Mapping[str, Any], file: Path | None) -> str:
    if "name" in entry or file is None:
        return str(entry.get("name", "axis"))
    try:
        return str(tomllib.loads(file.read_text("utf-8")).get("name", file.stem))
    except (OSError, ValueError):  # tworelay itself says what is wrong with it
        return file.stem


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test of `fleet_axis` runs once an axis."""
    if "fleet_axis" not in metafunc.fixturenames:
        return
    marker = metafunc.definition.get_closest_marker("fleet")
    named = marker.args[0] if marker else metafunc.config.getini("tworelay_fleet")
    if not named:
        raise pytest.UsageError(
            "fleet_axis: which fleet file? Mark the test with @pytest.mark.fleet('line.toml'), or "
            "set tworelay_fleet in the project's pytest settings"
        )
    beside = metafunc.definition.path.parent / named
    file = beside if beside.exists() else metafunc.config.rootpath / named
    try:
        axes = axes_of(file)
    except ValueError as error:
        raise pytest.UsageError(str(error)) from None
    metafunc.parametrize("fleet_axis", axes, ids=[one.name for one in axes])
