"""The look at all axes before anything moves: which drives are there, and may they be moved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from commissioning.ending import error_of
from commissioning.fleet.crew import Crew
from commissioning.fleet.messages import Looked, Order
from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.fleet.schedule import Rules, Share, Task, startable
from commissioning.fleet.serials import Pins, misplaced
from commissioning.journal import Journal
from commissioning.processes import processors
from commissioning.result.endings import Error
from commissioning.result.fleet import Confirmed, JobState
from drivers.places import same_place
from profiles.identity import NO_SERIAL

__all__ = [
    "Seen",
    "cut_off",
    "held_back",
    "judged",
    "look_and_pin",
    "look_at_all",
    "rules_of",
    "task_of",
]

_WAIT = 0.1  # s
_BLOCKED = "run.cut-off", "run.in-progress"  # an unfinished journal
_OF_EXIT_CODE = {4: JobState.LINK, 7: JobState.WRITE_INCOMPLETE, 1: JobState.UNKNOWN}


@dataclass(frozen=True, slots=True)
class Seen:
    """What the look at one axis came to: what it has shown, or why it must not be moved."""

    looked: Looked | None = None
    error: Error | None = None
    state: JobState = JobState.WAITING


def rules_of(fleet: Fleet, at_once: int | None) -> Rules:
    """How many at once on each computer: all its processors, but for one in real time."""
    cores = processors()
    zones = {name: zone.at_once for name, zone in fleet.zones.items() if zone.at_once is not None}
    others = {name: Share(max(1, its - 1), its) for name, its in fleet.cores.items()}
    return Rules(at_once or max(1, cores - 1), at_once or cores, zones, others, at_once)


def task_of(axis: PlannedAxis, seconds: float) -> Task:
    """An axis as the schedule sees it."""
    return Task(
        axis.name, axis.bus, axis.group or "", axis.zone or "", axis.after, seconds,
        axis.is_stepping, axis.gateway or "",
    )  # fmt: skip


def order_of(
    fleet: Fleet,
    axis: PlannedAxis,
    act: Literal["look", "job"],
    run: str,
    attempt: int,
    looked: Looked | None = None,
    confirmed: Confirmed | None = None,
) -> Order:
    """What a worker gets to hear of an axis; of one that is to move what was seen and confirmed."""
    assert axis.axis is not None
    said = axis.axis.as_said() if axis.gateway else axis.axis.model_dump_json()
    options, room = axis.options, None
    if looked is not None:
        options, room = replace(options, serial=looked.serial), looked.room
    return Order(
        act, run, axis.name, attempt, fleet.job, said, options, room, axis.gateway or "", confirmed
    )


def look_at_all(
    fleet: Fleet,
    axes: Iterable[PlannedAxis],
    crew: Crew,
    rules: Rules,
    tell: Callable[[str, Seen], None],
    check: Callable[[], None],
) -> dict[str, Seen]:
    """Look at each axis, those on one bus one after the other.

    `tell` gets each as it comes; `check` raises where it is to end.
    """
    seen: dict[str, Seen] = {}

    def take(name: str, found: Seen) -> None:
        seen[name] = found
        tell(name, found)

    waiting: dict[str, tuple[Task, PlannedAxis]] = {}
    for axis in axes:
        if axis.broken is not None:
            take(axis.name, _seen(None, error_of(axis.broken), axis.broken.exit_code))
        else:
            # groups and zones are for motion: a look needs the bus alone
            task = Task(axis.name, axis.bus, stepping=axis.is_stepping, computer=axis.gateway or "")
            waiting[axis.name] = (task, axis)
    running: dict[str, Task] = {}
    while waiting or running:
        check()
        tasks = [task for task, _ in waiting.values()]
        for task in startable(tasks, list(running.values()), (), rules):
            _, axis = waiting.pop(task.name)
            running[task.name] = task
            crew.order(order_of(fleet, axis, "look", "", 0), anew=False)
        heard = crew.hear(_WAIT)
        while heard is not None:
            worker, report = heard
            name = worker.busy
            if report is None:
                crew.buried(worker)
                if name in running:
                    del running[name]
                    take(name, _lost())
            elif report.kind in ("looked", "ended") and name in running:
                del running[name]
                crew.take_back(worker)
                take(name, _seen(report.looked, report.error, report.exit_code))
            heard = crew.hear(0.0)
    return seen


def _lost() -> Seen:
    text = "the process that looked at it ended without a word: its log says why"
    return Seen(error=Error("internal", text), state=JobState.REFUSED)


def _seen(looked: Looked | None, error: Error | None, exit_code: int) -> Seen:
    if error is None:
        return Seen(looked)
    if error.code in _BLOCKED:
        return Seen(error=error, state=JobState.BLOCKED)
    return Seen(error=error, state=_OF_EXIT_CODE.get(exit_code, JobState.REFUSED))


def look_and_pin(
    fleet: Fleet,
    axes: Sequence[PlannedAxis],
    crew: Crew,
    rules: Rules,
    pins: Pins,
    tell: Callable[[str, Seen], None],
    check: Callable[[], None],
) -> dict[str, Seen]:
    """Look at each, hold each drive to its axis, and pin those that are new."""
    seen = look_at_all(fleet, axes, crew, rules, tell, check)
    said = {one.name: one.serial for one in fleet.axes if one.serial is not None}
    pinned = {**pins.known, **said}
    found = judged(seen, pinned)
    new = {
        name: one.looked.serial
        for name, one in found.items()
        if one.error is None and one.looked and name not in pinned
    }
    pins.pin({name: serial for name, serial in new.items() if serial not in NO_SERIAL})
    return found


def cut_off(fleet: Fleet, pinned: Mapping[str, str], journal: Journal) -> dict[str, str]:
    """Axes in a group on whose drive a run was cut off, asked for or not, and which run that is.

    By the serial number, where it is known, and by the link.
    """
    found = {}
    for one in fleet.axes:
        if one.far is not None and one.group and one.far.cut_off:
            found[one.name] = one.far.cut_off
        if one.group is None or not one.link or one.gateway is not None:
            continue
        here = partial(same_place, one.link)
        runs = journal.unfinished_on(here)
        if (serial := pinned.get(one.name)) is not None:
            runs += journal.unfinished(serial, here)
        if runs:
            found[one.name] = runs[0]
    return found


def held_back(fleet: Fleet, seen: Mapping[str, Seen]) -> dict[str, Seen]:
    """What was seen, with the groups blocked that a run would block for it."""
    why: dict[str, str] = {}
    for name, one in seen.items():
        group = fleet.axis(name).group
        if group and one.error is not None and fleet.groups[group].on_failure == "stop-group":
            why.setdefault(group, f"'{name}' of its group '{group}' is {one.state}")
    blocked = {
        name: Seen(one.looked, Error("group.blocked", why[group]), JobState.BLOCKED)
        for name, one in seen.items()
        if one.error is None and (group := fleet.axis(name).group) in why
    }
    return {**seen, **blocked}


def judged(seen: Mapping[str, Seen], pinned: Mapping[str, str]) -> dict[str, Seen]:
    """What was seen, with each drive held to the axis that it belongs to."""
    found = {name: one.looked.serial for name, one in seen.items() if one.looked is not None}
    wrong = misplaced(found, pinned)
    return {
        name: Seen(one.looked, error_of(wrong[name]), JobState.REFUSED) if name in wrong else one
        for name, one in seen.items()
    }
