"""A fleet run as a command asks for it: begun, resumed or done again; and the look alone."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace

from commissioning.fleet.board import Board
from commissioning.fleet.conductor import Conductor
from commissioning.fleet.confirming import check_in_advance
from commissioning.fleet.crew import Crew
from commissioning.fleet.gateway.gateways import Gateways, gateways_by, gateways_of
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.looking import Seen, held_back, judged, look_at_all, rules_of, task_of
from commissioning.fleet.pages import folder_of
from commissioning.fleet.people import People
from commissioning.fleet.plan import Fleet
from commissioning.fleet.rows import FleetRecord
from commissioning.fleet.schedule import makespan, planned
from commissioning.fleet.serials import Pins
from commissioning.fleet.settling import fetch
from commissioning.fleet.taking_up import (
    again,
    begin,
    chosen,
    fetch_left,
    none_under_way,
    not_fetched,
    only_runner,
    resume,
)
from commissioning.fleet.time_left import seconds_of
from commissioning.interruption import Interruption
from commissioning.result.fleet import FleetJob, FleetResult
from drivers.home import home
from profiles.errors import TwoRelayError, UsageError

__all__ = ["FleetWishes", "check", "expected", "met", "reach", "run"]


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
    with met(fleet, people.tell) as (known, gateways):
        selected = [known.axis(name) for name in names]
        in_advance = check_in_advance(known, selected, yes=wishes.yes, terminal=wishes.terminal)
        pins = Pins(fleet.path, kept=not fleet.rehearsed)
        with only_runner(known), Ledger(home()) as ledger:
            doubtful = none_under_way(known, ledger, reach)
            own, run_id, names = _begun_or_taken_up(known, ledger, wishes, names)
            opened(run_id)
            if gateways is not None:
                gateways.use(ledger.record(run_id).key)
            crew = Crew(folder_of(run_id), gateways.worker if gateways else None)
            interruption.wakes = crew.wake
            conductor = Conductor(
                Board(own, ledger, run_id), ledger, crew, people, interruption,
                pins=pins, at_once=wishes.at_once, in_advance=in_advance,
                can_ask=wishes.terminal, doubtful=doubtful,
            )  # fmt: skip
            try:
                result = conductor.run(names)
            finally:
                crew.close(lambda: interruption.count)
            if gateways is not None:
                record = ledger.record(run_id)
                for row in not_fetched(ledger, record):
                    fetch(gateways, ledger, record, row)
            return result, conductor.error


def _begun_or_taken_up(
    fleet: Fleet, ledger: Ledger, wishes: FleetWishes, names: tuple[str, ...]
) -> tuple[Fleet, str, tuple[str, ...]]:
    """The fleet with the job that is to be done, the run, and the axes that are."""
    if wishes.resume is None and not wishes.again:
        return fleet, begin(fleet, ledger, names), names
    record = ledger.record(wishes.resume or "last", fleet.path)
    if wishes.job is None:  # it was begun with
        fleet = replace(fleet, job=record.job)
    fetch_left(ledger, record, reach)
    if wishes.again:
        return fleet, record.id, again(fleet, ledger, record.id, wishes.again, names)
    return fleet, record.id, resume(fleet, ledger, record.id, names)


@contextlib.contextmanager
def reach(record: FleetRecord) -> Generator[Gateways]:
    """The gateways of a fleet run, as its file was when it began; raises UsageError."""
    gateways = gateways_by(record)
    try:
        yield gateways
    finally:
        gateways.close()


@contextlib.contextmanager
def met(fleet: Fleet, tell: Tell) -> Generator[tuple[Fleet, Gateways | None]]:
    """The fleet with what its gateways tell of its axes, and the gateways, if it has any."""
    gateways = gateways_of(fleet)
    if gateways is None:
        yield fleet, None
        return
    try:
        tell(f"asking gateways: {', '.join(gateways.names)}")
        for name, found in gateways.meet().items():
            if isinstance(found, TwoRelayError):
                tell(str(found))
            else:
                tell(f"gateway '{name}': {found.host}, tworelay {found.version}")
        yield gateways.joined(), gateways
    finally:
        gateways.close()


def check(
    fleet: Fleet,
    wishes: FleetWishes,
    tell: Callable[[str, Seen], None],
    interruption: Interruption,
    say: Tell,
    accept: tuple[str, ...] = (),
) -> tuple[Fleet, dict[str, Seen]]:
    """Look at the axes; nothing is written or moved. Returns the fleet as its gateways know it.

    `accept` : axes whose drives were exchanged rightfully: what is there now is pinned
    """
    names = chosen(fleet, wishes.only)
    for name in accept:
        fleet.axis(name)
    pins = Pins(fleet.path)
    folder = home() / "fleets"
    folder.mkdir(parents=True, exist_ok=True)
    with met(fleet, say) as (known, gateways):
        if gateways is not None:
            gateways.use(f"check@{platform.node()}-{os.getpid()}")
        crew = Crew(folder, gateways.worker if gateways else None)
        try:
            seen = look_at_all(
                known, [known.axis(name) for name in names], crew,
                rules_of(known, wishes.at_once), tell, interruption.check,
            )  # fmt: skip
        finally:
            crew.close(lambda: interruption.count)
    _accept(accept, seen, pins, say)
    said = {one.name: one.serial for one in fleet.axes if one.serial is not None}
    return known, held_back(known, judged(seen, {**pins.known, **said}))


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
