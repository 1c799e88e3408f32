"""How a fleet run begins, and how one that was left is taken up: resumed, or done again in part."""

from __future__ import annotations

import contextlib
import fnmatch
import hashlib
import json
from collections.abc import Generator, Sequence

from commissioning.ending import operator
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.plan import Fleet, PlannedAxis, differences
from commissioning.fleet.rows import FleetRecord, LedgerRow
from commissioning.fleet.settling import ON_GATEWAY, Known, Reach, fetch, settle
from commissioning.locks import Taken, take
from commissioning.result.fleet import FAILED, MAY_RESUME, JobState
from profiles.errors import Refused, UnknownName, UsageError

__all__ = [
    "again",
    "begin",
    "chosen",
    "fetch_left",
    "none_under_way",
    "not_fetched",
    "only_runner",
    "resume",
]

_DIFFERENCES = 3  # shown


def chosen(fleet: Fleet, only: str | None) -> tuple[str, ...]:
    """The axes that an EXPR names: names, globs, group=G, zone=Z, gateway=W; ! excludes.

    Commas are between them. Raises UsageError where a part of it names none.
    """
    everything = tuple(one.name for one in fleet.axes)
    if only is None:
        return everything
    parts = [part.strip() for part in only.split(",") if part.strip()]
    if not parts:
        raise UsageError(f"--only '{only}': names no axis; leave it away for all of them")
    wanted = [part for part in parts if not part.startswith("!")]
    taken = set(everything) if not wanted else set()
    for part in wanted:
        taken |= _named(fleet, part)
    for part in parts:
        if part.startswith("!"):
            taken -= _named(fleet, part[1:])
    if not taken:
        raise UsageError(f"--only {only}: leaves no axis")
    return tuple(name for name in everything if name in taken)


def _named(fleet: Fleet, part: str) -> set[str]:
    key, mark, value = part.partition("=")
    if mark and key in ("group", "zone", "gateway"):
        found = {one.name for one in fleet.axes if _of(one, key) == value}
        known = sorted({of for one in fleet.axes if (of := _of(one, key))})
    else:
        found = {one.name for one in fleet.axes if fnmatch.fnmatchcase(one.name, part)}
        known = [one.name for one in fleet.axes]
    if not found:
        raise UnknownName(f"{key if mark else 'axis'} of the fleet", value if mark else part, known)
    return found


def _of(axis: PlannedAxis, key: str) -> str | None:
    found: str | None = getattr(axis, key)
    return found


def begin(fleet: Fleet, ledger: Ledger, names: Sequence[str]) -> str:
    """A new fleet run of these axes; returns its id."""
    run = ledger.begin(
        fleet.name, fleet.path.resolve(), fleet.job, json.dumps(_definition(fleet)),
        operator() or "", [one.name for one in fleet.axes],
    )  # fmt: skip
    for one in fleet.axes:
        if one.name not in names:
            ledger.move(run, one.name, 1, JobState.SKIPPED, why="not asked for (--only)")
    return run


def _definition(fleet: Fleet) -> dict[str, object]:
    """What was asked for, and where its gateways say that their axes are."""
    told = {
        one.name: {"link": one.link, "group": one.group, "zone": one.zone}
        for one in fleet.axes
        if one.gateway and one.link
    }
    return {**fleet.definition, **({"told": told} if told else {})}


@contextlib.contextmanager
def only_runner(fleet: Fleet) -> Generator[None]:
    """The one runner of a fleet file on this machine: groups and zones are its own.

    Raises Refused.
    """
    twins = " on twins" if fleet.rehearsed else ""
    name = hashlib.sha256(f"{fleet.path.resolve()}{twins}".encode()).hexdigest()[:20]
    try:
        lock = take(f"fleet-{name}", f"fleet {fleet.name}")
    except Taken as taken:
        raise Refused(
            f"a run of {fleet.path} is under way ({taken.owner})",
            code="run.in-progress",
            hint="'tworelay fleet status' shows it, 'tworelay fleet stop' ends it",
        ) from None
    try:
        yield
    finally:
        lock.release()


def none_under_way(fleet: Fleet, ledger: Ledger, reach: Reach) -> dict[str, str]:
    """What an earlier runner has granted is revoked; what was started and is no more is unknown.

    What was handed to a gateway stands as that says; returns axes of which it says nothing, and
    why. Raises Refused while a process of it still moves an axis.
    """
    for run, row in ledger.left_open(fleet.path):
        if row.state is JobState.GRANTED:
            ledger.revoke(run, row.axis, row.attempt, "its runner is gone")
    elsewhere: dict[str, tuple[FleetRecord, list[LedgerRow]]] = {}
    for run, row in [*ledger.left_open(fleet.path), *_not_known(fleet, ledger)]:
        record = ledger.record(run)
        if record.place(row.axis).gateway is not None:
            elsewhere.setdefault(run, (record, []))[1].append(row)
            continue
        if row.is_alive:
            raise _under_way(row.axis, run, f"process {row.pid}")
        ledger.move(
            run, row.axis, row.attempt, JobState.UNKNOWN, given=(JobState.STARTED,),
            why="it was started, and its process is gone",
        )  # fmt: skip
    doubtful = {}
    for record, rows in elsewhere.values():
        with reach(record) as gateways:
            gateways.meet()
            for row in rows:
                known, gateway = settle(gateways, ledger, record, row), record.place(row.axis)
                if known is Known.MOVES:
                    raise _under_way(row.axis, record.id, f"on gateway '{gateway.gateway}'")
                if known is Known.NOT and any(one.name == row.axis for one in fleet.axes):
                    doubtful[row.axis] = f"nobody knows whether '{row.axis}' is at rest"
    return doubtful


def _under_way(axis: str, run: str, where: str) -> Refused:
    return Refused(
        f"axis '{axis}' of fleet run {run} is still under way ({where}), though its runner is gone",
        code="run.in-progress",
        hint="wait for it, or 'tworelay fleet stop'",
    )


def _not_known(fleet: Fleet, ledger: Ledger) -> list[tuple[str, LedgerRow]]:
    """Axes of the last run of a file that were handed to gateways, and may be known by now."""
    try:
        record = ledger.record("last", fleet.path)
    except UsageError:  # there is none
        return []
    return [
        (record.id, row)
        for row in ledger.rows(record.id).values()
        if row.state is JobState.UNKNOWN and record.place(row.axis).gateway is not None
    ]


def fetch_left(ledger: Ledger, record: FleetRecord, reach: Reach) -> None:
    """Take in what gateways have measured in a run and could not send."""
    if left := not_fetched(ledger, record):
        with reach(record) as gateways:
            gateways.meet()
            for row in left:
                fetch(gateways, ledger, record, row)


def not_fetched(ledger: Ledger, record: FleetRecord) -> list[LedgerRow]:
    """Attempts whose runs are on gateways still."""
    return [
        row
        for row in ledger.attempts(record.id)
        if row.outcome is not None
        and ON_GATEWAY in row.outcome.remark
        and record.place(row.axis).gateway is not None
    ]


def resume(fleet: Fleet, ledger: Ledger, run: str, names: Sequence[str]) -> tuple[str, ...]:
    """Take up a run that was left: its axes that were never started; returns which.

    Raises Refused where the fleet file has changed since, or an axis of it is still under way.
    """
    rows = _taken_over(fleet, ledger, run)
    left = [name for name, row in rows.items() if name in names and row.state in MAY_RESUME]
    revoked = {n: rows[n].attempt for n in left if rows[n].state is JobState.REVOKED}
    ledger.again(run, revoked)  # a process that still comes for the first one finds it revoked
    for name in left:
        if name not in revoked:
            ledger.move(
                run, name, rows[name].attempt, JobState.PLANNED, given=tuple(MAY_RESUME),
                why="resumed",
            )  # fmt: skip
    return tuple(left)


def again(
    fleet: Fleet, ledger: Ledger, run: str, which: Sequence[str], names: Sequence[str]
) -> tuple[str, ...]:
    """A new attempt at axes that have ended, by name, or 'failed' ones; returns which."""
    known = [one.name for one in fleet.axes]
    for name in which:
        if name != "failed" and name not in known:
            raise UnknownName("axis of the fleet", name, [*known, "failed"])
    rows = ledger.rows(run)
    waiting = [n for n in which if n in rows and rows[n].state in (*MAY_RESUME, JobState.SKIPPED)]
    if waiting:
        raise Refused(
            f"'{waiting[0]}' has not been started in fleet run {run} (it is "
            f"{rows[waiting[0]].state}): there is nothing to do again",
            code="fleet.not-started",
            hint="--resume goes on with those that were not started",
        )
    rows = _taken_over(fleet, ledger, run)
    wanted = [
        name
        for name, row in rows.items()
        if name in names and (name in which or ("failed" in which and row.state in FAILED))
    ]
    ledger.again(run, {name: rows[name].attempt for name in wanted})
    return tuple(wanted)


def _taken_over(fleet: Fleet, ledger: Ledger, run: str) -> dict[str, LedgerRow]:
    """The rows of a run that this process runs from now on."""
    record = ledger.record(run)
    if record.file != str(fleet.path.resolve()):
        raise Refused(
            f"fleet run {run} is of {record.file}, and not of {fleet.path}", code="refused.changed"
        )
    before = json.loads(record.definition)
    before.pop("told", None)
    changed = list(differences(before, fleet.definition))
    if changed:
        more = f" (and {len(changed) - _DIFFERENCES} more)" if changed[_DIFFERENCES:] else ""
        raise Refused(
            f"{fleet.path} has changed since fleet run {run} began: "
            f"{'; '.join(changed[:_DIFFERENCES])}{more}",
            code="refused.changed",
            hint="put it back, or begin a new run",
        )
    ledger.take_over(run, operator() or "")
    return ledger.rows(run)
