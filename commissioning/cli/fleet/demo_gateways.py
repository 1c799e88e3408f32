"""tworelay demo --gateways: twelve axes on three computers, one of which dies in mid-motion."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from pathlib import Path

from commissioning.cli.fleet.demo import called, started
from commissioning.cli.fleet.rehearse import served
from commissioning.cli.terminal import Screen
from commissioning.fleet.ledger import Ledger
from commissioning.interruption import Interruption
from commissioning.processes import start
from drivers.errors import LinkError
from drivers.home import home

__all__ = ["run_demo"]

_GATEWAYS = "pc-a", "pc-b", "pc-c"
_AXES = 4  # of each gateway, on two buses
_PATIENCE = 60.0  # s
_DOWN = 3.0  # s
_ALL = """\
name = "all-the-drives"
job = "commission"
"""
_HEAD = """\
name = "line-9"
job = "commission"
confirm = "group"

[defaults]
travel = 3.0     # rad; the axis files of the gateways are above this
cycle = 0.004    # s

[zones.cell-2]   # one emergency stop, though on two computers
at_once = 3
"""


def _names(gateway: str) -> list[str]:
    return [f"{gateway[-1]}-{n}" for n in range(1, _AXES + 1)]


def _fleet_file(ports: dict[str, int]) -> str:
    parts = [_HEAD]
    for gateway, port in ports.items():
        parts.append(f'[gateways.{gateway}]\naddress = "tls://127.0.0.1:{port}"\n')
    for gateway in ports:
        for name in _names(gateway):
            zone = 'zone = "cell-2"\n' if name in ("a-1", "a-2", "b-1", "b-2") else ""
            parts.append(f'[[axes]]\nname = "{name}"\ngateway = "{gateway}"\n{zone}')
    return "\n".join(parts)


class _Computer:
    """A gateway as a process, with a home of its own."""

    def __init__(self, name: str, folder: Path, keys: Path) -> None:
        self.name, self.home = name, folder / f"home-of-{name}"
        self.axes = folder / f"axes-of-{name}"
        self.axes.mkdir()
        self.keys = keys
        self.port = 0
        self._process: subprocess.Popen[str] | None = None

    def begin(self) -> None:
        """Start it; raises LinkError."""
        self._process = start(
            "commissioning", "fleet", "gateway", "--listen", f"127.0.0.1:{self.port}",
            "--axes", str(self.axes), "--keys", str(self.keys), "--name", self.name,
            env={**os.environ, "TWORELAY_HOME": str(self.home)}, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        found = re.search(r"listens on 127\.0\.0\.1:([0-9]+)", self._process.stdout.readline())
        if found is None:
            raise LinkError(f"gateway '{self.name}' did not start; its own line says why")
        self.port = int(found[1])

    def kill(self) -> None:
        """As by a crash; what it has started goes on."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def end(self) -> None:
        """As by whoever sits there."""
        if self._process is not None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_PATIENCE)

    def moves(self) -> bool:
        """Whether an axis of it is under way."""
        with Ledger(self.home, reading=True) as ledger:
            return bool(ledger.moving())


@contextlib.contextmanager
def _computers(folder: Path, keys: Path, screen: Screen) -> Generator[dict[str, _Computer]]:
    """Three of them, each with the drives of its own buses."""
    drives = folder / "drives.toml"
    names = [name for gateway in _GATEWAYS for name in _names(gateway)]
    links = [
        f"modbus-tcp://10.0.{n // 2}.20?unit={n % 2 + 1}" for n in range(len(names))
    ]  # two drives on each bus
    drives.write_text(
        _ALL + "".join(
            f'[[axes]]\nname = "{name}"\nlink = "{link}"\ntravel = 3.0\n'
            for name, link in zip(names, links, strict=True)
        )
    )  # fmt: skip
    found = {name: _Computer(name, folder, keys) for name in _GATEWAYS}
    with served(drives, len(names)) as at:
        for name, link in zip(names, at, strict=True):
            computer = found[f"pc-{name[0]}"]
            (computer.axes / f"{name}.toml").write_text(f'link = "{link}"\n', "utf-8")
        try:
            for computer in found.values():
                computer.begin()
                screen.say(f"gateway '{computer.name}' at 127.0.0.1:{computer.port}")
            yield found
        finally:
            for computer in found.values():
                computer.end()


def run_demo(screen: Screen) -> int:
    """Keys, gateways, a run that loses one of them, its resumption, the history of all."""
    base = home() / "demo-gateways"
    base.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="line-9-", dir=base))
    keys, path = folder / "keys", folder / "line-9.toml"
    screen.say(f"three computers with four drives each, on loopback; all of it lies in {folder}")
    gateways = [word for name in _GATEWAYS for word in ("--gateway", name)]
    called(screen, "fleet", "keys", str(keys), *gateways, "--client", "laptop")
    screen.say()
    with Interruption(), _computers(folder, keys, screen) as computers:
        ports = {name: computer.port for name, computer in computers.items()}
        path.write_text(_fleet_file(ports), "utf-8")
        called(screen, "fleet", "check", str(path))
        _with_a_crash(screen, path, computers["pc-b"])
        code = called(screen, "fleet", "run", str(path), "--resume", "--yes")
        called(screen, "fleet", "status")
        called(screen, "history")
    return code


def _with_a_crash(screen: Screen, path: Path, victim: _Computer) -> None:
    """A run in which a gateway dies while it moves an axis, and comes back; and a Ctrl-C."""
    with started(screen, "fleet", "run", str(path), "--yes") as process:
        try:
            _wait(process, victim.moves)
            victim.kill()
            screen.say(f"# gateway '{victim.name}' was killed; what it had started goes on there")
            time.sleep(_DOWN / 2)
            screen.say("^C")
            if sys.platform == "win32":
                process.send_signal(signal.CTRL_BREAK_EVENT)
            else:
                process.send_signal(signal.SIGINT)
            time.sleep(_DOWN / 2)
            victim.begin()
            screen.say(f"# gateway '{victim.name}' is back")
            process.wait()
        finally:
            process.terminate()


def _wait(process: subprocess.Popen[str], so: Callable[[], bool]) -> None:
    until = time.monotonic() + _PATIENCE
    while process.poll() is None and not so() and time.monotonic() < until:
        time.sleep(0.02)
