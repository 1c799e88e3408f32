"""How far a job is: its steps, and the time that they still take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from commissioning.watching import Stage

__all__ = ["Course"]

_LATE = 0.1  # of what a step was to take: what is left of one that takes longer, at least


@dataclass(frozen=True, slots=True)
class _Ended:
    """A step that is over: what it was to take, and took, s."""

    thought: float
    took: float


class Course:
    """The steps of a job in their order; times by a clock that the caller reads, s."""

    def __init__(self) -> None:
        self._steps: list[Stage] = []
        self._now = -1
        self._since = 0.0
        self._begin: float | None = None
        self._ended: list[_Ended] = []
        self.in_real_time = True

    def add(self, steps: Sequence[Stage]) -> None:
        """Steps after those that are known; one that is known by its name is only timed anew."""
        known = {step.name: n for n, step in enumerate(self._steps)}
        for step in steps:
            if step.name in known:
                self._steps[known[step.name]] = step
            else:
                self._steps.append(step)

    def step(self, name: str, clock: float) -> None:
        """A step begins, and with it the one before has ended."""
        self._begin = clock if self._begin is None else self._begin
        if self._now >= 0:
            self._ended.append(_Ended(self._steps[self._now].seconds, clock - self._since))
        names = [step.name for step in self._steps]
        if name not in names:
            self._steps.insert(self._now + 1, Stage(name, 0.0))
            names.insert(self._now + 1, name)
        self._now, self._since = names.index(name), clock

    def lasts(self, seconds: float, clock: float) -> None:
        """The present step still takes as long."""
        if self._now >= 0:
            step = self._steps[self._now]
            self._steps[self._now] = Stage(step.name, clock - self._since + seconds)

    @property
    def name(self) -> str:
        """Of the present step; '' before the first."""
        return self._steps[self._now].name if self._now >= 0 else ""

    @property
    def number(self) -> int:
        """Of the present step, from 1; 0 before the first."""
        return self._now + 1

    @property
    def count(self) -> int:
        """How many steps there are."""
        return len(self._steps)

    def took(self, clock: float) -> float:
        """Since the first step began, s."""
        return 0.0 if self._begin is None else clock - self._begin

    def left(self, clock: float) -> float | None:
        """Until all steps are done, s; None where simulated time has shown no pace yet."""
        still = sum(step.seconds for step in self._steps[self._now + 1 :])
        if self._now >= 0:
            seconds = self._steps[self._now].seconds
            still += max(seconds - (clock - self._since) / self._pace(), _LATE * seconds)
        if self.in_real_time:
            return still
        return still * self._pace() if self._ended else None

    def _pace(self) -> float:
        """Seconds that a second of motion takes: of simulated time another number than 1."""
        thought = sum(step.thought for step in self._ended)
        if self.in_real_time or not thought > 0:
            return 1.0
        return max(sum(step.took for step in self._ended) / thought, 1e-3)
