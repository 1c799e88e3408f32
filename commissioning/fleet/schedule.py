"""Which axis may start: tokens of bus, group, zone and processor, all or nothing, longest first.

Knows no process and no clock: it is asked with what is so, and says what may begin.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

__all__ = ["Rules", "Share", "Task", "makespan", "obstacle", "planned", "startable"]


@dataclass(frozen=True, slots=True)
class Task:
    """One axis, and what it takes.

    Attributes
    ----------
    bus, group, zone : '' where there is none to share
    seconds : that it is expected to take
    stepping : its time is simulated, so that nothing has to be punctual
    computer : that has its bus; '': this one
    """

    name: str
    bus: str = ""
    group: str = ""
    zone: str = ""
    after: tuple[str, ...] = ()
    seconds: float = 1.0
    stepping: bool = False
    computer: str = ""


class Share(NamedTuple):
    """How many at once on one computer.

    Attributes
    ----------
    punctual : axes in real time
    stepping : axes in simulated time, those in real time counted
    """

    punctual: int
    stepping: int

    @property
    def most(self) -> int:
        """Of either."""
        return max(self.punctual, self.stepping)


@dataclass(frozen=True, slots=True)
class Rules:
    """How many at once.

    Attributes
    ----------
    punctual, stepping : on this computer
    computers : on others, by name; most: on all together
    zones : axes of a zone; a zone that is not named has as many as there are
    """

    punctual: int
    stepping: int
    zones: Mapping[str, int] = field(default_factory=dict)
    computers: Mapping[str, Share] = field(default_factory=dict)
    most: int | None = None

    def share(self, computer: str) -> Share:
        """Of one computer."""
        return self.computers.get(computer) or Share(self.punctual, self.stepping)


def startable(
    waiting: Iterable[Task],
    running: Collection[Task],
    done: Collection[str],
    rules: Rules,
    *,
    paused: Collection[str] = (),
    late: Collection[str] = (),
) -> list[Task]:
    """Those that may start now, beside those that run, in the order in which they should.

    Parameters
    ----------
    done : axes that have ended done, which `after` asks for
    paused : zones in which nothing starts
    late : computers on which a job in real time is behind already, so that no other begins
    """
    waiting = list(waiting)
    behind: dict[str, float] = {}
    for task in waiting:
        behind[task.bus or task.name] = behind.get(task.bus or task.name, 0.0) + task.seconds
    order = sorted(waiting, key=lambda task: (-behind[task.bus or task.name], -task.seconds))
    tokens = _Tokens(running, rules)
    known = frozenset(done)
    found = []
    for task in order:
        if task.zone in paused or not known.issuperset(task.after):
            continue
        if task.computer in late and not task.stepping:
            continue
        if tokens.are_free_for(task):
            tokens.take(task)
            found.append(task)
    return found


def obstacle(
    task: Task,
    running: Sequence[Task],
    done: Collection[str],
    *,
    paused: Collection[str] = (),
    late: Collection[str] = (),
) -> str:
    """What a task waits for, in a few words."""
    if task.zone in paused:
        return f"zone '{task.zone}' is paused"
    for name in task.after:
        if name not in done:
            return f"runs after '{name}'"
    for other in running:
        if task.group and task.group == other.group:
            return f"'{other.name}' of its group is under way"
        if task.bus and task.bus == other.bus:
            return f"'{other.name}' has its bus"
    if task.computer in late and not task.stepping:
        return "a cycle comes late: nothing starts beside it"
    return "as many are under way as may be" if running else ""


class _Tokens:
    """What those that run have taken."""

    def __init__(self, running: Iterable[Task], rules: Rules) -> None:
        self._rules = rules
        self._taken: Counter[tuple[str, str]] = Counter()
        for task in running:
            self.take(task)

    def take(self, task: Task) -> None:
        """All that it takes."""
        self._taken.update((("all", ""), ("computer", task.computer)))
        self._taken.update(
            (kind, name)
            for kind, name in (("bus", task.bus), ("group", task.group), ("zone", task.zone))
            if name
        )
        if not task.stepping:
            self._taken["punctual", task.computer] += 1

    def are_free_for(self, task: Task) -> bool:
        """Whether every token that it takes is free."""
        taken, rules = self._taken, self._rules
        if taken["bus", task.bus] or taken["group", task.group]:
            return False
        if task.zone in rules.zones and taken["zone", task.zone] >= rules.zones[task.zone]:
            return False
        if rules.most is not None and taken["all", ""] >= rules.most:
            return False
        share = rules.share(task.computer)
        if taken["computer", task.computer] >= share.most:
            return False
        return task.stepping or taken["punctual", task.computer] < share.punctual


def makespan(waiting: Sequence[Task], running: Mapping[Task, float], rules: Rules) -> float:
    """How long it takes until all have ended, s, as far as durations are as expected.

    `running` : the seconds that each still takes
    """
    begins = planned(waiting, running, rules)
    ends = [begins[task.name] + task.seconds for task in waiting if task.name in begins]
    return max((*ends, *running.values()), default=0.0)


def planned(
    waiting: Sequence[Task], running: Mapping[Task, float], rules: Rules
) -> dict[str, float]:
    """When each begins, s from now, in that order, as far as durations are as expected.

    Whoever runs is taken for done in time; a task whose `after` never comes is not waited for.
    """
    left = list(waiting)
    now, begins = 0.0, {}
    ends = [(seconds, n, task) for n, (task, seconds) in enumerate(running.items())]
    heapq.heapify(ends)
    count = len(ends)
    known = {task.name for task in (*left, *running)}
    done = {name for task in left for name in task.after} - known
    while True:
        for task in startable(left, [task for _, _, task in ends], done, rules):
            left.remove(task)
            begins[task.name] = now
            heapq.heappush(ends, (now + task.seconds, count, task))
            count += 1
        if not ends:
            return begins
        now, _, ended = heapq.heappop(ends)
        done.add(ended.name)
