"""Lines that are typed, without waiting for them: a run goes on while somebody is asked."""

from __future__ import annotations

import contextlib
import os
import select
import sys

__all__ = ["Keyboard"]

_CHUNK = 1024


class Keyboard:
    """Standard input from now on: what was typed before nobody had asked for."""

    def __init__(self) -> None:
        self._typed = b""
        self._forget()

    def line(self) -> str | None:
        """A line with its end; '' when the terminal is gone; None: not typed yet."""
        self._read()
        if b"\n" not in self._typed and not self._is_gone:
            return None
        line, mark, self._typed = self._typed.partition(b"\n")
        return (line + mark).decode("utf-8", "replace")

    _is_gone = False

    if sys.platform == "win32":

        def _forget(self) -> None:
            import msvcrt

            while msvcrt.kbhit():
                msvcrt.getwch()

        def _read(self) -> None:
            import msvcrt

            while msvcrt.kbhit():
                letter = msvcrt.getwche()
                self._typed += b"\n" if letter == "\r" else letter.encode()

    else:

        def _forget(self) -> None:
            import termios

            with contextlib.suppress(OSError, ValueError, termios.error):
                termios.tcflush(0, termios.TCIFLUSH)

        def _read(self) -> None:
            try:
                while select.select([0], [], [], 0)[0]:
                    found = os.read(0, _CHUNK)
                    self._typed += found
                    if not found:
                        self._is_gone = True
                        return
            except (OSError, ValueError):
                self._is_gone = True
