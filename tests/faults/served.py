"""A virtual drive served for many cases."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path

from tests.conftest import ROOT

__all__ = ["served"]


@contextlib.contextmanager
def served(axis: str, *arguments: str) -> Generator[str]:
    """Its link."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "commissioning", "virtual", "serve", axis, *arguments]
        with subprocess.Popen(
            [*command, "--state", str(Path(folder) / "drive.json")],
            stdout=subprocess.PIPE, text=True, cwd=ROOT,
        ) as server:  # fmt: skip
            assert server.stdout is not None
            try:
                yield server.stdout.readline().strip()
            finally:
                server.terminate()
