"""Write what a run proposed, read it back, store it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Literal

from commissioning.desk import Desk, connect, none_unfinished, same_drive
from commissioning.ending import axis_state, close_act, cut_off
from commissioning.journal import Kind
from commissioning.records import History
from commissioning.result.changes import Change, Written
from commissioning.result.document import RunResult
from commissioning.result.worth import GainSet
from commissioning.session.named import axis_of_run, own_run
from commissioning.session.storing import all_writable, store, storing
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.errors import DriveEnabled
from profiles.errors import Refused, TwoRelayError, UnknownName
from profiles.library import outdated

__all__ = ["apply"]


def apply(
    run: str,
    link: str | None,
    desk: Desk,
    show: Callable[[tuple[Change, ...]], None],
    gains: str | None = None,
    *,
    prove_first: bool = False,
) -> RunResult:
    """Write the proposal of `run` to its drive, read back, store; return the result.

    `show` gets the proposal with the values that are in the drive now. `gains`: rule whose gains of
    the drive's own loops are written, too. `prove_first`: nothing is stored.
    """
    run_id, folder = own_run(desk.journal, run)
    history = desk.journal.history(run_id)
    record, result = history.run, folder.result(history)
    tuned = _gains(result, gains) if gains is not None else None
    gained = tuned.parameters if tuned else ()
    proposal = (*result.compensation, *gained)
    _check(result, proposal)
    axis = axis_of_run(record, folder, link)
    with connect(axis, None, desk, f"run {run_id}") as drive:
        identity = drive.identity()
        same_drive(identity, record.serial, run_id, drive.link, desk)
        none_unfinished(desk, identity.serial, drive.link)
        if tuned:
            loops = drive.loops
            if {item.parameter for item in gained} != set(loops.terms.values() if loops else ()):
                raise Refused(
                    f"run {run_id}: its gains are not those that the profile maps; tune it again",
                    code="gains.not-mapped",
                )
        _may_be_written_to(drive, desk)
        present = tuple(_present(change, drive) for change in proposal)
        show(present)
        stores, then = storing(drive, prove_first=prove_first)
        stored = not stores or _is_stored(history, proposal)
        names = [change.parameter for change in present]
        all_writable(drive, names)
        if drive.compensation.note:
            desk.tell(drive.compensation.note)
        writes = any(change.old_raw != change.new_raw for change in present) or not stored
        if writes:
            desk.agree(f"These values will be WRITTEN to axis '{axis.name}' {then}.", axis.name)
        else:
            desk.tell("the drive has these values already")
        # whoever wants a proof puts them back
        advising = contextlib.nullcontext() if prove_first else _advising(run_id)
        with desk.finishing():
            try:
                if writes:
                    folder.save(cut_off(result))
                    _found_there(desk, history, proposal, present, gained)
                    of_loops = frozenset(change.parameter for change in gained)
                    with advising:
                        _write(drive, desk, run_id, present, of_loops, stores=stores)
            except TwoRelayError as error:
                close_act(desk, folder, result, axis_state(drive, axis), error)
                raise
            changed = [c for c in result.compensation if c.old_raw != c.new_raw]
            there = [_written(change, "compensation") for change in changed]
            there += [_written(change, "gain") for change in gained]
            others = [one for one in result.written if one.parameter not in names]
            result = replace(result, status="completed", error=None, written=(*others, *there))
            result = close_act(desk, folder, result, axis_state(drive, axis))
    return result


def _may_be_written_to(drive: Drive, desk: Desk) -> None:
    """Raise DriveEnabled, or PreflightRefused where it is not as its profile requires."""
    if old := outdated(drive.profile):
        desk.tell(old)
    if drive.state().is_energised:
        raise DriveEnabled(
            "the drive is enabled: its compensation is not changed while it controls the axis; "
            "disable it first"
        )
    drive.preparation.check_conditions()


def _is_stored(history: History, proposal: tuple[Change, ...]) -> bool:
    """Whether the drive's memory has the proposal, as far as this computer knows."""
    known = {c.parameter: c.new_raw for c in proposal if c.parameter in history.image}
    others = (c for c in proposal if c.parameter not in history.image)
    return history.has_stored(known) and all(c.old_raw == c.new_raw for c in others)


def _found_there(
    desk: Desk,
    history: History,
    proposal: tuple[Change, ...],
    present: tuple[Change, ...],
    gained: tuple[Change, ...],
) -> None:
    """Journal what somebody else has written as this run proposes it: the way back."""
    for change, now in zip(proposal, present, strict=True):
        cell = history.image.get(change.parameter)
        known = cell is not None and cell.raw == now.old_raw
        if (
            change.old_raw not in (None, change.new_raw)
            and now.old_raw == change.new_raw
            and not known
        ):
            assert change.old_raw is not None
            kind: Kind = "gain" if change in gained else "compensation"
            intent = desk.journal.intend(
                history.run.id, kind, change.parameter, change.old_raw, change.new_raw
            )
            desk.journal.settle([intent], "verified")


def _check(result: RunResult, proposal: tuple[Change, ...]) -> None:
    """Raise Refused where there is nothing to write."""
    if result.measured and proposal:
        return
    reason = "its drive has no friction compensation to write to"
    if not result.measured:
        reason = f"its status is '{result.status}'"
    elif result.friction.coulomb is None:
        reason = "it measured no friction"
    raise Refused(
        f"run {result.run} proposes nothing: {reason}",
        code="run.nothing-proposed",
        hint="'tworelay history' lists those that do",
    )


def _present(change: Change, drive: Drive) -> Change:
    """A change from what is in the drive now."""
    there = drive.read(change.parameter)
    return replace(change, old_raw=there.raw, old=there.si)


def _written(change: Change, kind: Literal["compensation", "gain"]) -> Written:
    return Written(change.parameter, kind, change.new_raw, change.new, change.unit)


def _gains(result: RunResult, rule: str) -> GainSet:
    """The set of gains by `rule` for the drive's own loops; raises Refused."""
    run = result.run
    sets = [s for s in result.of_loop("drive") if s.gains and s.source == "corrected"]
    if not sets:
        raise Refused(
            f"run {run} has no gains for the drive: 'tworelay tune {run}' makes them",
            code="gains.none",
        )
    found = next((s for s in sets if s.rule == rule), None)
    if found is None:
        raise UnknownName("rule with gains for the drive", rule, [s.rule for s in sets])
    if not found.proposed:
        raise Refused(
            f"run {run}: the gains by {rule} are not proposed: {found.why_not}",
            code="gains.not-proposed",
        )
    if not found.parameters:
        raise Refused(
            f"run {run}: the profile does not map the gains of {rule}",
            code="gains.not-mapped",
            hint="set them by hand",
        )
    return found


def _write(
    drive: Drive,
    desk: Desk,
    run_id: str,
    wanted: tuple[Change, ...],
    gains: frozenset[str],
    *,
    stores: bool,
) -> None:
    """RAM first, each read back.

    Then store once, other masters no longer locked out; then read again.
    """
    settings = Settings(desk.journal, run_id, drive)
    with settings.exclusive_access():
        for change in wanted:
            if desk.interruption.hurried():
                desk.interruption.check()
            kind: Kind = "gain" if change.parameter in gains else "compensation"
            if settings.write(kind, change.parameter, change.new_raw):
                desk.watcher.phase(
                    f"{change.parameter}: {change.old_raw} → {change.new_raw}, read back"
                )
    if stores:
        store(drive, desk, run_id, {change.parameter: change.new_raw for change in wanted})


@contextlib.contextmanager
def _advising(run: str) -> Generator[None]:
    """What to do about writes that are broken off, added to the error."""
    try:
        yield
    except TwoRelayError as error:
        way = f"'tworelay restore {run}' puts the old values back"
        error.also(f"what was written so far is in the journal: {way}")
        raise
