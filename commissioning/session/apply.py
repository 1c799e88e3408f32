"""Write what a run proposed, put back what was there, and make safe: the acts that change a drive."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Literal

from commissioning.journal import RESTORED, STORED, STORING, Journal, Kind, RunRecord
from commissioning.ownership import note_stop
from commissioning.records import History, Intent, has_stored
from commissioning.result.document import AxisState, Change, GainSet, RunResult, Written
from commissioning.runs import RunFolder, resolve
from commissioning.session.desk import Desk, connect, none_unfinished, same_drive
from commissioning.session.ending import axis_state, close_act, cut_off, ended, erring
from commissioning.settings import Restored, Return, Settings, planned, put_back, settle
from drivers.drive import Drive, StopReport
from drivers.link import check_files_of_others
from profiles.axis import Axis
from profiles.errors import (
    DriveEnabled,
    DriveFault,
    LinkError,
    Refused,
    TwoRelayError,
    UnknownName,
    UsageError,
    WriteFailed,
)
from profiles.library import builtin_names
from profiles.parameter import Protection, Trust, Unit
from profiles.schema import Profile

__all__ = [
    "apply",
    "axis_of_run",
    "leave_as_found",
    "own_run",
    "restore",
    "stop",
    "store",
    "to_restore",
    "unverified",
]

_FILE = 0.5  # s that a note to others may take


def axis_of_run(record: RunRecord, folder: RunFolder, link: str | None) -> Axis:
    """The axis of a run, on its own link or another, with the profile as it was in the run.

    Raises UsageError, Refused.
    """
    try:
        axis = Axis.model_validate_json(record.context.axis)
    except ValueError as error:
        raise UsageError(f"run {record.id}: its axis cannot be read ({error})") from None
    if link is None and record.adopted:
        check_files_of_others(record.link)
    profile = folder.profile_path()
    if record.adopted and not profile.exists() and record.profile not in builtin_names():
        raise UsageError(f"run {record.id}: the profile of its drive is missing")
    return axis.model_copy(
        update={
            "link": link or record.link,
            "profile": str(profile) if profile.exists() else record.profile,
        }
    )


def own_run(journal: Journal, run: str) -> tuple[str, RunFolder]:
    """RUN → its id and folder, to be acted on: an exported run is taken in first. Raises Refused."""
    run_id, folder = resolve(journal, run)
    if folder.exported is None:
        return run_id, folder
    if journal.knows(run_id):
        raise Refused(
            f"{run} is an exported run: adopt it first, or name run {run_id}, which is known here"
        )
    raise Refused(f"{run} is an exported run: adopt it first ('tworelay adopt {run}')")


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

    `show` gets the proposal with the values that are in the drive now. `gains`: rule whose gains of the
    drive's own loops are written, too. `prove_first`: nothing is stored.
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
            loops = drive.profile.loops
            if {item.parameter for item in gained} != set(loops.terms.values() if loops else ()):
                raise Refused(
                    f"run {run_id}: its gains are not those that the profile maps; tune it again"
                )
        if drive.is_energised():
            raise DriveEnabled(
                "the drive is enabled: its compensation is not changed while it controls the axis; "
                "disable it first"
            )
        present = tuple(_present(change, drive) for change in proposal)
        show(present)
        stores, then = _storing(drive.profile, prove_first=prove_first)
        goal = {change.parameter: change.new_raw for change in present}
        stored = not stores or has_stored(history, goal)
        names = [change.parameter for change in present]
        unverified(drive.profile, names, constant_known=axis.torque_constant is not None)
        if drive.profile.compensation.note:
            desk.tell(drive.profile.compensation.note)
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


def _check(result: RunResult, proposal: tuple[Change, ...]) -> None:
    """Raise Refused where there is nothing to write."""
    if result.measured and proposal:
        return
    reason = "its drive has no friction compensation to write to"
    if not result.measured:
        reason = f"its status is '{result.status}'"
    elif result.friction.coulomb is None:
        reason = "it measured no friction"
    raise Refused(f"run {result.run} proposes nothing: {reason}")


def _present(change: Change, drive: Drive) -> Change:
    """A change from what is in the drive now."""
    raw = drive.read_raw(change.parameter)
    parameter = drive.profile.parameters[change.parameter]
    return replace(change, old_raw=raw, old=drive.scaling.to_si(parameter, raw))


def _written(change: Change, kind: Literal["compensation", "gain"]) -> Written:
    return Written(change.parameter, kind, change.new_raw, change.new, change.unit)


def _storing(profile: Profile, *, prove_first: bool) -> tuple[bool, str]:
    """Whether a store follows the writes, and what the user is told."""
    if profile.store is None:
        return not prove_first, "and are lost at power-off: the profile has no store procedure"
    if not prove_first:
        return True, "and stored"
    return False, "in its RAM, and stored once they are proved"


def unverified(profile: Profile, names: list[str], *, constant_known: bool) -> None:
    """Raise Refused where a value would go to an address, or be scaled by a base, that nobody verified."""
    parameters = {name: profile.parameters[name] for name in names}
    doubtful = [
        f"{name} ({parameter.address})"
        for name, parameter in parameters.items()
        if parameter.trust is Trust.UNVERIFIED
    ]
    base = profile.parameters.get("rated_current")
    currents = [name for name, parameter in parameters.items() if parameter.unit is Unit.CURRENT]
    if currents and not constant_known and base is not None and base.trust is Trust.UNVERIFIED:
        raise Refused(
            f"{', '.join(currents)} is a current, and profile '{profile.name}' marks the rated current "
            f"({base.address}) unverified: nothing was written. Give torque_constant (N.m/A of the motor) in "
            "the axis file"
        )
    if doubtful:
        raise Refused(
            f"profile '{profile.name}' marks {', '.join(doubtful)} unverified: nothing was written. Check "
            "the drive's manual, mark them verified in a copy of the profile (tworelay profile show), and "
            "identify with that"
        )


def _gains(result: RunResult, rule: str) -> GainSet:
    """The set of gains by `rule` for the drive's own loops; raises Refused."""
    run = result.run
    sets = [s for s in result.of_loop("drive") if s.gains and s.source == "corrected"]
    if not sets:
        raise Refused(f"run {run} has no gains for the drive: 'tworelay tune {run}' makes them")
    found = next((s for s in sets if s.rule == rule), None)
    if found is None:
        raise UnknownName("rule with gains for the drive", rule, [s.rule for s in sets])
    if not found.proposed:
        raise Refused(f"run {run}: the gains by {rule} are not proposed: {found.why_not}")
    if not found.parameters:
        raise Refused(f"run {run}: the profile does not map the gains of {rule}; set them by hand")
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
    """RAM first, each read back; then store once, other masters no longer locked out; then read again."""
    settings = Settings(desk.journal, run_id, drive)
    with settings.exclusive_access():
        for change in wanted:
            if desk.interruption.hurried():
                desk.interruption.check()
            kind: Kind = "gain" if change.parameter in gains else "compensation"
            if settings.write(kind, change.parameter, change.new_raw):
                desk.tell(f"{change.parameter}: {change.old_raw} → {change.new_raw}, read back")
    if stores:
        store(drive, desk, run_id, {change.parameter: change.new_raw for change in wanted})


@contextlib.contextmanager
def _advising(run: str) -> Generator[None]:
    """What to do about writes that are broken off, added to the error."""
    try:
        yield
    except TwoRelayError as error:
        way = f"'tworelay restore {run}' puts the old values back"
        error.args = (f"{error}; what was written so far is in the journal: {way}",)
        raise


def store(
    drive: Drive, desk: Desk, run_id: str, wanted: dict[str, int], text: str = STORED
) -> None:
    """Store, and see that the raw values `wanted` are still there; raises WriteFailed.

    `text` : STORED, or RESTORED where they are those from before the run
    """
    procedure = drive.profile.store
    if procedure is None:
        desk.tell(
            f"profile '{drive.profile.name}' has no store procedure: the values are lost at power-off"
        )
        return
    before, most = desk.journal.stores(run_id), procedure.endurance
    if before >= most:
        raise WriteFailed(
            f"this drive has stored {before} times from here, and its memory takes about {most}: the values "
            "are in effect, and not stored; store them with the maker's software if its memory is new"
        )
    desk.journal.note(run_id, STORING)  # should this be cut off, `restore` must store
    try:
        drive.store()
    except TwoRelayError as error:
        error.args = (f"{error}; not known to be stored: {', '.join(wanted)}",)
        raise
    desk.journal.note_stored(run_id, text)
    for name, raw in wanted.items():
        there = drive.read_raw(name)
        if there != raw:
            raise WriteFailed(f"'{name}' reads {there} after the store, not {raw}")
    what = "the old values are stored" if text == RESTORED else "stored"
    desk.tell(
        f"{what} in the drive's non-volatile memory, read back again (store {before + 1} of this drive from "
        f"here; such a memory takes about {most})"
    )


def to_restore(run: str | None, desk: Desk) -> str | None:
    """The run whose changes are to be put back: `run`, else the last that wrote; None: there are none.

    Raises Refused, UnknownName.
    """
    if run is not None:
        run_id, _ = _resolve_any(desk, run)
        return run_id if desk.journal.intents(run_id, open_only=True) else None
    waiting = desk.journal.open_runs()
    if not waiting:
        if others := desk.journal.open_runs(adopted=True):
            raise Refused(
                "nothing of this computer's own is to be restored; of runs that were taken in: "
                + ", ".join(others[:5])
            )
        return None
    if waiting[0] != desk.journal.last_written():
        raise Refused(
            "the latest run has nothing to restore; name the one that is meant: "
            + ", ".join(f"{name} on {desk.journal.run(name).link}" for name in waiting[:5])
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

    None: it was a `dry_run`. Stores where the run has stored, and nothing unless everything is back. `show`
    gets what will be done.
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
        intents = desk.journal.intents(run_id, open_only=True)
        plan = planned(drive, intents, force=force)
        show(plan, drive)
        if dry_run:
            return None
        lasting = any(intent.kind != "experiment" for intent in intents)
        stores = drive.profile.store is not None and desk.journal.memory(run_id) in _OURS
        then = " and stored" if lasting and stores else ""
        there = bool(plan) and all(row.there == row.old for row in plan)
        if not there:
            desk.agree(
                f"These values will be WRITTEN BACK to axis '{record.axis}'{then}.", record.axis
            )
        elif then:
            desk.agree(
                f"The drive of axis '{record.axis}' has these values already; they will be STORED, "
                "as the run had stored others.",
                record.axis,
            )
        with desk.finishing():
            try:
                outcome = _put_all_back(drive, desk, run_id, force=force)
            except TwoRelayError as error:
                _note_return(desk, folder, history, axis_state(drive, axis), error)
                raise
            _note_return(desk, folder, history, axis_state(drive, axis))
        return outcome


def _note_return(
    desk: Desk,
    folder: RunFolder,
    before: History,
    axis: AxisState,
    error: TwoRelayError | None = None,
) -> None:
    """Write into the run what is in the drive after a restore; one whose file is gone stays without."""
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
    if drive.is_energised():
        profile = RunFolder.of(desk.journal, run_id).profile_path()
        raise DriveEnabled(
            f'the drive is enabled: \'tworelay stop "{drive.link}" --profile "{profile}"\' makes it safe, '
            f"then 'tworelay restore {run_id}'"
        )


def _put_all_back(drive: Drive, desk: Desk, run_id: str, *, force: bool) -> Restored:
    """Everything that a run changed in the connected drive; raises WriteFailed, PreflightRefused."""
    _check_not_enabled(drive, desk, run_id)
    intents = desk.journal.intents(run_id, open_only=True)
    settings = Settings(desk.journal, run_id, drive)
    with settings.exclusive_access():
        outcome = put_back(drive, intents, force=force)
    lasting = [intent for intent in intents if intent.kind != "experiment"]
    # until they are all back, and stored where the run has stored, those for good stay open
    settle(desk.journal, [i for i in intents if i.kind == "experiment"], outcome)
    _note_back(desk, run_id, lasting, outcome)
    if not outcome.complete:
        unstored = "; nothing was stored" if lasting else ""
        raise _Incomplete(
            f"restore of run {run_id} is incomplete: {outcome}{unstored}; the run stays open, and "
            f"'tworelay restore {run_id}' tries again",
            (*outcome.failed, *outcome.skipped),
        )
    if lasting and drive.profile.store is not None and desk.journal.memory(run_id) in _OURS:
        old = {intent.parameter: intent.old for intent in reversed(lasting)}
        try:
            store(drive, desk, run_id, old, RESTORED)
        except TwoRelayError as error:
            error.args = (f"{error}; 'tworelay restore {run_id}' tries again",)
            raise
    of_run = desk.journal.intents(run_id, open_only=True)
    settle(desk.journal, [i for i in of_run if i.lasts], outcome)
    if outcome.failed:  # to say so in the journal
        raise WriteFailed(f"restore of run {run_id} is incomplete: {outcome}")
    return outcome


def _note_back(desk: Desk, run_id: str, lasting: list[Intent], outcome: Restored) -> None:
    """Of those for good, which stay open until all is done: what has its old value, and what nobody knows."""
    for name in (*outcome.restored, *outcome.already):
        of_it = [intent for intent in lasting if intent.parameter == name]
        if of_it and of_it[-1].new != of_it[0].old:
            first, last = of_it[0], of_it[-1]
            back = desk.journal.intend(run_id, last.kind, name, last.new, first.old)
            desk.journal.settle([back], "verified")
    unknown = {i.parameter: i.seq for i in lasting if i.parameter in outcome.skipped}
    desk.journal.settle(list(unknown.values()), "intended")


_OURS = STORED, STORING  # what may be in a non-volatile memory


class _Incomplete(WriteFailed):
    """Some parameters are not back; `left`: which."""

    def __init__(self, message: str, left: tuple[str, ...]) -> None:
        super().__init__(message)
        self.left = left


def leave_as_found(run: str, desk: Desk) -> tuple[str, AxisState | None]:
    """Put back all that `run` changed, after it came to nothing; never raises.

    Returns what it reached, '' where nothing had been changed; and what the drive said of its axis then.
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
                raise LinkError(f"another drive is on the link, with serial {found.serial}")
            state = axis_state(drive, axis)
            outcome = _put_all_back(drive, desk, run, force=False)
    except TwoRelayError as error:
        history = desk.journal.history(run)
        left = [i.parameter for i in history.intents if i.is_open and not i.lasts]
        left += [i.parameter for i in history.intents if i.lasts and history.in_ram(i.parameter)]
        why = "the drive cannot be reached" if isinstance(error, LinkError) else str(error)
        way = f"'tworelay restore {run}' puts the old values back"
        if not left:
            return f"the old values are in the drive's RAM, and NOT stored ({why}); {way}", state
        return f"NOT put back: {', '.join(dict.fromkeys(left))} ({why}); {way}", state
    return f"the drive is as it was found ({outcome})", state


def _resolve_any(desk: Desk, run: str) -> tuple[str, RunFolder]:
    """Like `resolve`, but a run killed before it wrote files is good enough to restore."""
    if Path(run).is_dir():
        return own_run(desk.journal, run)
    record = desk.journal.run(run)
    return record.id, RunFolder.of(desk.journal, record.id)


def stop(axis: Axis, desk: Desk) -> StopReport:
    """Make safe what a dead process left energised; raises when that is not verified."""
    with desk.interruption.deferred(), connect(axis, None, desk, "stop", to_stop=True) as drive:
        if not drive.profile.moves:
            raise Refused(
                f"profile '{drive.profile.name}' has no way to stop the drive, which says: "
                f"{drive.status_text()}; use its own controller or the emergency stop"
            )
        word = Thread(target=note_stop, args=(drive.link,), daemon=True)  # a stop waits for no file
        word.start()
        report = drive.stop(desk.interruption.hurried)
        word.join(_FILE)
        _tell_what_is_left(drive, desk)
    if report.deenergised is None:
        raise LinkError(str(report))
    if not report.deenergised:
        raise DriveFault(str(report))
    return report


def _tell_what_is_left(drive: Drive, desk: Desk) -> None:
    """Registers that the machine uses, too, and that the stop path had to write."""
    parameters, last = drive.profile.parameters, {}
    for step in (*drive.profile.stop, *drive.profile.disable):
        if step.write and parameters[step.write].protection is Protection.EXPERIMENT:
            last[step.write] = step.raw
    for name, raw in last.items():
        desk.tell(
            f"{name} ({parameters[name].address}) is left at {raw}: set it as the machine needs it"
        )
