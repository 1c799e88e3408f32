"""A virtual drive served for many cases."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path

from tests.conftest import ROOT
from tests.faults.proxy import WIRES

__all__ = ["served"]


@contextlib.contextmanager
def served(wire: str, state: Path | None = None) -> Generator[list[str]]:
    """Its links: by Modbus TCP, and on the wire (which may be the same); `state`: its memory."""
    arguments = WIRES["modbus-tcp"].serve
    if wire != "modbus-tcp":
        arguments += WIRES[wire].serve
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "commissioning", "virtual", "serve", "bench", *arguments]
        with subprocess.Popen(
            [*command, "--clock", "step", "--state", str(state or Path(folder) / "drive.json")],
            stdout=subprocess.PIPE, text=True, cwd=ROOT,
        ) as server:  # fmt: skip
            assert server.stdout is not None
            try:
                yield [server.stdout.readline().strip() for _ in range(len(arguments) // 2)]
            finally:
                server.terminate()
