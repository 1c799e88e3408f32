"""A position counter that wraps: raw values as they come, without their jumps."""

from __future__ import annotations

__all__ = ["Counter"]


class Counter:
    """Follows a counter of `low`…`high`, both included, from one value to the next nearest.

    Between two values it must not turn by half of its width.
    """

    def __init__(self, low: int, high: int) -> None:
        self._width = high - low + 1
        self._half = self._width // 2
        self._last: int | None = None
        self.offset = 0  # of what `follow` has returned last to what the drive calls it

    def follow(self, raw: int) -> int:
        """The next value, whole widths added; the first is as it comes."""
        last = self._last
        if last is not None:
            turned = raw - last
            if turned > self._half:
                self.offset -= self._width
            elif turned < -self._half:
                self.offset += self._width
        self._last = raw
        return raw + self.offset
