"""A fleet run as a command asks for it: begun, resumed or done again; and the look alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from commissioning.fleet.board import Board
from commissioning.fleet.conductor import Conductor, People, seconds_of
from commissioning.fleet.confirming import check_in_advance
from commissioning.fleet.crew import Crew
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.looking import Seen, judged, look_at_all, rules_of, task_of
from commissioning.fleet.pages import folder_of
from commissioning.fleet.plan import Fleet
from commissioning.fleet.schedule import makespan, planned
from commissioning.fleet.serials import Pins
from commissioning.fleet.taking_up import again, begin, chosen, only_runner, resume
from commissioning.interruption import Interruption
from commissioning.result.fleet import FleetResult
from drivers.home import home
from profiles.errors import UsageError

__all__ = ["FleetWishes", "check", "expected", "run"]


@dataclass(frozen=True, slots=True)
class FleetWishes:
    """What is asked of a fleet run, beside its file.

    Attributes
    ----------
    resume : id of a run to be taken up, or 'last'
    again : axes to be done again, or 'failed'
    terminal : somebody can be asked
    """

    only: str | None = None
    at_once: int | None = None
    resume: str | None = None
    again: tuple[str, ...] = ()
    yes: bool = False
    terminal: bool = False


def run(
    fleet: Fleet,
    wanted: FleetWishes,
    people: People,
    interruption: Interruption,
    opened: Callable[[str], None],
) -> FleetResult:
    """Run a fleet; `opened` gets its id as soon as there is one.

    Raises
    ------
    UsageError, Refused
        Nothing was begun.
    JournalError
        The ledger took no more; what was under way then was finished.
    Interrupted
        After what was under way has ended.
    """
    names = chosen(fleet, wanted.only)
    _without_gateways(fleet)
    selected = [fleet.axis(name) for name in names]
    in_advance = check_in_advance(fleet, selected, yes=wanted.yes, terminal=wanted.terminal)
    pins = Pins(fleet.path, kept=not fleet.rehearsed)
    with Ledger(home()) as ledger:
        if wanted.resume is not None or wanted.again:
            of_name = fleet.name if wanted.resume in (None, "last") else None
            run_id = ledger.record(wanted.resume or "last", of_name).id
        else:
            run_id = begin(fleet, ledger, names)
        with only_runner(run_id):
            if wanted.again:
                names = again(fleet, ledger, run_id, wanted.again, names)
            elif wanted.resume is not None:
                names = resume(fleet, ledger, run_id, names)
            opened(run_id)
            folder_of(run_id).mkdir(parents=True, exist_ok=True)
            crew = Crew(folder_of(run_id))
            conductor = Conductor(
                Board(fleet, ledger, run_id), ledger, crew, people, interruption,
                pins=pins, at_once=wanted.at_once, in_advance=in_advance,
            )  # fmt: skip
            try:
                with interruption.deferred():
                    return conductor.run(names)
            finally:
                crew.close()
                if conductor.board.failure is not None:
                    raise conductor.board.failure


def _without_gateways(fleet: Fleet) -> None:
    for one in fleet.axes:
        if one.gateway is not None:
            raise UsageError(
                f"axis '{one.name}' is behind gateway '{one.gateway}', and this version runs what "
                "is on this computer only: run its axes there"
            )


def check(
    fleet: Fleet,
    wanted: FleetWishes,
    tell: Callable[[str, Seen], None],
    interruption: Interruption,
    accept: tuple[str, ...] = (),
) -> dict[str, Seen]:
    """Look at the axes; nothing is written or moved.

    `accept` : axes whose drives were exchanged rightfully: what is there now is pinned
    """
    names = chosen(fleet, wanted.only)
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
            rules_of(fleet, wanted.at_once), tell, interruption.check,
        )  # fmt: skip
    finally:
        crew.close()
    _accept(accept, seen, pins)
    said = {one.name: one.serial for one in fleet.axes if one.serial is not None}
    return judged(seen, {**pins.known, **said})


def _accept(names: tuple[str, ...], seen: Mapping[str, Seen], pins: Pins) -> None:
    new = {}
    for name in names:
        looked = seen[name].looked if name in seen else None
        if looked is None:
            raise UsageError(f"--accept-serial {name}: its drive was not seen")
        new[name] = looked.serial
    if not new:
        return
    with Ledger(home()) as ledger:
        for name, serial in new.items():
            before = pins.known.get(name, "none")
            ledger.note("", f"serial accepted: {serial}, was {before}", name)
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
