"""The one clock of the drivers: absolute deadlines in real time, or counted cycles.

A real link is paced by `WallPace`. A served drive that steps is paced by `StepPace`: time is the
number of cycles, and nothing sleeps.
"""

from __future__ import annotations

import time
from typing import Protocol

__all__ = ["Pace", "Silence", "StepPace", "WallPace"]

_SPIN = 0.0004  # s before a deadline in which the thread spins: sleep wakes up that late


class Pace(Protocol):
    """What a bus asks of its clock."""

    cycle: float
    stepping: bool

    def now(self) -> float:
        """Time, s."""

    def next_deadline(self) -> float:
        """Wait for the next deadline and return how late it is met, s."""

    def pass_time(self, seconds: float) -> None:
        """Let time pass, and begin a new grid of deadlines."""


class WallPace:
    """Deadlines on a fixed grid of real time; a missed deadline is skipped, never caught up."""

    stepping = False

    def __init__(self, cycle: float) -> None:
        self.cycle = cycle
        self._deadline: float | None = None

    def now(self) -> float:
        """Time since the machine started, s."""
        return time.perf_counter()

    def next_deadline(self) -> float:
        """Sleep, then spin, until the next deadline; return the lateness in s."""
        now = time.perf_counter()
        if self._deadline is None:
            self._deadline = now
            return 0.0
        self._deadline += self.cycle
        if now > self._deadline:
            lateness = now - self._deadline
            self._deadline += self.cycle * (lateness // self.cycle)
            return lateness
        left = self._deadline - now
        if left > _SPIN:
            time.sleep(left - _SPIN)
        while (now := time.perf_counter()) < self._deadline:
            pass
        return now - self._deadline

    def pass_time(self, seconds: float) -> None:
        """Sleep; the next deadline begins a new grid."""
        time.sleep(seconds)
        self._deadline = None


class Silence:
    """The pause that a line wants between frames, in real time."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._free = 0.0

    def keep(self) -> None:
        """Wait until the line may be spoken on."""
        left = self._free - time.perf_counter()
        if left > _SPIN:
            time.sleep(left - _SPIN)
        while time.perf_counter() < self._free:
            pass

    def begin(self) -> None:
        """The line was heard, or spoken on, until now."""
        self._free = time.perf_counter() + self._seconds


class StepPace:
    """Time as a count of cycles."""

    stepping = True

    def __init__(self, cycle: float) -> None:
        self.cycle = cycle
        self._cycles = 0
        self._passed = 0.0

    def now(self) -> float:
        """Simulated time, s."""
        return self._cycles * self.cycle + self._passed

    def next_deadline(self) -> float:
        """One cycle has passed."""
        self._cycles += 1
        return 0.0

    def pass_time(self, seconds: float) -> None:
        """Count the time that the drive was told to let pass."""
        self._passed += seconds
