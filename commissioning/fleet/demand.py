"""What is asked of a fleet run while it goes on: by signals, by other processes, by a failure."""

from __future__ import annotations

import signal
from collections.abc import Callable
from enum import IntEnum

from commissioning.interruption import Interruption

__all__ = ["Demand", "Level"]

_EVERY = 0.5  # s between looks at what other processes ask for


class Level(IntEnum):
    """How much of a run is to end."""

    GO_ON = 0
    DRAIN = 1  # what runs is finished, nothing more starts
    STOP = 2  # what runs is stopped


_REQUESTS = {"drain": Level.DRAIN, "stop": Level.STOP}


class Demand:
    """The most that was asked for so far, and by whom.

    `request` : what another process asks for, by the ledger; raises JournalError
    """

    def __init__(
        self, interruption: Interruption, request: Callable[[], str], clock: Callable[[], float]
    ) -> None:
        self.level = Level.GO_ON
        self.who = ""
        self._interruption = interruption
        self._request = request
        self._clock = clock
        self._asked = -_EVERY
        self._requested = Level.GO_ON
        self._signals = 0

    def heard(self) -> bool:
        """Whether something new is asked for: more than before, or to stop once more.

        Raises JournalError where the ledger cannot be asked.
        """
        count, number = self._interruption.count, self._interruption.signal
        level, who = Level(min(count, Level.STOP)), "interrupted"
        if number == signal.SIGTERM:
            level, who = Level.STOP, "interrupted by SIGTERM"
        again = count > self._signals and level is self.level is Level.STOP
        self._signals = count
        if self._clock() - self._asked >= _EVERY:
            self._asked = self._clock()
            self._requested = _REQUESTS.get(self._request(), Level.GO_ON)
        if self._requested > level:
            level, who = self._requested, "'tworelay fleet stop'"
        return self.raised(level, who) or again

    def raised(self, level: Level, who: str) -> bool:
        """Ask for as much, at least; whether that is more than before."""
        if level <= self.level:
            return False
        self.level, self.who = level, who
        return True
