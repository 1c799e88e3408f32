"""The bus beneath a drive.

Who else is on it, and how another process stops the drive through it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from drivers.bus import Bus, StopFrames

if TYPE_CHECKING:
    from drivers.serial_port import Stream

__all__ = ["Line"]


class Line:
    """The bus of one drive, without its values."""

    def __init__(self, bus: Bus, frames: Callable[[], StopFrames | None]) -> None:
        self._bus = bus
        self._frames = frames

    def other_master(self) -> str:
        """What another master sent on the same bus, or ''."""
        return self._bus.other_master()

    def stop_frames(self) -> StopFrames | None:
        """What another process writes to our port to stop the drive.

        None: it connects by itself.
        """
        return self._frames()

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on.

        None: through nothing.
        """
        self._bus.speak_through(stream)
