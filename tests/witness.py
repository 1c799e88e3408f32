"""Witnesses of the computer's own lateness.

Whether it kept its promise while a test ran in real time.

Each is a process that only sleeps, and notes how late it is woken: one at the loop's priority, one
at an ordinary one. `python -m tests.witness urgent|ordinary` is one; a line on standard input asks
for its worst lateness since the line before.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from dataclasses import dataclass

from tests.command import ROOT

__all__ = ["Lateness", "Witnesses", "witnesses"]

_NAP = 0.002  # s
_URGENT, _ORDINARY = 0.005, 0.06  # s: a cycle of the tests; a quarter of what a guardian bears


@dataclass(frozen=True, slots=True)
class Lateness:
    """The worst that was seen, s: at the loop's priority, and at an ordinary one."""

    urgent: float
    ordinary: float

    @property
    def too_late(self) -> bool:
        """Whether this is more than a test in real time can bear."""
        return self.urgent > _URGENT or self.ordinary > _ORDINARY

    def __str__(self) -> str:
        return (
            f"this computer was late by {self.urgent * 1000:.0f} ms at real-time priority, by "
            f"{self.ordinary * 1000:.0f} ms at an ordinary one"
        )


class Witnesses:
    """Both witnesses, under way."""

    def __init__(self, urgent: subprocess.Popen[str], ordinary: subprocess.Popen[str]) -> None:
        self._processes = (urgent, ordinary)

    def lateness(self) -> Lateness:
        """Since this was asked before."""
        return Lateness(*(self._ask(process) for process in self._processes))

    @staticmethod
    def _ask(process: subprocess.Popen[str]) -> float:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("\n")
        process.stdin.flush()
        return float(process.stdout.readline())


@contextlib.contextmanager
def witnesses() -> Generator[Witnesses]:
    """Start them; they end with this process."""
    with contextlib.ExitStack() as stack:

        def start(kind: str) -> subprocess.Popen[str]:
            return stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-m", "tests.witness", kind], cwd=ROOT, text=True,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                )
            )  # fmt: skip

        found = Witnesses(start("urgent"), start("ordinary"))
        found.lateness()  # they have begun
        yield found


def _watch() -> None:
    worst, asked = 0.0, threading.Event()

    def listen() -> None:
        for _ in sys.stdin:
            asked.set()
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        due = time.perf_counter() + _NAP
        time.sleep(_NAP)
        worst = max(worst, time.perf_counter() - due)
        if asked.is_set():
            asked.clear()
            print(worst, flush=True)  # noqa: T201
            worst = 0.0


if __name__ == "__main__":
    from drivers.realtime import real_time

    with real_time() if sys.argv[1] == "urgent" else contextlib.nullcontext():
        _watch()
