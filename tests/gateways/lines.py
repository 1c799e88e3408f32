"""Gateways as processes on loopback, and fleet files for them."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from commissioning.fleet.gateway.keys import make
from commissioning.fleet.ledger import Ledger
from tests.command import ROOT

__all__ = ["At", "fleet_file", "keys_in", "until"]


def keys_in(folder: Path, *gateways: str, days: int = 10) -> Path:
    """An authority with certificates for these, and one client."""
    assert list(make(folder, gateways, ("laptop",), days))
    return folder


def until(so: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait for something."""
    end = time.monotonic() + seconds
    while not so():
        assert time.monotonic() < end, "it does not come about"
        time.sleep(0.02)


class At:
    """A computer with a gateway; `fake`: its jobs are, and last so long, s."""

    def __init__(self, folder: Path, name: str, keys: Path, axes: dict[str, str],
                 fake: float | None = None, module: str = "") -> None:  # fmt: skip
        self.name, self.keys, self.fake = name, keys, fake
        self.home, self.axes = folder / f"home-{name}", folder / f"axes-{name}"
        self.axes.mkdir(parents=True)
        self.port = 0
        self.process: subprocess.Popen[str] | None = None
        for axis, text in axes.items():
            (self.axes / f"{axis}.toml").write_text(text, "utf-8")

    def words(self) -> list[str]:
        own = (
            ["-m", "commissioning", "fleet", "gateway"]
            if self.fake is None
            else ["-m", "tests.gateways.fake_gateway", "--lasts", str(self.fake)]
        )
        return [
            sys.executable, *own, "--listen", f"127.0.0.1:{self.port}", "--axes", str(self.axes),
            "--keys", str(self.keys), "--name", self.name,
        ]  # fmt: skip

    def begin(self) -> None:
        """Start it, and wait until it listens."""
        self.process = subprocess.Popen(
            self.words(), cwd=ROOT, text=True, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL,
            stderr=subprocess.STDOUT,
            env={**os.environ, "TWORELAY_HOME": str(self.home), "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], 60)[0], "it does not start"
        line = self.process.stdout.readline()
        found = re.search(r"listens on 127\.0\.0\.1:([0-9]+)", line)
        if found is None:
            self.process.kill()
        assert found, line + self.process.stdout.read()
        self.port = int(found[1])

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self._gone()

    def _gone(self) -> None:
        assert self.process is not None
        self.process.wait(60)
        if self.process.stdout is not None:
            self.process.stdout.close()

    def send(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def end(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
        if self.process is not None:
            self._gone()

    def moving(self) -> bool:
        with Ledger(self.home, reading=True) as ledger:
            return bool(ledger.moving())

    def moves(self) -> list[str]:
        path = self.home / "moves"
        return path.read_text().splitlines() if path.exists() else []

    def let_end(self) -> None:
        """Whatever fake job runs, or will."""
        (self.home / "may-end").touch()

    @contextlib.contextmanager
    def running(self) -> Iterator[At]:
        self.begin()
        try:
            yield self
        finally:
            self.end()


def fleet_file(
    path: Path, gateways: dict[str, At], keys: Path, more: str = "", ports: dict[str, int] | None
    = None,
) -> Path:  # fmt: skip
    """A fleet of all axes of these gateways."""
    parts = ['job = "identify"\nconfirm = "yes"\n']
    for name, at in gateways.items():
        port = (ports or {}).get(name, at.port)
        parts.append(f'[gateways.{name}]\naddress = "tls://127.0.0.1:{port}"\nkeys = "{keys}"\n')
    for name, at in gateways.items():
        parts += [
            f'[[axes]]\nname = "{axis.stem}"\ngateway = "{name}"\n'
            for axis in sorted(at.axes.glob("*.toml"))
        ]
    path.write_text("".join(parts) + more, "utf-8")
    return path
