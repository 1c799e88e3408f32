"""Put back what a run changed, or leave the drive as it was found."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

from commissioning.desk import Desk, connect, same_drive
from commissioning.ending import axis_state, ended, erring
from commissioning.journal import RESTORED, Journal
from commissioning.records import History, Intent, RunRecord
from commissioning.result.endings import AxisState
from commissioning.runs import RunFolder
from commissioning.session.named import axis_of_run, resolve_any
from commissioning.session.storing import store
from commissioning.settings import Restored, Return, Settings, planned, put_back, settle
from drivers.drive import Drive
from drivers.errors import DriveEnabled, LinkError, WriteFailed
from drivers.places import same_place
from profiles.errors import Refused, TwoRelayError, UsageError
from profiles.identity import NO_SERIAL

__all__ = ["leave_as_found", "restore", "to_restore"]


def to_restore(run: str | None, desk: Desk) -> str | None:
    """The run whose changes are to be put back: `run`, else the last that wrote.

    None: there are none.

    Raises Refused, UnknownName.
    """
    if run is not None:
        run_id, _ = resolve_any(desk, run)
        return run_id if desk.journal.intents(run_id, open_only=True) else None
    waiting = desk.journal.open_runs()
    if not waiting:
        if others := desk.journal.open_runs(adopted=True):
            raise Refused(
                "nothing of this computer's own is to be restored; of runs that were taken in: "
                + ", ".join(others[:5]),
                code="restore.adopted",
            )
        return None
    if waiting[0] != desk.journal.last_written():
        raise Refused(
            "the latest run has nothing to restore; name the one that is meant: "
            + ", ".join(f"{name} on {desk.journal.run(name).link}" for name in waiting[:5]),
            code="restore.name-it",
        )
    return waiting[0]


def restore(
    run_id: str,
    link: str | None,
    desk: Desk,
    *,
    force: bool,
    show: Callable[[list[Return], Drive], None] = lambda rows, drive: None,
    dry_run: bool = False,
) -> Restored | None:
    """Put back every parameter that the run changed, once that is agreed.

    None: it was a `dry_run`. Stores where the run has stored, and nothing unless everything is
    back. `show` gets what will be done.
    """
    folder = RunFolder.of(desk.journal, run_id)
    history = desk.journal.history(run_id)
    record = history.run
    if not any(intent.is_open for intent in history.intents):
        return Restored()
    axis = axis_of_run(record, folder, link)
    desk.tell(f"run {run_id}: axis '{record.axis}' on {axis.link}")
    with connect(axis, None, desk, f"run {run_id}", lenient=True) as drive:
        same_drive(drive.identity(), record.serial, run_id, drive.link, desk)
        _check_not_enabled(drive, desk, run_id)
        drive.preparation.check_word_order()
        intents = desk.journal.intents(run_id, open_only=True)
        if not force:
            _none_later(desk.journal, record, intents)
        plan = planned(drive, intents, force=force)
        show(plan, drive)
        if dry_run:
            return None
        stores = drive.memory is not None and not history.has_stored(history.before())
        then = " and stored" if stores else ""
        there = bool(plan) and all(row.there == row.old for row in plan)
        if not there:
            desk.agree(
                f"These values will be WRITTEN BACK to axis '{record.axis}'{then}.", record.axis
            )
        elif then:
            desk.agree(
                f"The drive of axis '{record.axis}' has these values already; they will be STORED, "
                "as its memory has others.",
                record.axis,
            )
        with desk.finishing():
            with contextlib.suppress(UsageError):
                folder.save(replace(folder.result(), ending=None))
            try:
                outcome = _put_all_back(drive, desk, run_id, force=force)
            except TwoRelayError as error:
                _note_return(desk, folder, history, axis_state(drive, axis), error)
                raise
            _note_return(desk, folder, history, axis_state(drive, axis))
        return outcome


def _none_later(journal: Journal, record: RunRecord, intents: list[Intent]) -> None:
    """Raise Refused where a later run of the same drive has written over what would be put back."""
    names = {intent.parameter for intent in intents if intent.lasts}
    is_told = record.serial not in NO_SERIAL  # else it is the drive on that link
    every = journal.on_drive(record.serial)
    runs = [one.id for one in every if is_told or same_place(one.link, record.link)]
    for later in reversed(runs[runs.index(record.id) + 1 :] if record.id in runs else []):
        over = {i.parameter for i in journal.intents(later, open_only=True) if i.lasts} & names
        if over:
            raise Refused(
                f"run {later} wrote {', '.join(sorted(over))} later, on the same drive: nothing "
                "was written back",
                code="restore.later-run",
                hint=f"'tworelay restore {later}' first; after --force do not restore {later}: it "
                "would put this run's values back",
                run=later,
            )


def _note_return(
    desk: Desk,
    folder: RunFolder,
    before: History,
    axis: AxisState,
    error: TwoRelayError | None = None,
) -> None:
    """Write into the run what is in the drive after a restore.

    One whose file is gone stays without.
    """
    with contextlib.suppress(UsageError):
        result = folder.result(before)
        if error is None and any(intent.lasts for intent in before.intents):
            result = replace(result, written=())
        said_by = None
        if error is not None:
            error.noted, said_by = True, error.said_by or None
            result = replace(erring(result, error), status=result.status)
        folder.save(ended(result, desk.journal.history(before.run.id), axis, said_by))


def _check_not_enabled(drive: Drive, desk: Desk, run_id: str) -> None:
    """Raises PreflightRefused: nothing is put back in a drive that controls its axis."""
    if drive.state().is_energised:
        profile = RunFolder.of(desk.journal, run_id).profile_path()
        raise DriveEnabled(
            f'the drive is enabled: \'tworelay stop "{drive.link}"'
            f' --profile "{profile}"\' makes it safe, '
            f"then 'tworelay restore {run_id}'"
        )


def _put_all_back(drive: Drive, desk: Desk, run_id: str, *, force: bool) -> Restored:
    """Everything that a run changed in the connected drive.

    Raises WriteFailed, PreflightRefused.
    """
    _check_not_enabled(drive, desk, run_id)
    journal = desk.journal
    intents = journal.intents(run_id, open_only=True)
    lasting = [intent for intent in intents if intent.lasts]
    old = {intent.parameter: intent.old for intent in reversed(lasting)}
    back = _intended(journal, run_id, lasting)
    settings = Settings(journal, run_id, drive)
    with settings.exclusive_access():
        outcome = put_back(drive, intents, force=force)
    done = {*outcome.restored, *outcome.already}
    journal.settle([seq for name, seq in back.items() if name in done], "verified")
    # until they are all back, and stored where others are in the memory, those for good stay open
    settle(journal, [i for i in intents if not i.lasts], outcome)
    if not outcome.complete:
        unstored = "; nothing was stored" if lasting else ""
        raise _Incomplete(
            f"restore of run {run_id} is incomplete: {outcome}{unstored}; the run stays open, and "
            f"'tworelay restore {run_id}' tries again",
            (*outcome.failed, *outcome.skipped),
        )
    if drive.memory is not None and not journal.history(run_id).has_stored(old):
        try:
            store(drive, desk, run_id, old, RESTORED)
        except TwoRelayError as error:
            error.also(f"'tworelay restore {run_id}' tries again")
            raise
    of_run = journal.intents(run_id, open_only=True)
    settle(journal, [i for i in of_run if i.lasts], outcome)
    if outcome.failed:  # to say so in the journal
        raise WriteFailed(
            f"restore of run {run_id} is incomplete: {outcome}", code="restore.incomplete"
        )
    return outcome


def _intended(journal: Journal, run_id: str, lasting: list[Intent]) -> dict[str, int]:
    """Say of each value for good that is not the old one that it will be written back.

    A write like any.
    """
    found: dict[str, int] = {}
    for name in dict.fromkeys(intent.parameter for intent in lasting):
        of_it = [intent for intent in lasting if intent.parameter == name]
        first, last = of_it[0], of_it[-1]
        if last.new != first.old or last.state == "intended":
            found[name] = journal.intend(run_id, last.kind, name, last.new, first.old)
    return found


class _Incomplete(WriteFailed):
    """Some parameters are not back; `left`: which."""

    def __init__(self, message: str, left: tuple[str, ...]) -> None:
        super().__init__(message)
        self.left = left


def leave_as_found(run: str, desk: Desk) -> tuple[str, AxisState | None]:
    """Put back all that `run` changed, after it came to nothing; never raises.

    Returns what it reached, '' where nothing had been changed; and what the drive said of its axis
    then.
    """
    intents = desk.journal.intents(run, open_only=True)
    if not intents:
        return "", None
    record, folder = desk.journal.run(run), RunFolder.of(desk.journal, run)
    state: AxisState | None = None
    try:
        axis = axis_of_run(record, folder, None)
        with connect(axis, None, desk, f"run {run}", lenient=True) as drive:
            found = drive.identity()
            if found.serial != record.serial:
                raise LinkError(
                    f"another drive is on the link, with serial {found.serial}",
                    code="identity.serial",
                )
            state = axis_state(drive, axis)
            outcome = _put_all_back(drive, desk, run, force=False)
    except TwoRelayError as error:
        history = desk.journal.history(run)
        left = [i.parameter for i in history.intents if i.is_open and not i.lasts]
        left += [
            name
            for name, old in history.before().items()
            if name in history.image
            and (history.image[name].raw, True) != (old, history.image[name].certain)
        ]
        why = "the drive cannot be reached" if isinstance(error, LinkError) else str(error)
        way = f"'tworelay restore {run}' puts the old values back"
        if not left:
            return f"the old values are in the drive's RAM, and NOT stored ({why}); {way}", state
        return f"NOT put back: {', '.join(dict.fromkeys(left))} ({why}); {way}", state
    return f"the drive is as it was found ({outcome})", state
