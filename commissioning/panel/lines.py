"""How far a job is, in a line a step: for pipes, files and terminals that draw nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from commissioning.panel.course import Course
from commissioning.result.words import remaining
from commissioning.watching import Setting, Stage, Watcher

__all__ = ["Lines"]


class Lines(Watcher):
    """Says each step, by number and name.

    Parameters
    ----------
    detailed : and what happens within it
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        *,
        detailed: bool,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tell = tell
        self._detailed = detailed
        self._clock = clock
        self._course = Course()

    def begins(self, setting: Setting, steps: Sequence[Stage]) -> None:
        """Note the steps."""
        self._course.in_real_time = setting.in_real_time
        self._course.add(steps)

    def step(self, name: str) -> None:
        """One line."""
        course, now = self._course, self._clock()
        course.step(name, now)
        left = course.left(now)
        when = f", about {remaining(left)} left" if course.in_real_time and left else ""
        self._tell(f"step {course.number} of {course.count}: {name}{when}")

    def lasts(self, seconds: float) -> None:
        """The present step still takes as long."""
        self._course.lasts(seconds, self._clock())

    def phase(self, text: str) -> None:
        """One line, where that is asked for."""
        if self._detailed:
            self._tell(f"  {text}")
