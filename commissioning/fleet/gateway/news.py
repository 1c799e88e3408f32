"""What the processes of a gateway have said, until a client has heard it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from commissioning.fleet.gateway.messages import News, Piece, Since
from commissioning.fleet.messages import Report

__all__ = ["Newsroom"]

_MOST = 20_000  # pieces that nobody fetches: what matters of them is in the ledger
_AT_ONCE = 500


class Newsroom:
    """Reports by number; of pulses the last of each axis."""

    def __init__(self, life: str, on_news: Callable[[], None]) -> None:
        self._life = life
        self._on_news = on_news
        self._number = 0
        self._pieces: dict[int, tuple[str, Piece]] = {}  # number → fleet run, piece
        self._pulses: dict[tuple[str, str], int] = {}
        self._lock = threading.Lock()

    def add(self, run: str, axis: str, attempt: int, report: Report) -> None:
        """A process has said something."""
        with self._lock:
            if report.kind == "pulse":
                self._pieces.pop(self._pulses.get((run, axis), 0), None)
                self._pulses[run, axis] = self._number + 1
            else:
                self._pulses.pop((run, axis), None)
            self._number += 1
            self._pieces[self._number] = run, Piece(self._number, axis, attempt, report)
            if len(self._pieces) > _MOST:
                del self._pieces[next(iter(self._pieces))]
        self._on_news()

    def since(self, since: Since) -> News:
        """What is new of a fleet run; what came before was heard, and is forgotten."""
        with self._lock:
            if since.life != self._life:
                return News(self._life, self._number)
            heard = [
                number for number, (run, _) in self._pieces.items()
                if run == since.run and number <= since.number
            ]  # fmt: skip
            for number in heard:
                del self._pieces[number]
            found = [piece for run, piece in self._pieces.values() if run == since.run][:_AT_ONCE]
        return News(self._life, found[-1].number if found else since.number, tuple(found))
