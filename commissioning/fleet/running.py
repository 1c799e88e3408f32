"""A fleet run as a command asks for it: begun, resumed or done again; and the look alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from commissioning.fleet.board import Board
from commissioning.fleet.conductor import Conductor
from commissioning.fleet.confirming import check_in_advance
from commissioning.fleet.crew import Crew
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.looking import Seen, held_back, judged, look_at_all, rules_of, task_of
from commissioning.fleet.pages import folder_of
from commissioning.fleet.people import People
from commissioning.fleet.plan import Fleet
from commissioning.fleet.schedule import makespan, planned
from commissioning.fleet.serials import Pins
from commissioning.fleet.taking_up import (
    again,
    begin,
    chosen,
    none_under_way,
    only_runner,
    resume,
)
from commissioning.fleet.time_left import seconds_of
from commissioning.interruption import Interruption
from commissioning.result.fleet import FleetJob, FleetResult
from drivers.home import home
from profiles.errors import TwoRelayError, UsageError

__all__ = ["FleetWishes", "check", "expected", "run"]


Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class FleetWishes:
    """What is asked of a fleet run, beside its file.

    Attributes
    ----------
    resume : id of a run to be taken up, or 'last'
    again : axes to be done again, or 'failed'
    terminal : somebody can be asked
    job : instead of the file's, or of the run's that is taken up
    """

    only: str | None = None
    at_once: int | None = None
    resume: str | None = None
    again: tuple[str, ...] = ()
    yes: bool = False
    terminal: bool = False
    job: FleetJob | None = None


def run(
    fleet: Fleet,
    wishes: FleetWishes,
    people: People,
    interruption: Interruption,
    opened: Callable[[str], None],
) -> tuple[FleetResult, TwoRelayError | None]:
    """Run a fleet; returns it as it ended, and what ended it early. `opened` gets its id.

    Raises UsageError, Refused, JournalError where nothing was begun.
    """
    names = chosen(fleet, wishes.only)
    _without_gateways(fleet)
    selected = [fleet.axis(name) for name in names]
    in_advance = check_in_advance(fleet, selected, yes=wishes.yes, terminal=wishes.terminal)
    pins = Pins(fleet.path, kept=not fleet.rehearsed)
    with only_runner(fleet), Ledger(home()) as ledger:
        none_under_way(fleet, ledger)
        if wishes.resume is not None or wishes.again:
            record = ledger.record(wishes.resume or "last", fleet.path)
            run_id = record.id
            if wishes.job is None:  # it was begun with
                fleet = replace(fleet, job=record.job)
            if wishes.again:
                names = again(fleet, ledger, run_id, wishes.again, names)
            else:
                names = resume(fleet, ledger, run_id, names)
        else:
            run_id = begin(fleet, ledger, names)
        opened(run_id)
        crew = Crew(folder_of(run_id))
        conductor = Conductor(
            Board(fleet, ledger, run_id), ledger, crew, people, interruption,
            pins=pins, at_once=wishes.at_once, in_advance=in_advance, can_ask=wishes.terminal,
        )  # fmt: skip
        try:
            result = conductor.run(names)
        finally:
            crew.close(lambda: interruption.count)
        return result, conductor.error


def _without_gateways(fleet: Fleet) -> None:
    for one in fleet.axes:
        if one.gateway is not None:
            raise UsageError(
                f"axis '{one.name}' is behind gateway '{one.gateway}', and this version runs what "
                "is on this computer only: run its axes there"
            )


def check(
    fleet: Fleet,
    wishes: FleetWishes,
    tell: Callable[[str, Seen], None],
    interruption: Interruption,
    say: Tell,
    accept: tuple[str, ...] = (),
) -> dict[str, Seen]:
    """Look at the axes; nothing is written or moved.

    `accept` : axes whose drives were exchanged rightfully: what is there now is pinned
    """
    names = chosen(fleet, wishes.only)
    for name in accept:
        fleet.axis(name)
    _without_gateways(fleet)
    pins = Pins(fleet.path)
    folder = home() / "fleets"
    folder.mkdir(parents=True, exist_ok=True)
    crew = Crew(folder)
    try:
        seen = look_at_all(
            fleet, [fleet.axis(name) for name in names], crew,
            rules_of(fleet, wishes.at_once), tell, interruption.check,
        )  # fmt: skip
    finally:
        crew.close(lambda: interruption.count)
    _accept(accept, seen, pins, say)
    said = {one.name: one.serial for one in fleet.axes if one.serial is not None}
    return held_back(fleet, judged(seen, {**pins.known, **said}))


def _accept(names: tuple[str, ...], seen: Mapping[str, Seen], pins: Pins, tell: Tell) -> None:
    """Pin what is there now; raises UsageError where another axis has that drive."""
    new = {}
    for name in names:
        looked = seen[name].looked if name in seen else None
        if looked is None:
            raise UsageError(f"--accept-serial {name}: its drive was not seen")
        new[name] = looked.serial
    after = {**pins.known, **new}
    for name, serial in new.items():
        others = [other for other, its in after.items() if its == serial and other != name]
        if others:
            raise UsageError(
                f"--accept-serial {name}: {serial} is the drive of '{others[0]}': accept both, or "
                "say which is right"
            )
    if not new:
        return
    with Ledger(home()) as ledger:
        for name, serial in new.items():
            before = pins.known.get(name, "none")
            ledger.note("", f"serial accepted: {serial}, was {before}", name)
            tell(f"'{name}': serial {serial} is its drive from now on, was {before}")
    pins.pin(new)


def expected(
    fleet: Fleet, names: tuple[str, ...], at_once: int | None
) -> tuple[dict[str, float], float]:
    """When each of these axes begins, s, in that order; and how long all take, about."""
    tasks = [
        task_of(axis, seconds_of(fleet.job, stepping=axis.is_stepping))
        for axis in map(fleet.axis, names)
    ]
    rules = rules_of(fleet, at_once)
    return planned(tasks, {}, rules), makespan(tasks, {}, rules)
