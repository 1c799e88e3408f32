"""The history of an axis, put together."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from commissioning.ending import operator
from commissioning.history.axes import SameAxis, chosen, groups
from commissioning.history.catching_up import catch_up, said_by_run
from commissioning.history.drift import GATE, drift
from commissioning.journal import Journal
from commissioning.result.history import (
    CHARTED,
    DriveFitted,
    IndexedRun,
    Note,
    Renamed,
    Story,
    computer_of,
    name_now,
    names_before,
    own_name,
)
from profiles.axis import axis_name
from profiles.errors import UnknownName, UsageError
from profiles.identity import NO_SERIAL

__all__ = ["add_note", "all_axes", "names_now", "remove_note", "rename", "story_of"]

_LONGEST_NOTE = 1000  # characters


@dataclass(frozen=True, slots=True)
class _Found:
    """An axis that was asked for.

    `called`: as it was asked for, without a computer. `name`: now. `names`: all that it had.
    `of_name`: all axes of this name, of this computer and others. `renamed`: all renamings.
    """

    called: str
    name: str
    names: list[str]
    axis: SameAxis
    of_name: list[SameAxis]
    renamed: list[Renamed]


def _find(journal: Journal, asked: str, known: Sequence[str] | None = None) -> _Found:
    """The axis that is called so, or NAME@COMPUTER; raises UnknownName.

    `known` : names of all axes, where they are known
    """
    renamed = journal.renamed()
    known = names_now(journal) if known is None else known
    called, host = asked, None
    if asked not in known and "@" in asked:
        called, _, host = asked.rpartition("@")
    name = called if called in known else _became(called, renamed)
    names = names_before(name, renamed)
    of_name = groups(_of_name(_entries(journal, names), name, renamed), platform.node())
    axis = chosen(of_name, host)
    if axis is None:
        others = sorted(h for one in of_name for h in one.hosts)
        raise UnknownName("axis with runs", asked, [f"{called}@{h}" for h in others] or list(known))
    return _Found(called, name, names, axis, of_name, renamed)


def _of_name(
    entries: Sequence[IndexedRun], name: str, renamed: Sequence[Renamed]
) -> list[IndexedRun]:
    """Runs of axes that are called so now; and of other computers' on a drive of ours."""
    here = platform.node()
    theirs = [one for one in entries if computer_of(one, here) is not None]
    found = {one.run for one in entries if name_now(one, renamed, here) == name}
    foreign = {one.run for one in theirs}
    drives = {one.serial for one in entries if one.run in found - foreign} - set(NO_SERIAL)
    found |= {one.run for one in theirs if one.serial in drives}
    return [one for one in entries if one.run in found]


def story_of(journal: Journal, asked: str, *, gate: float = GATE) -> Story:
    """The history of the axis that is called so, or NAME@COMPUTER; raises UnknownName.

    `gate` : change below which there is no alarm, %
    """
    return _story(journal, _find(journal, asked), gate)


def _story(journal: Journal, found: _Found, gate: float) -> Story:
    entries, name, notes = found.axis.entries, found.name, _notes(journal, found)
    is_first = found.axis is found.of_name[0]
    label = name if is_first or found.axis.is_ours else f"{name}@{min(found.axis.hosts)}"
    charts = (drift(entries, notes, quantity, gate=gate) for quantity in CHARTED)
    remarks = [f"'{found.called}' is called '{name}' now"] if name != found.called else []
    old = dict.fromkeys(one.axis for one in entries if one.axis != name)
    remarks += [f"it was called '{one}' before" for one in old if one != found.called]
    remarks += _others(found.of_name, found.axis, name)
    remarks += _same_drive(journal, found.axis, found.names)
    return Story(
        label, entries, _drives(entries), tuple(notes), tuple(one for one in charts if one),
        tuple(remarks),
    )  # fmt: skip


def _notes(journal: Journal, found: _Found) -> list[Note]:
    """Notes on this axis, and not on another of its name."""
    ours = [None] if found.axis.is_ours else []
    return journal.notes_on(found.name, [*ours, *found.axis.hosts], found.renamed)


def all_axes(
    journal: Journal, *, gate: float = GATE, told: Callable[[int], None] = lambda step: None
) -> list[Story]:
    """The history of each axis, by name; `told` each, 1."""
    known = names_now(journal)
    found = []
    for name in known:
        one = _find(journal, name, known)
        found += [_story(journal, replace(one, axis=axis), gate) for axis in one.of_name]
        told(1)
    return found


def names_now(journal: Journal) -> list[str]:
    """What the axes that have runs are called now."""
    renamed, known = journal.renamed(), journal.axes()
    old = [name for name in known if any(name == one.old for one in renamed)]
    found = set(known) - set(old)
    found |= {
        name if adopted else own_name(name, number, renamed)
        for name, number, adopted in journal.named(old, platform.node())
    }
    return sorted(found)


def _became(name: str, renamed: Sequence[Renamed]) -> str:
    """What a name that no axis has any more became."""
    for one in renamed:
        if one.old == name:
            name = one.new
    return name


def _entries(journal: Journal, names: Sequence[str]) -> list[IndexedRun]:
    """Runs of these names; what the index lacks is put in, or read from the runs."""
    entries, lacking = journal.entries(names)
    if not lacking:
        return entries
    if catch_up(lacking) is not None:
        with Journal(journal.folder, reading=True) as again:
            entries, lacking = again.entries(names)
    without = set(lacking)
    return [said_by_run(journal, one) if one.run in without else one for one in entries]


def _drives(entries: Sequence[IndexedRun]) -> tuple[DriveFitted, ...]:
    found: list[DriveFitted] = []
    for one in entries:
        if found and found[-1].serial == one.serial:
            found[-1] = replace(found[-1], until_run=one.run)
        else:
            found.append(DriveFitted(one.serial, one.run, one.run))
    return tuple(found)


def _others(of_name: Sequence[SameAxis], group: SameAxis, name: str) -> list[str]:
    remarks = []
    for other in of_name:
        if other is group:
            continue
        where = "this computer" if other.is_ours else ", ".join(sorted(other.hosts))
        asked = name if other.is_ours else f"{name}@{min(other.hosts)}"
        remarks.append(
            f"another axis of this name was measured on {where}: {len(other.entries)} run(s), "
            f"drive {other.entries[-1].serial or 'without a serial number'}: "
            f"'tworelay history {asked}'"
        )
    return remarks


def _same_drive(journal: Journal, group: SameAxis, names: Sequence[str]) -> list[str]:
    """Other names under which the drive of the last run was measured."""
    serial = group.entries[-1].serial
    if serial in NO_SERIAL or group.entries[-1].link.startswith("virtual:"):
        return []  # virtual drives of the same options are the same
    others = [one for one in journal.names_of_drive(serial) if one not in names]
    way = "'tworelay adopt' of all its runs, exported anew,"
    if group.is_ours and others:
        way = f'\'tworelay history rename "{others[-1]}" "{names[0]}"\''
    return [
        f"its drive {serial} was measured as axis '{other}', too: if that is this axis, {way} puts "
        "them together"
        for other in others[-1:]
    ]


# -- what people add ------------------------------------------------------------------------------


def add_note(journal: Journal, axis: str, text: str, at: float | None) -> Note:
    """Note what was done to an axis, now or at a time, s since 1970; raises UsageError."""
    text = " ".join(text.split())
    if not text or len(text) > _LONGEST_NOTE or not text.isprintable():
        raise UsageError(f"a note has 1 to {_LONGEST_NOTE} printable characters")
    found = _find(journal, axis)
    moment = time.time()
    if at is not None and at > moment:
        raise UsageError("a note is of what was done, and its date lies in the future")
    note = Note(
        found.name, moment if at is None else at, text, operator(), platform.node() or None,
        journal.last_number(), max((one.seq for one in found.renamed), default=0), at is not None,
        None if found.axis.is_ours else min(found.axis.hosts),
    )  # fmt: skip
    journal.note_on(note)
    return note


def remove_note(journal: Journal, axis: str, text: str) -> str:
    """Take back a note; returns the axis' name. Raises UsageError."""
    found = _find(journal, axis)
    there = {note.text: note for note in _notes(journal, found)}
    note = there.get(" ".join(text.split()))
    if note is None:
        raise UnknownName(f"note on axis '{found.name}'", text, list(there))
    journal.remove_note(note)
    return found.name


def rename(journal: Journal, old: str, new: str, *, join: bool) -> None:
    """The axis that was called `old` is called `new`; raises UsageError, UnknownName.

    `join` : also where `new` has runs already, and both become one for good
    """
    found = _find(journal, old)
    if not found.axis.is_ours:
        raise UsageError(f"'{old}' is an axis of another computer: it is renamed there")
    try:
        axis_name(new)
    except ValueError as error:
        raise UsageError(f"the new name '{new:.100}' {error}") from None
    if found.name == new:
        raise UsageError(f"'{old}' is called '{new}' already")
    if new in names_now(journal) and not join:
        there = _find(journal, new).axis
        drives = {one.serial for one in found.axis.entries} - set(NO_SERIAL)
        if there.is_ours and not drives & {one.serial for one in there.entries}:
            raise UsageError(
                f"there is an axis '{new}', with another drive: with --join its runs and those of "
                f"'{found.name}' become one history"
            )
    journal.rename(found.name, new)
