"""The process that draws the panel: pictures come by standard input, and their end is its own."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from collections import deque
from typing import Any

__all__ = ["main"]

_EVERY = 0.125  # s between two drawings
_SHOWN = 8.0  # s of the trace
_MOST = 4000  # points of it


class Ear:
    """What was told last, and the trace of what was told."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {}
        self.trace: deque[tuple[float, float]] = deque(maxlen=_MOST)
        self.has_ended = threading.Event()

    def listen(self) -> None:
        """Until the end of standard input."""
        with contextlib.suppress(OSError, ValueError):
            for line in sys.stdin.buffer:
                self.hear(line)
        self.has_ended.set()

    def hear(self, line: bytes) -> None:
        """One picture; what is none is passed over."""
        try:
            state = json.loads(line)
        except ValueError:
            return
        if not isinstance(state, dict):
            return
        self.state = state
        for moment, position in state.get("trace", ()):
            if self.trace and moment < self.trace[-1][0]:
                self.trace.clear()
            self.trace.append((moment, position))
        while self.trace and self.trace[-1][0] - self.trace[0][0] > _SHOWN:
            self.trace.popleft()


def main(arguments: list[str]) -> int:
    """Draw until standard input ends; a Ctrl-C is for the job, and reaches nobody here."""
    for name in ("SIGINT", "SIGBREAK", "SIGTSTP"):
        if number := getattr(signal, name, None):
            signal.signal(number, signal.SIG_IGN)
    if sys.platform == "linux":  # however urgent the one is that started this
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    ear = Ear()
    threading.Thread(target=ear.listen, daemon=True).start()
    from rich.console import Console
    from rich.live import Live

    from commissioning.panel.picture import picture

    console = Console(stderr="stderr" in arguments, highlight=False)
    with Live(console=console, screen=True, auto_refresh=False) as live:
        while not ear.has_ended.is_set():
            if ear.state:
                width, height = console.size
                drawn = picture(
                    ear.state, list(ear.trace), width, height, plain=not _is_unicode(console)
                )
                live.update(drawn, refresh=True)
            ear.has_ended.wait(_EVERY if ear.state else 0.02)
    return 0


def _is_unicode(console: Any) -> bool:
    return str(console.encoding).lower().startswith("utf")


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        sys.exit(main(sys.argv[1:]))
    sys.exit(1)
