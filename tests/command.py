"""The command line as a user types it: in this process, or in one of its own."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from unittest.mock import patch

from commissioning.cli import main

__all__ = ["ROOT", "in_process", "in_this_process", "running"]

ROOT = Path(__file__).parent.parent
Done = subprocess.CompletedProcess[str]


def in_this_process(*arguments: str, environment: dict[str, str] | None = None) -> Done:
    """Run it here, where it costs no start-up; what it leaves open is seen by the leak check."""
    out, errors = io.StringIO(), io.StringIO()
    with (
        Path(os.devnull).open() as nothing,
        patch.dict(os.environ, environment or {}),
        patch.object(sys, "argv", ["tworelay", *arguments]),
        patch.object(sys, "stdin", nothing),
        contextlib.chdir(ROOT),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), errors.getvalue())


def _words(arguments: tuple[str, ...]) -> list[str]:
    return [sys.executable, "-m", "commissioning", *arguments]


def in_process(*arguments: str, environment: dict[str, str] | None = None) -> Done:
    """Run it in a process of its own; returns the finished process with its texts."""
    return subprocess.run(
        _words(arguments), capture_output=True, text=True, cwd=ROOT, timeout=150,
        stdin=subprocess.DEVNULL, env={**os.environ, **(environment or {})}, check=False,
    )  # fmt: skip


@contextlib.contextmanager
def running(*arguments: str) -> Generator[subprocess.Popen[str]]:
    """A command under way, in a process of its own."""
    with subprocess.Popen(
        _words(arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=ROOT, stdin=subprocess.DEVNULL, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()
