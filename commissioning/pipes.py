"""Pipes to a process of ours that make nobody wait."""

from __future__ import annotations

import os
import queue
import sys
import threading
from typing import Protocol

__all__ = ["Pipe", "never_waiting"]

_ENDING = 2.0  # s


class Pipe(Protocol):
    """A pipe that makes nobody wait."""

    def write(self, word: bytes) -> None:
        """Raises BlockingIOError where the pipe is full, another OSError where nobody reads."""

    def end(self) -> None:
        """What was written last has left."""


def never_waiting(descriptor: int, last: bytes, most: int = 65536) -> Pipe:
    """A pipe to write to.

    `last` : the word after which no other comes. `most`: words that may wait for a reader, where
    the system does not say how many do
    """
    if sys.platform == "win32" and sys.version_info < (3, 12):
        return _Background(descriptor, last, most)
    return _Direct(descriptor)


class _Direct:
    """A pipe that was told not to wait."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        if sys.platform != "win32" or sys.version_info >= (3, 12):
            os.set_blocking(descriptor, False)

    def write(self, word: bytes) -> None:
        os.write(self._descriptor, word)

    def end(self) -> None:
        """It has left at once, or never will."""


class _Background:
    """A pipe that cannot be told not to wait, written to from a thread of its own."""

    def __init__(self, descriptor: int, last: bytes, most: int = 65536) -> None:
        self._descriptor = descriptor
        self._last, self._most = last, most
        self._words: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._is_broken = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def write(self, word: bytes) -> None:
        """One word more; raises BrokenPipeError once nobody reads."""
        if self._is_broken:
            raise BrokenPipeError
        if self._words.qsize() >= self._most and word != self._last:
            raise BlockingIOError
        self._words.put(word)

    def end(self) -> None:
        """Wait for what was written last, within reason."""
        self._thread.join(_ENDING)

    def _run(self) -> None:
        word = b""
        while word != self._last:
            word = self._words.get()
            try:
                os.write(self._descriptor, word)
            except OSError:
                self._is_broken = True
                return
