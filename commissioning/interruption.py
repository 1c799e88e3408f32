"""SIGINT, SIGTERM and SIGHUP: at once while nothing moves, at the next cycle while it does."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from commissioning.errors import Interrupted

__all__ = ["Interruption"]

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_SENDERS = {
    "SIGINT": "the operator", "SIGBREAK": "the operator",
    "SIGHUP": "the terminal, which was closed",
}  # fmt: skip


class Interruption:
    """Signal state of one command.

    Outside `deferred` a signal raises Interrupted where the program is. Inside, it is only
    remembered: the runner looks once a cycle and stops the axis in order. A second signal says that
    the energy must go now.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self.count = 0
        self._told = False
        self._deferred = 0
        self._before: dict[int, Any] = {}
        self.wakes: Callable[[], None] = lambda: None  # whoever waits for something else

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for name in _NAMES:
                number = getattr(signal, name, None)
                if number is not None:
                    self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *exc: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        self.count += 1
        self.wakes()
        if not self._deferred:
            self._told = False  # whoever waits now is to hear it, whatever was told before
            self.check()

    def check(self) -> None:
        """Raise Interrupted if a signal came.

        Once, so that no clean-up hides what the first says.
        """
        if self.signal is not None and not self._told:
            self._told = True
            name = signal.Signals(self.signal).name
            said_by = f"{_SENDERS.get(name, 'the system')} ({name})"
            raise Interrupted(f"interrupted by {name}", self.signal, said_by)

    def hurried(self) -> bool:
        """Whether a second signal came."""
        return self.count >= 2

    @contextmanager
    def deferred(self) -> Generator[None]:
        """While something moves or is being written; a signal that came raises at the end of it."""
        self._deferred += 1
        try:
            yield
        finally:
            self._deferred -= 1
        if not self._deferred:
            self.check()
