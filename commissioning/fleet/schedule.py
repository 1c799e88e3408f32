"""Which axis may start: tokens of bus, group, zone and processor, all or nothing, longest first.

Knows no process and no clock: it is asked with what is so, and says what may begin.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

__all__ = ["Rules", "Share", "Task", "makespan", "obstacle", "planned", "startable"]

_MANY = 60  # tasks


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
    known, full = frozenset(done), set()
    found = []
    for task in order:
        if task.computer in full or task.zone in paused or not known.issuperset(task.after):
            continue
        if tokens.has_no_room_on(task.computer):
            full.add(task.computer)
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
        share = rules.share(task.computer)
        return task.stepping or taken["punctual", task.computer] < share.punctual

    def has_no_room_on(self, computer: str) -> bool:
        """Whether as many are under way there as may be, or everywhere."""
        most = self._rules.most
        if most is not None and self._taken["all", ""] >= most:
            return True
        return self._taken["computer", computer] >= self._rules.share(computer).most


def makespan(waiting: Sequence[Task], running: Mapping[Task, float], rules: Rules) -> float:
    """How long it takes until all have ended, s, as far as durations are as expected.

    Of many the greatest of what each token alone takes, which is a little less.

    `running` : the seconds that each still takes
    """
    if len(waiting) > _MANY:
        return _bound(waiting, running, rules)
    begins = planned(waiting, running, rules)
    ends = [begins[task.name] + task.seconds for task in waiting if task.name in begins]
    return max((*ends, *running.values()), default=0.0)


def _bound(waiting: Iterable[Task], running: Mapping[Task, float], rules: Rules) -> float:
    """What the token that has most to do takes, s."""
    rows: Counter[tuple[str, str]] = Counter()
    of_row: dict[tuple[str, str], float] = {}  # how many at once
    every = [*((task, task.seconds) for task in waiting), *running.items()]
    for task, seconds in every:
        share = rules.share(task.computer)
        kinds = {
            ("bus", task.bus or task.name): 1.0, ("group", task.group or task.name): 1.0,
            ("zone", task.zone or task.name): rules.zones.get(task.zone, inf),
            ("all", ""): rules.most or inf, ("computer", task.computer): share.most,
            ("stepping" if task.stepping else "punctual", task.computer): inf if task.stepping
            else share.punctual,
        }  # fmt: skip
        of_row.update(kinds)
        for kind in kinds:
            rows[kind] += seconds  # type: ignore[assignment]
    return max((seconds / of_row[kind] for kind, seconds in rows.items()), default=0.0)


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
