"""Cyclic position targets, joined by straight lines."""

from __future__ import annotations

__all__ = ["SECOND", "Interpolator"]

SECOND = 1_000_000_000  # ns


class Interpolator:
    """The position command between two targets, rad or m.

    `interval` : ns between targets, until it is known
    """

    def __init__(self, interval: int) -> None:
        self.command = 0.0
        self._interval = interval
        self._from = 0.0
        self._step = 0.0  # a ns
        self._arrived_at = 0

    def take(self, target: float, now: int) -> None:
        """A target has come; the interval is that since the one before, if it is one."""
        interval = now - self._arrived_at
        self._arrived_at = now
        if 0 < interval <= SECOND // 5:
            self._interval = interval
        self._from = self.command
        self._step = (target - self.command) / self._interval

    def hold(self, position: float, now: int) -> None:
        """Stay there until the next target."""
        self.command = self._from = position
        self._step = 0.0
        self._arrived_at = now

    def advance(self, target: float, now: int) -> float:
        """Move the command towards `target`; returns its velocity, rad/s or m/s."""
        elapsed = now - self._arrived_at
        if elapsed >= self._interval:
            self.command = target
            return 0.0
        self.command = self._from + self._step * elapsed
        return self._step * SECOND
