"""How long a fleet run still takes: by experience, and by those of its jobs that have ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from commissioning.fleet.schedule import Rules, Task, makespan
from commissioning.result.fleet import FleetJob

__all__ = ["TimeLeft", "seconds_of"]

_SECONDS = {  # of one axis: in real time, and in simulated time
    "identify": (13.0, 1.0), "commission": (57.0, 4.0), "verify": (50.0, 3.0),
}  # fmt: skip
# what waits, and what runs, with the seconds that each has taken
Work = Callable[[], tuple[Sequence[Task], Mapping[Task, float]]]
_MORE = 0.2  # of the time that it has taken: what an axis that is late takes still, at least


def seconds_of(job: FleetJob, *, stepping: bool) -> float:
    """That a job on one axis takes, as far as experience goes."""
    return _SECONDS[job][stepping]


class TimeLeft:
    """Durations of one run."""

    def __init__(self, job: FleetJob, rules: Rules, clock: Callable[[], float]) -> None:
        self._job, self._rules, self._clock = job, rules, clock
        self._took = {True: (0, 0.0), False: (0, 0.0)}  # how many, and s in all
        self._left: tuple[float, float] | None = None  # s, and when that was so
        self._work: Work | None = None  # by which it has still to be thought again

    def learn(self, seconds: float, *, stepping: bool) -> None:
        """A job has ended."""
        count, total = self._took[stepping]
        self._took[stepping] = count + 1, total + seconds

    def seconds(self, *, stepping: bool) -> float:
        """That a job takes."""
        count, total = self._took[stepping]
        return total / count if count else seconds_of(self._job, stepping=stepping)

    def renew(self, work: Work) -> None:
        """Think again, once somebody wants to know."""
        self._work = work

    def left(self) -> float | None:
        """Until all is done, s; None: nothing is under way."""
        if self._work is not None:
            waiting, running = self._work()
            self._work = None
            still = {task: max(_MORE * t, task.seconds - t) for task, t in running.items()}
            self._left = makespan(waiting, still, self._rules), self._clock()
        if self._left is None:
            return None
        seconds, since = self._left
        return max(0.0, seconds - (self._clock() - since))

    def over(self) -> None:
        """Nothing is under way any more."""
        self._left = self._work = None
