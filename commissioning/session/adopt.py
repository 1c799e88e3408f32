"""A run of another computer is taken in: shown, compared with what is known here, and agreed to.

What it says about the drive is not believed. Its profile stays outside: the profile of the drive as
it is known here is what the run is applied, verified and restored by.
"""

from __future__ import annotations

import contextlib
import platform
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from commissioning.desk import Desk
from commissioning.records import History, Intent
from commissioning.result.changes import Written
from commissioning.result.document import RunResult
from commissioning.result.history import computer_of
from commissioning.runs import RunFolder, resolve
from commissioning.session.named import axis_of_run
from drivers.link import check_files_of_others
from profiles.axis import Axis, axis_name
from profiles.commands import commands_of
from profiles.errors import ProfileError, Refused, TwoRelayError, UnknownName, UsageError
from profiles.library import load_profile, source_text
from profiles.parameter import Protection
from profiles.schema import Profile

__all__ = ["Adopted", "AdoptedAll", "adopt", "adopt_all", "exported_in"]

_SHOWN = 5  # of what differs
_ID = re.compile(r"[0-9]{8}-[0-9]{6}-[A-Za-z0-9][A-Za-z0-9._-]{0,100}")
_PDO = re.compile(r"1[0-9A-F]{3}h:[0-9A-F]{2}")  # the bus' own: its driver looks at each by itself


@dataclass(frozen=True, slots=True)
class Adopted:
    """What is shown before a run is taken in.

    Attributes
    ----------
    run, axis, serial : as the run says; what the axis says scales torques and positions
    profile : the one known here
    intents : what it wrote, by its journal
    named : what its axis is called now
    notes : on that axis, that are not known here
    """

    run: str
    axis: Axis
    serial: str
    profile: Profile
    intents: tuple[Intent, ...]
    named: str
    notes: tuple[str, ...]


def adopt(
    path: Path,
    profile: str | None,
    desk: Desk,
    show: Callable[[Adopted], None],
    *,
    written: tuple[Written, ...] = (),
) -> str:
    """Take in the exported run in `path`, unless it is known; returns its id.

    Parameters
    ----------
    profile : name or file of the drive's profile, where none of that name is built in
    written : of it is in its drive, as is known otherwise than by what it says

    Raises UsageError, Refused.
    """
    if not (path / "run.json").is_file():
        raise UsageError(
            f"{path}: is no folder of an exported run; 'tworelay export RUN DIR' makes one"
        )
    run, folder = resolve(desk.journal, str(path))
    history = folder.exported
    assert history is not None
    record = history.run
    if not _ID.fullmatch(run) or run.endswith((".", ".toml")):
        raise UsageError(f"{path}: '{run:.100}' is no id of a run")
    known = desk.journal.known_as(record)
    if known is not None:
        _again(history, known, path, desk)
        return known
    here = desk.journal.free_id(run)
    target, result = RunFolder.of(desk.journal, here), folder.result()
    if target.path.exists():
        raise Refused(
            f"{target.path}: is there, of a run that the journal does not know: move it away",
            code="adopt.there",
        )
    named = (
        ("run", result.run, run), ("axis", result.axis, record.axis), ("link", result.link,
        record.link)
    )  # fmt: skip
    for key, told, there in named:
        if told != there:
            raise UsageError(
                f"{path}: its result and its journal are of two runs ('{key}' differs)"
            )
    axis = axis_of_run(record, folder, record.link)
    check_files_of_others(record.link, "state")
    if axis.name != record.axis:
        raise UsageError(f"{path}: its axis is named otherwise than its run")
    name, own = _known_here(profile, result, path)
    theirs = _of_the_run(folder, path)
    found = _differences(history, result, theirs, own) or _impossible(history, result, own)
    if found:
        raise Refused(
            f"{path}: not taken in, it differs from profile '{own.name}' as it is known here: "
            + "; ".join(found[:_SHOWN])
            + (f"; and {len(found) - _SHOWN} more" if found[_SHOWN:] else ""),
            code="adopt.differs",
        )
    samples = folder.samples()
    called = _named(history, path)
    here_is = platform.node()
    whose = None if result.host == here_is else result.host or "another computer"
    notes = desk.journal.new_notes(called, history.notes, whose)
    texts = tuple(note.text for note in notes)
    show(Adopted(run, axis, record.serial, own, history.intents, called, texts))
    if here != run:
        desk.tell(f"another run here has the id {run}: this one will be called {here}")
    desk.agree(
        "This run of another computer will be TAKEN IN: 'apply', 'verify' and 'restore' then write "
        f"to the drive of axis '{record.axis}' by it.",
        record.axis,
        "it was not taken in",
    )
    context = replace(record.context, axis=axis.model_copy(update={"name": called}).as_said())
    result = replace(result, run=here, axis=called, written=written)
    target.save(result, samples, source_text(name))
    taken = replace(record, id=here, axis=called, context=context)
    return desk.journal.adopt(replace(history, run=taken), notes)


def _named(history: History, path: Path) -> str:
    """What the axis is called where the run comes from; raises UsageError."""
    try:
        return axis_name(history.named or history.run.axis)
    except ValueError as error:
        raise UsageError(f"{path}: the name of its axis {error}") from None


def _again(history: History, known: str, path: Path, desk: Desk) -> None:
    """A run that is known comes again: its axis may have another name by now, and more notes.

    Both once that is agreed.
    """
    entry = desk.journal.entry(known)
    assert entry is not None
    of_host = computer_of(entry, platform.node())
    called, axis = _named(history, path), desk.journal.history(known, of_drive=False).named
    # an export from before the renaming has the name of the run still
    if of_host is not None and called not in (axis, history.run.axis):
        desk.agree(
            f"Run {known} is known here. Axis '{axis}' of {of_host} is called '{called}' there "
            "now, and all its runs will be here.",
            called,
            "it keeps its name",
        )
        _call(axis, called, of_host, desk)
        axis = called
    notes = desk.journal.new_notes(axis, history.notes, of_host)
    if not notes:
        desk.tell(f"run {known} is known here: nothing was taken in")
        return
    texts = "; ".join(note.text for note in notes[:_SHOWN])
    desk.agree(
        f"Run {known} is known here. {len(notes)} note(s) on axis '{axis}' will be TAKEN IN, and "
        f"its drift is counted from the last of them: {texts}",
        axis,
        "no note was taken in",
    )
    for note in notes:
        desk.journal.note_on(note)


def _call(old: str, new: str, host: str, desk: Desk) -> None:
    """An axis of another computer gets the name that it has there, with all its runs and notes."""
    contexts = {}
    for record in desk.journal.runs_of_host(old, host):
        axis = Axis.model_validate_json(record.context.axis).model_copy(update={"name": new})
        contexts[record.id] = replace(record.context, axis=axis.as_said())
        folder = RunFolder.of(desk.journal, record.id)
        with contextlib.suppress(UsageError):  # its files are gone
            folder.save(replace(folder.result(), axis=new))
    desk.journal.call_adopted(contexts, old, new, host)


@dataclass(frozen=True, slots=True)
class AdoptedAll:
    """What became of several runs; `error`: of the first that was not taken in."""

    taken_in: int
    known: int
    refused: tuple[str, ...]
    error: TwoRelayError | None


def exported_in(folder: Path) -> list[Path]:
    """Folders of exported runs in a folder that is none itself, in the order of their ids."""
    if (folder / "run.json").exists() or not folder.is_dir():
        return []
    return sorted(path.parent for path in folder.glob("*/run.json"))


def adopt_all(
    paths: Sequence[Path], profile: str | None, desk: Desk, told: Callable[[int], None]
) -> AdoptedAll:
    """Take in several runs, asked for once; one that cannot be ends nothing.

    `told` : each run, 1
    """
    desk.agree(
        f"{len(paths)} runs of another computer will be TAKEN IN: 'apply', 'verify' and 'restore' "
        "then write to the drives of their axes by them.",
        "all",
        "none was taken in",
    )
    agreed = replace(desk, confirm=lambda question, word: True, tell=lambda line: None)
    taken_in = known = 0
    refused: list[str] = []
    first: TwoRelayError | None = None
    for path in paths:
        before = desk.journal.last_number()
        try:
            adopt(path, profile, agreed, lambda found: None)
        except TwoRelayError as error:
            refused.append(str(error))
            first = first or error
        else:
            new = desk.journal.last_number() > before
            taken_in, known = taken_in + new, known + (not new)
        told(1)
    return AdoptedAll(taken_in, known, tuple(refused), first)


def _known_here(profile: str | None, result: RunResult, path: Path) -> tuple[str, Profile]:
    """The drive's profile, and what it is loaded by: not the one that lies in the folder."""
    if profile is not None:
        return profile, load_profile(profile)
    name = result.profile.name if result.profile else ""
    try:
        if "/" in name or "\\" in name or name.endswith(".toml"):
            raise UnknownName("profile", name, [])
        return name, load_profile(name)
    except UnknownName:
        raise Refused(
            f"{path}: its drive's profile '{name}' is not built in: name yours with --profile",
            code="adopt.profile",
        ) from None


def _of_the_run(folder: RunFolder, path: Path) -> Profile:
    """The profile that its values were written by."""
    try:
        return load_profile(str(folder.profile_path()), lenient=True)
    except ProfileError as error:
        raise Refused(
            f"{path}: not taken in, its own profile cannot be read: {error}", code="adopt.profile"
        ) from None


def _differences(history: History, result: RunResult, theirs: Profile, here: Profile) -> list[str]:
    """What the run would write otherwise than the profile known here says, by name."""
    wanted: set[tuple[str, str]] = {(i.parameter, i.kind) for i in history.intents}
    wanted |= {(change.parameter, "compensation") for change in result.compensation}
    wanted |= {(change.parameter, "gain") for one in result.tuning for change in one.parameters}
    known = commands_of(here)
    found = []
    for name, kind in sorted(wanted):
        if kind == "experiment" and here.bus == "canopen" and _PDO.fullmatch(name):
            continue
        ours, other = here.parameters.get(name), theirs.parameters.get(name)
        if ours is None or other is None:
            found.append(f"'{name}' is {'not in it' if ours is None else 'not in its own profile'}")
        elif ours.address != other.address:
            found.append(f"'{name}' is at {ours.address} and not at {other.address}")
        elif ours.protection != other.protection:
            found.append(
                f"'{name}' has protection '{ours.protection}' and not '{other.protection}'"
            )
        elif ours.protection != kind and not (
            kind == Protection.EXPERIMENT
            and ours.protection is Protection.COMMAND
            and name in known.restorable
        ):
            found.append(f"'{name}' has protection '{ours.protection}' and is written as {kind}")
    return found


def _impossible(history: History, result: RunResult, here: Profile) -> list[str]:
    """Values that the profile known here does not let be written."""
    values = [(i.parameter, i.old) for i in history.intents if i.is_open]
    values += [(change.parameter, change.new_raw) for change in result.compensation]
    parameters, known = here.parameters, commands_of(here)
    found = []
    for name, raw in dict.fromkeys(values):
        if name not in parameters or name in known.set_points:
            continue
        low, high = parameters[name].range
        if not parameters[name].allows(raw):
            found.append(f"'{name}' does not take {raw} ({low:g}…{high:g})")
        elif known.enables(name, raw):
            found.append(f"'{name}' is to be {raw}, which enables the drive")
    return found
