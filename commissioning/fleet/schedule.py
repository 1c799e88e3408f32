"""Which axis may start: tokens of bus, group, zone and processor, all or nothing, longest first.

Knows no process and no clock: it is asked with what is so, and says what may begin.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

__all__ = ["Rules", "Task", "makespan", "obstacle", "planned", "startable"]


@dataclass(frozen=True, slots=True)
class Task:
    """One axis, and what it takes.

    Attributes
    ----------
    bus, group, zone : '' where there is none to share
    seconds : that it is expected to take
    stepping : its time is simulated, so that nothing has to be punctual
    """

    name: str
    bus: str = ""
    group: str = ""
    zone: str = ""
    after: tuple[str, ...] = ()
    seconds: float = 1.0
    stepping: bool = False


@dataclass(frozen=True, slots=True)
class Rules:
    """How many at once.

    Attributes
    ----------
    punctual : axes in real time
    stepping : axes in simulated time, those in real time counted
    zones : axes of a zone; a zone that is not named has as many as there are
    """

    punctual: int
    stepping: int
    zones: Mapping[str, int] = field(default_factory=dict)


def startable(
    waiting: Iterable[Task],
    running: Collection[Task],
    done: Collection[str],
    rules: Rules,
    *,
    paused: Collection[str] = (),
    late: bool = False,
) -> list[Task]:
    """Those that may start now, beside those that run, in the order in which they should.

    Parameters
    ----------
    done : axes that have ended done, which `after` asks for
    paused : zones in which nothing starts
    late : a job in real time is behind already, so that no other begins
    """
    waiting = list(waiting)
    behind: dict[str, float] = {}
    for task in waiting:
        behind[task.bus or task.name] = behind.get(task.bus or task.name, 0.0) + task.seconds
    order = sorted(waiting, key=lambda task: (-behind[task.bus or task.name], -task.seconds))
    taken = list(running)
    found = []
    for task in order:
        if task.zone in paused or not set(task.after) <= set(done):
            continue
        if late and not task.stepping:
            continue
        if _fits(task, taken, rules):
            taken.append(task)
            found.append(task)
    return found


def obstacle(
    task: Task,
    running: Sequence[Task],
    done: Collection[str],
    *,
    paused: Collection[str] = (),
    late: bool = False,
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
    if late and not task.stepping:
        return "a cycle comes late: nothing starts beside it"
    return "as many are under way as may be" if running else ""


def _fits(task: Task, running: Sequence[Task], rules: Rules) -> bool:
    """Whether every token that a task takes is free."""
    for other in running:
        if task.bus and task.bus == other.bus:
            return False
        if task.group and task.group == other.group:
            return False
    if task.zone:
        in_zone = sum(other.zone == task.zone for other in running)
        if in_zone >= rules.zones.get(task.zone, len(running) + 1):
            return False
    if len(running) >= max(rules.stepping, rules.punctual):
        return False
    return task.stepping or sum(not other.stepping for other in running) < rules.punctual


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
