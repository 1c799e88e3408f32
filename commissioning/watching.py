"""What a job shows of itself while it goes on. Nothing of it acts on the job."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.sample import Sample
from profiles.procedures import Mode

__all__ = ["NOBODY", "Setting", "Stage", "Telling", "Watcher"]


@dataclass(frozen=True, slots=True)
class Stage:
    """A step of a job, and what it takes as far as one knows, s."""

    name: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Setting:
    """What moves, and within what.

    Attributes
    ----------
    start : position about which it moves, rad or m
    travel : room on either side, rad or m
    torque : N.m or N, either way
    speed : rad/s or m/s
    cycle : s
    in_real_time : a second of motion takes a second
    """

    axis: str
    link: str
    start: float
    travel: float
    torque: float
    speed: float
    position_unit: str
    effort_unit: str
    cycle: float
    in_real_time: bool


class Watcher:
    """Whoever looks on; this one does not."""

    def begins(self, setting: Setting, steps: Sequence[Stage]) -> None:
        """A job is about to move an axis, in these steps, after those that were told before."""

    def step(self, name: str) -> None:
        """A step begins."""

    def lasts(self, seconds: float) -> None:
        """The present step still takes as long."""

    def phase(self, text: str) -> None:
        """What happens within the step."""

    def friction(self, value: float, low: float | None, high: float | None) -> None:
        """Coulomb friction as it is known by now, and its interval; N.m or N."""

    def cycle(self, samples: Sequence[Sample], mode: Mode) -> None:
        """One more sample: all of the experiment, in the order of time, and what is commanded."""


NOBODY = Watcher()


class Telling(Watcher):
    """Says what happens, line by line."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    def phase(self, text: str) -> None:
        """One line."""
        self._tell(text)
